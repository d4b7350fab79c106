"""The streams of one payload, each taken exactly once (SPEC 7)."""

from __future__ import annotations

from cogsplat.codec.errors import FormatError
from cogsplat.codec.splats import Splats
from cogsplat.codec.streams import records
from cogsplat.codec.streams.records import KEPT, Attribute, Kind, StoredStream
from cogsplat.codec.streams.refinement import Finer


class StreamSet:
    """The streams of one payload, each to be taken exactly once."""

    def __init__(self, payload: memoryview, where: str, rows: int, clause: str) -> None:
        stored = records.unpack(payload, where, rows)
        self._stored = {(s.attribute, s.flags & KEPT): s for s in stored}
        self._where = where
        self._rows = rows
        self._clause = clause

    def has(self, attribute: Attribute, *, kept: bool = False) -> bool:
        """Tell whether a stream of this attribute has not been taken yet."""
        return (attribute, KEPT if kept else 0) in self._stored

    def take(self, attribute: Attribute) -> StoredStream:
        """Return the stream of an attribute, which must be there, one value a row."""
        return self._take(attribute, 0, self._rows)

    def take_kept(self, attribute: Attribute, rows: int) -> StoredStream:
        """Return the escape vectors of an attribute, which must be `rows`."""
        return self._take(attribute, KEPT, rows)

    def _take(self, attribute: Attribute, flag: int, rows: int) -> StoredStream:
        stream = self._stored.pop((attribute, flag), None)
        name = attribute.name.lower() + (" kept" if flag else "")
        if stream is None:
            raise FormatError(
                "stream-missing",
                f"{self._where}: no stream for {name}, expected one",
                clause=self._clause,
            )
        if stream.rows != rows:
            raise FormatError(
                "stream-rows",
                f"{stream.where}: {stream.rows} rows, expected {rows}",
                clause="6.2",
            )
        if stream.kind == Kind.VQ and attribute not in (Attribute.SHAPE, Attribute.SHN):
            raise FormatError(
                "stream-kind", f"{stream.where}: kind VQ, expected numbers", clause="6.2"
            )
        return stream

    def finish(self) -> None:
        """Refuse streams that nothing took."""
        if self._stored:
            names = sorted(s.label for s in self._stored.values())
            raise FormatError(
                "stream-unexpected",
                f"{self._where}: {names} have no place here",
                clause=self._clause,
            )


class RefinementSet:
    """The streams of a refinement, each to be taken at most once; none where there is none."""

    def __init__(self, payload: memoryview | None, where: str, rows: int) -> None:
        self._streams = None if payload is None else StreamSet(payload, where, rows, "7.4")

    def take(self, attribute: Attribute) -> StoredStream | None:
        """Return the stream that refines an attribute, None where nothing does."""
        if self._streams is None or not self._streams.has(attribute):
            return None
        return self._streams.take(attribute)

    def finer(self, attribute: Attribute, out: Splats) -> Finer | None:
        """Return what adds bits to an attribute whose step follows from refined scales."""
        stream = self.take(attribute)
        return None if stream is None else Finer(stream, out.scales)

    def finish(self) -> None:
        """Refuse streams that nothing took."""
        if self._streams is not None:
            self._streams.finish()
