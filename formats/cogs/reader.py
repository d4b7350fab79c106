"""Open a COGS file: decode it, stream its chunks as their bytes arrive, or verify it (SPEC 8)."""

from __future__ import annotations

from collections.abc import Callable

from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import MAX_SH_DEGREE
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.source import PrefixSource, RemoteSource, Source

from .chunk_decoder import ChunkDecoder
from .chunk_stream import ChunkStream
from .drawn_chunks import drawn_chunks
from .index import Index, join_pages, read_index, read_root
from .lazy_index import LazyIndex
from .missing_segments import require_all_segments
from .verification import checks


class CogsFile(ChunkDecoder):
    """An open file: its root, its tables, and its chunks on demand.

    Opened by `open_cogs`. A context manager; safe to decode from several threads.
    """

    def __repr__(self) -> str:
        return (
            f"CogsFile({self.name!r}, {self.root.splats:,} splats in {self.num_chunks:,} chunks, "
            f"SH degree {self.root.sh_degree})"
        )

    def stream(
        self,
        *,
        priority: Callable[[int], float] | None = None,
        sh_degree: int | None = None,
        refine: bool = True,
    ) -> ChunkStream:
        """Decode chunks as their bytes come, each at first as coarse as what is there of it.

        Parameters
        ----------
        priority : callable, optional
            Of the number of a chunk: chunks of larger values come first, those below 0 not at all.
            By default segments come in the order of the file, which shows most for its bytes.
        sh_degree : int, optional
            Highest SH degree wanted.
        refine : bool
            Whether to read refinements.

        Returns
        -------
        ChunkStream
            An iterator, with ``for`` and with ``async for``, of `ChunkUpdate`; a context manager
            that ends its requests.

        Examples
        --------
        >>> import cogsplat
        >>> with cogsplat.open("scene.cogs") as file, file.stream() as updates:
        ...     whole = sum(len(update.splats) for update in updates if update.is_complete)
        ...     whole == file.root.splats
        True
        """
        degree = MAX_SH_DEGREE if sh_degree is None else sh_degree
        if not 0 <= degree <= MAX_SH_DEGREE:
            raise ValueError(f"SH degree {sh_degree}, expected 0 to {MAX_SH_DEGREE}")
        chunks = drawn_chunks(self.chunks, self.complete_chunks())
        if priority is not None:
            values = {chunk: priority(chunk) for chunk in chunks}
            chunks = sorted((c for c in chunks if values[c] >= 0), key=lambda c: -values[c])
        return ChunkStream(
            self,
            self._source,
            self._index,
            self._limits,
            chunks,
            in_file_order=priority is None,
            sh_degree=min(degree, self.root.sh_degree),
            refine=refine,
        )

    def verify(self, progress: Progress = silent) -> None:
        """Check all of the file, as a verifier does, and stop at the first broken rule.

        Raises
        ------
        FormatError
            ``segment-crc``, ``segment-hash``, ``chunk-box``, or what decoding finds.
        """
        steps = list(checks(self))
        for done, check in enumerate(steps, start=1):
            check.run()
            progress("verify", done, len(steps))


def open_cogs(
    source: Source,
    *,
    partial: bool = False,
    size_bytes: int | None = None,
    limits: Limits | None = None,
) -> CogsFile:
    """Read the index of a file and check it.

    Parameters
    ----------
    source : Source
    partial : bool
        Accept a source that ends before the file does; its complete chunks can be decoded.
    size_bytes : int, optional
        Take the source as if it ended after so many bytes, which makes it a partial one.
    limits : Limits, optional

    Returns
    -------
    CogsFile

    Raises
    ------
    FormatError
        The preamble, the root, a page or their tables break SPEC 3 to 5.
    TruncatedError
        The file is short (strict), or its root is not complete (partial).
    UnsupportedError
        Another version, or something that must be understood and is not.
    ValueError
        A negative size.
    """
    if size_bytes is not None:
        if size_bytes < 0:
            raise ValueError(f"size_bytes {size_bytes}, expected 0 or more")
        source, partial = PrefixSource(source, size_bytes), True
    index: Index | LazyIndex
    if isinstance(source, RemoteSource) and not partial:
        place = read_root(source, partial=False)
        index = LazyIndex(source, place) if place.root.pages else join_pages(source, place, [], {})
    else:
        index = read_index(source, partial=partial)
    if not partial:
        require_all_segments(source, index)
    return CogsFile(source, index, limits or Limits())
