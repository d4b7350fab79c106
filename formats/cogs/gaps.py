"""Segments that a source lacks within its size, as a folder may lack objects (SPEC 3.4)."""

from __future__ import annotations

from collections.abc import Iterator

from cogsplat.codec.errors import TruncatedError
from cogsplat.formats.storage.source import Source, has_range

from .index import AnyIndex


def gap_bytes(source: Source, index: AnyIndex) -> int:
    """Return the bytes of the segments that a source lacks within its size; 0 for a file."""
    return sum(int(index.segments.length[row]) for row in _gaps(source, index))


def require_all(source: Source, index: AnyIndex) -> None:
    """Refuse a source that lacks segments within its size.

    Raises
    ------
    TruncatedError
        ``segment-missing``.
    """
    missing = list(_gaps(source, index))
    if missing:
        first = _told_of(source, int(index.offsets[missing[0]]))
        raise TruncatedError(
            "segment-missing",
            f"{source.name}: {len(missing)} of {len(index.segments)} segments are not there, "
            f"expected all; the first: {first}",
            clause="3.4",
        )


def _told_of(source: Source, offset: int) -> str:
    """Return what a source says of a byte that it lacks, such as the name of the object."""
    try:
        source.read(offset, 1)
    except TruncatedError as error:
        return error.message
    return f"at byte {offset}"


def _gaps(source: Source, index: AnyIndex) -> Iterator[int]:
    if not hasattr(source, "holds"):
        return
    ends = zip(index.offsets.tolist(), index.segments.length.tolist(), strict=True)
    for row, (offset, length) in enumerate(ends):
        if offset + length <= source.size and not has_range(source, offset, length):
            yield row
