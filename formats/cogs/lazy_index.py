"""Index of a file on a network, which reads pages on demand."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections.abc import Callable, Sequence

from cogsplat.formats.storage.source import Source

from .page_tree import PagePlace
from .scene_index import IndexTree, RootExtent, SceneIndex


class LazyIndex:
    """Index that reads pages on demand.

    `for_chunks` reads the pages above some chunks, `whole` reads all pages.

    Parameters
    ----------
    source : Source
        Source of the complete file.
    extent : RootExtent
        Root of the file.

    Raises
    ------
    FormatError
        The segments or chunks of the root break SPEC 5.
    """

    def __init__(self, source: Source, extent: RootExtent) -> None:
        self.root = extent.root
        self.file_length = extent.file_length
        self.all_chunks = extent.root.tables.extent.chunks
        self._tree = IndexTree(source, extent)
        self._index = self._tree.scene_index()
        self._lock = threading.Lock()

    @property
    def num_chunks(self) -> int:
        """Number of chunks of the file."""
        return self.all_chunks

    def for_chunks(self, chunks: Sequence[int]) -> SceneIndex:
        """Return an index with every segment of some chunks; reads the pages above them.

        Rows of other chunks may be placeholders.

        Parameters
        ----------
        chunks : sequence of int
            Chunk numbers.

        Raises
        ------
        CogsplatError
            A page cannot be read, or breaks SPEC.
        """
        wanted = sorted(set(chunks))

        def is_above(page: PagePlace) -> bool:
            at = bisect_left(wanted, page.first_chunk)
            return at < len(wanted) and page.holds_chunk(wanted[at])

        return self._with(is_above)

    def for_path(self, path: tuple[int, ...]) -> SceneIndex:
        """Return an index that has the page with a path, and the pages above it.

        Parameters
        ----------
        path : tuple of int
            Rows of the pages on the way from the root; empty for the root.

        Raises
        ------
        CogsplatError
            A page cannot be read, or breaks SPEC.
        """
        return self._with(lambda page: page.path == path[: len(page.path)])

    def for_description(self, *, pictures: bool) -> SceneIndex:
        """Return an index with the row of the description and, on request, of its pictures.

        The root lists the description, the root's last page the pictures (SPEC 5.13, 5.14). Rows of
        other pages are placeholders.

        Parameters
        ----------
        pictures : bool
            Whether to read the page of the pictures.

        Raises
        ------
        CogsplatError
            The page cannot be read, or breaks SPEC.
        """
        return self._with(lambda page: pictures and page.is_last_of_root)

    def whole(self) -> SceneIndex:
        """Read all missing pages and return the whole index."""
        return self._with(lambda page: True)

    def _with(self, is_wanted: Callable[[PagePlace], bool]) -> SceneIndex:
        """Read the unread pages that are wanted and return an index of all that was read."""
        with self._lock:
            self._tree.read(is_wanted)
            if len(self._index.indices) != len(self._tree.indices):
                self._index = self._tree.scene_index()
            return self._index
