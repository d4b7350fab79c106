"""The streams of one payload, each taken exactly once (SPEC 7)."""

from __future__ import annotations

from collections.abc import Mapping

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams import kinds, records
from cogsplat.codec.streams.records import ESCAPE, INFINITIES, Attribute, StoredStream


class StreamSet:
    """The streams of a head, a tail or a codebook, each to be taken exactly once.

    Parameters
    ----------
    payload : memoryview
        The segment's bytes, its CRC already checked.
    where : str
        Names the segment in messages.
    rows : int
        Of the chunk or the codebook.
    clause : str
        Clause of SPEC 7 that says which streams the payload has.
    heads_only : bool
        Whether kinds that stand in heads only are allowed.
    levels : bool
        Whether kinds that stand for opacities of later levels only are allowed.
    """

    def __init__(
        self,
        payload: memoryview,
        where: str,
        rows: int,
        clause: str,
        *,
        heads_only: bool = False,
        levels: bool = False,
    ) -> None:
        stored = records.unpack(payload, where, rows)
        self._stored = {(s.attribute, s.flags & ESCAPE): s for s in stored}
        self._where = where
        self._rows = rows
        self._clause = clause
        self._heads_only = heads_only
        self._levels = levels

    def has(self, attribute: Attribute, *, escape: bool = False) -> bool:
        """Tell whether a stream of this attribute has not been taken yet."""
        return (attribute, ESCAPE if escape else 0) in self._stored

    def pop(self, attribute: Attribute) -> StoredStream:
        """Return the stream of an attribute, one row for each row of the payload.

        Raises
        ------
        FormatError
            ``stream-missing``, ``stream-rows``, ``stream-kind``.
        """
        return self._pop(attribute, 0, self._rows)

    def pop_escape(self, attribute: Attribute, rows: int) -> StoredStream:
        """Return the escape rows of an attribute, which must be `rows`."""
        return self._pop(attribute, ESCAPE, rows)

    def _pop(self, attribute: Attribute, flag: int, rows: int) -> StoredStream:
        stream = self._stored.pop((attribute, flag), None)
        name = attribute.name.lower() + (" escape" if flag else "")
        if stream is None:
            raise FormatError(
                "stream-missing",
                f"{self._where}: no stream for {name}, expected one",
                clause=self._clause,
            )
        _require_rows(stream, rows)
        if kinds.codec_of(stream).heads_only and (flag or not self._heads_only):
            raise FormatError(
                "stream-kind",
                f"{stream.where}: kind {stream.kind.name.lower()}, "
                "which is for splats of a head without shape indices only",
                clause="6.2",
            )
        if kinds.codec_of(stream).levels_only and not self._levels:
            raise FormatError(
                "stream-kind",
                f"{stream.where}: kind {stream.kind.name.lower()}, "
                "which is for opacities of later levels only",
                clause="6.2",
            )
        return stream

    def require_empty(self) -> None:
        """Refuse streams that nothing took.

        Raises
        ------
        FormatError
            ``stream-unexpected``.
        """
        _refuse_rest(self._stored, self._where, self._clause)


class RefinementSet:
    """The streams of a refinement, each to be taken at most once (SPEC 7.4).

    Parameters
    ----------
    payload : memoryview or None
        None where the chunk has no refinement, or its head is to be decoded alone.
    where, rows
        As `StreamSet` takes them.
    """

    def __init__(self, payload: memoryview | None, where: str, rows: int) -> None:
        stored = [] if payload is None else records.unpack(payload, where, rows)
        self._stored = {(s.attribute, s.flags & ESCAPE): s for s in stored}
        self._where = where
        self._rows = rows

    def pop(self, head: StoredStream) -> StoredStream | None:
        """Return the stream that refines a stream of the head, None where none does.

        Raises
        ------
        FormatError
            ``stream-rows``; ``stream-kind``: another kind than refines the head's stream.
        """
        wanted = kinds.refinement_kind(head)
        stream = self._stored.get((head.attribute, 0))
        if stream is None:
            return None
        del self._stored[head.attribute, 0]
        _require_rows(stream, self._rows)
        if stream.kind != wanted:
            expected = "no refinement" if wanted is None else f"kind {wanted.name.lower()}"
            infinities = " with infinities" if head.flags & INFINITIES else ""
            raise FormatError(
                "stream-kind",
                f"{stream.where}: kind {stream.kind.name.lower()}, expected {expected} "
                f"of a stream of kind {head.kind.name.lower()}{infinities}",
                clause="6.16" if infinities else "7.4",
            )
        return stream

    def require_empty(self) -> None:
        """Refuse streams that nothing took.

        Raises
        ------
        FormatError
            ``stream-unexpected``.
        """
        _refuse_rest(self._stored, self._where, "7.4")


def _require_rows(stream: StoredStream, rows: int) -> None:
    """Refuse a stream of another number of rows than its place has."""
    if stream.rows != rows:
        raise FormatError(
            "stream-rows",
            f"{stream.where}: {stream.rows} rows, expected {rows}",
            clause="6.2",
        )


def _refuse_rest(
    stored: Mapping[tuple[Attribute, int], StoredStream], where: str, clause: str
) -> None:
    """Refuse the streams of a payload that nothing took."""
    if stored:
        names = sorted(stream.label for stream in stored.values())
        raise FormatError(
            "stream-unexpected", f"{where}: {names} have no place here", clause=clause
        )
