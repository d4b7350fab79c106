"""Missing parts within a source's size, such as missing objects of a folder (SPEC 3.4)."""

from __future__ import annotations

from collections.abc import Iterator

from cogsplat.codec.errors import TruncatedError
from cogsplat.formats.storage.source import Source, has_range

from .lazy_index import LazyIndex
from .scene_index import SceneIndex


def missing_segment_bytes(source: Source, index: SceneIndex | LazyIndex) -> int:
    """Return the total size of the segments that a source with gaps lacks, bytes.

    From a missing page on, the rest of the source counts as missing. Bytes behind the end of
    the source are not counted. 0 for a file, which has no gaps.
    """
    missing = sum(int(index.whole().segments.length[row]) for row in _gaps(source, index))
    return missing + _bytes_from_missing_page(source, index)


def _bytes_from_missing_page(source: Source, index: SceneIndex | LazyIndex) -> int:
    """Return the bytes of a source from its first missing page on; 0 if none is missing."""
    if not hasattr(source, "holds"):
        return 0
    page = index.whole().first_unread
    if page is None or page.start + page.length > source.size:
        return 0
    return source.size - page.start


def require_all_segments(source: Source, index: SceneIndex | LazyIndex) -> None:
    """Refuse a source with missing segments.

    Raises
    ------
    TruncatedError
        ``segment-missing``.
    """
    missing = list(_gaps(source, index))
    if missing:
        tables = index.whole()
        first = _describe_gap(source, int(tables.offsets[missing[0]]))
        raise TruncatedError(
            "segment-missing",
            f"{source.name}: {len(missing)} of {len(tables.segments)} segments are missing, "
            f"expected all; the first: {first}",
            clause="3.4",
        )


def _describe_gap(source: Source, offset: int) -> str:
    """Return the source's message about a missing byte, such as the name of its object."""
    try:
        source.read(offset, 1)
    except TruncatedError as error:
        return error.message
    return f"at byte {offset}"


def _gaps(source: Source, index: SceneIndex | LazyIndex) -> Iterator[int]:
    """Yield the rows of missing segments; a source without ``holds`` has none."""
    if not hasattr(source, "holds"):
        return
    tables = index.whole()
    ends = zip(tables.offsets.tolist(), tables.segments.length.tolist(), strict=True)
    for row, (offset, length) in enumerate(ends):
        if offset + length <= source.size and not has_range(source, offset, length):
            yield row
