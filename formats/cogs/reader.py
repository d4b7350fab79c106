"""Open a COGS file to decode, stream or verify it (SPEC 8)."""

from __future__ import annotations

from collections.abc import Callable

from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import MAX_SH_DEGREE
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.source import PrefixSource, RemoteSource, Source

from .chunk_decoder import ChunkDecoder
from .chunk_stream import ChunkStream
from .lazy_index import LazyIndex
from .missing_segments import require_all_segments
from .scene_index import SceneIndex, read_root, read_scene_index
from .verification import checks


class CogsFile(ChunkDecoder):
    """Open COGS file: tables, decoding, streaming and verification. A context manager.

    Opened by `open_cogs`. Safe to decode from several threads.
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
        """Decode chunks as their bytes arrive, first coarse, then refined.

        Parameters
        ----------
        priority : callable, optional
            Function of a chunk number. Chunks with higher values come first; negative ones are
            skipped. By default segments come in file order, which is by quality gained per byte.
        sh_degree : int, optional
            Highest SH degree to decode; by default the file's.
        refine : bool
            Whether to fetch refinements.

        Returns
        -------
        ChunkStream
            Iterator of `ChunkUpdate` for ``for`` and ``async for``. As a context manager, it
            cancels its requests at the end of the block.

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
        chunks = self.drawn_chunks(self.complete_chunks())
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
        """Check the whole file against SPEC and raise the error of the first broken rule.

        Parameters
        ----------
        progress : Progress
            Callback, called with ``("verify", checks done, checks)``.

        Raises
        ------
        CogsplatError
            ``segment-crc``, ``segment-hash``, ``chunk-box``, or an error of decoding.
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
    """Open a COGS file: read and check its index.

    Parameters
    ----------
    source : Source
        Source of the file, closed with it.
    partial : bool
        Whether to accept a source that ends before the file does. Its complete chunks can be
        decoded.
    size_bytes : int, optional
        Length at which to cut the source, bytes; implies `partial`.
    limits : Limits, optional
        Memory and size limits.

    Returns
    -------
    CogsFile
        Open file.

    Raises
    ------
    FormatError
        The preamble, the root, a page or their tables break SPEC 3 to 5.
    TruncatedError
        The source ends before the file; with `partial`, before the end of the root.
    UnsupportedError
        The version of the file, or a required feature, is not supported.
    ValueError
        `size_bytes` is negative.
    """
    if size_bytes is not None:
        if size_bytes < 0:
            raise ValueError(f"size_bytes {size_bytes}, expected 0 or more")
        source, partial = PrefixSource(source, size_bytes), True
    index: SceneIndex | LazyIndex
    if isinstance(source, RemoteSource) and not partial:
        index = LazyIndex(source, read_root(source, partial=False))
    else:
        index = read_scene_index(source, partial=partial)
    if not partial:
        require_all_segments(source, index)
    return CogsFile(source, index, limits or Limits())
