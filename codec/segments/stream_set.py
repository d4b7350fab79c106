"""Streams of one payload, each to be read exactly once (SPEC 7)."""

from __future__ import annotations

from collections.abc import Mapping

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams import kinds, records
from cogsplat.codec.streams.records import ESCAPE, INFINITIES, Attribute, StoredStream


class StreamSet:
    """Streams of a head, a tail or a codebook that have not been read yet.

    Parameters
    ----------
    payload : memoryview
        Bytes of the segment, its CRC already checked.
    where : str
        Name of the segment in messages.
    rows : int
        Rows of the chunk or the codebook.
    clause : str
        Clause of SPEC 7 that lists the payload's streams.
    levels : bool
        Whether kinds limited to opacities of later levels are allowed.
    """

    def __init__(
        self,
        payload: memoryview,
        where: str,
        rows: int,
        clause: str,
        *,
        levels: bool = False,
    ) -> None:
        stored = records.unpack(payload, where, rows)
        self._stored = {(s.attribute, s.flags & ESCAPE): s for s in stored}
        self._where = where
        self._rows = rows
        self._clause = clause
        self._levels = levels

    def has(self, attribute: Attribute, *, escape: bool = False) -> bool:
        """Tell whether the set has a stream of an attribute."""
        return (attribute, ESCAPE if escape else 0) in self._stored

    def pop(self, attribute: Attribute) -> StoredStream:
        """Remove and return the stream of an attribute, which must have a row for each payload row.

        Raises
        ------
        FormatError
            ``stream-missing``, ``stream-rows``, ``stream-kind``.
        """
        return self._pop(attribute, 0, self._rows)

    def pop_escape(self, attribute: Attribute, rows: int) -> StoredStream:
        """Remove and return the escape stream of an attribute, which must have `rows` rows."""
        return self._pop(attribute, ESCAPE, rows)

    def _pop(self, attribute: Attribute, flag: int, rows: int) -> StoredStream:
        """Remove and return a stream; check its row count and its kind.

        Parameters
        ----------
        attribute : Attribute
            Attribute of the stream.
        flag : int
            `ESCAPE` for the attribute's escape rows, else 0.
        rows : int
            Expected number of rows.
        """
        stream = self._stored.pop((attribute, flag), None)
        name = attribute.name.lower() + (" escape" if flag else "")
        if stream is None:
            raise FormatError(
                "stream-missing",
                f"{self._where}: no stream for {name}, expected one",
                clause=self._clause,
            )
        _require_rows(stream, rows)
        if kinds.codec_of(stream).levels_only and not self._levels:
            raise FormatError(
                "stream-kind",
                f"{stream.where}: kind {stream.kind.name.lower()}, "
                "which is for opacities of later levels only",
                clause="6.2",
            )
        return stream

    def require_empty(self) -> None:
        """Check that no stream is left.

        Raises
        ------
        FormatError
            ``stream-unexpected``.
        """
        _require_empty(self._stored, self._where, self._clause)


class RefinementSet:
    """Streams of a refinement that have not been read yet (SPEC 7.4).

    Parameters
    ----------
    payload : memoryview or None
        Bytes of the refinement; None if it is absent or not requested.
    where, rows
        See `StreamSet`.
    """

    def __init__(self, payload: memoryview | None, where: str, rows: int) -> None:
        stored = [] if payload is None else records.unpack(payload, where, rows)
        self._stored = {(s.attribute, s.flags & ESCAPE): s for s in stored}
        self._where = where
        self._rows = rows

    def pop(self, head: StoredStream) -> StoredStream | None:
        """Remove and return the stream that refines a stream of the head; None if absent.

        Raises
        ------
        FormatError
            ``stream-rows``; ``stream-kind``: the kind does not refine that of the head's stream.
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
        """Check that no stream is left.

        Raises
        ------
        FormatError
            ``stream-unexpected``.
        """
        _require_empty(self._stored, self._where, "7.4")


def _require_rows(stream: StoredStream, rows: int) -> None:
    """Raise ``stream-rows`` if a stream does not have `rows` rows."""
    if stream.rows != rows:
        raise FormatError(
            "stream-rows",
            f"{stream.where}: {stream.rows} rows, expected {rows}",
            clause="6.2",
        )


def _require_empty(
    stored: Mapping[tuple[Attribute, int], StoredStream], where: str, clause: str
) -> None:
    """Raise ``stream-unexpected`` if `stored` is not empty; `clause` of the SPEC is cited."""
    if stored:
        names = sorted(stream.label for stream in stored.values())
        raise FormatError(
            "stream-unexpected", f"{where}: {names} have no place here", clause=clause
        )
