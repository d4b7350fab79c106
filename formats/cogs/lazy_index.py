"""Index of a file on a network, which reads pages on demand."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence
from itertools import accumulate

import numpy as np

from cogsplat.formats.storage.source import Source, prefetching

from .fetch_order import codebook_rows, needed_codebooks, rows_of_chunk
from .index import (
    Index,
    Page,
    RootExtent,
    join_pages,
    page_positions,
    page_ranges,
    read_page,
    require_end,
)
from .segment_rows import I64, codebook_kinds


class LazyIndex:
    """Index that reads pages on demand.

    `for_chunks` reads the pages of some chunks, `whole` reads all pages.

    Parameters
    ----------
    source : Source
        Source of the complete file.
    extent : RootExtent
        Root of the file.

    Raises
    ------
    FormatError
        ``segments-length``: the pages end elsewhere than the file.
    """

    def __init__(self, source: Source, extent: RootExtent) -> None:
        self.root = extent.root
        self.file_length = extent.file_length
        self.all_chunks = len(extent.root.chunks) + sum(page.chunks for page in extent.root.pages)
        self._source = source
        self._extent = extent
        self._positions = page_positions(extent)
        require_end(source, extent, self._positions)
        counts = [len(extent.root.chunks), *(page.chunks for page in extent.root.pages)]
        # First chunk number behind the root and behind each page.
        self._ends = np.array(list(accumulate(counts)), np.int64)
        self._pages: dict[int, Page] = {}
        self._joined: Index | None = None
        self._lock = threading.Lock()

    @property
    def num_chunks(self) -> int:
        """Number of chunks of the file."""
        return self.all_chunks

    def for_chunks(
        self, chunks: Sequence[int], *, sh_degree: int, refine: bool, extras: bool
    ) -> Index:
        """Return an index with every segment needed to decode some chunks.

        Rows of other chunks may be placeholders.

        Parameters
        ----------
        chunks : sequence of int
            Chunk numbers.
        sh_degree : int
            Highest SH degree of tails and codebooks.
        refine, extras : bool
            Whether to include refinements and extra attributes.

        Raises
        ------
        CogsplatError
            A page cannot be read, or breaks SPEC.
        """
        every = set(range(len(self.root.pages)))
        with self._lock:
            if self.root.levels:
                # Any page may list opacity segments of a later level.
                return self._with(every)
            index = self._with({int(page) for page in self._pages_of(chunks)})
            # Missing segments of a chunk may be in any later page, or not exist.
            lacking = [
                chunk
                for chunk in chunks
                if (refine and index.refinements[chunk] < 0)
                or (sh_degree and index.tails[chunk] < 0)
                or (extras and self.root.attributes and index.attributes[chunk] < 0)
            ]
            if lacking:
                first = int(self._pages_of(lacking).min())
                index = self._with(set(range(first + 1, len(self.root.pages))))
            rows = [
                row
                for chunk in chunks
                for row in rows_of_chunk(
                    index, chunk, sh_degree=sh_degree, refine=refine, extras=extras
                )
            ]
            expected = self._count_codebook_segments(index, rows, sh_degree)
            if len(codebook_rows(index, rows, sh_degree)) < expected:
                index = self._with(every)
            return index

    def _count_codebook_segments(self, index: Index, rows: Iterable[int], sh_degree: int) -> int:
        """Return the number of segments of all codebooks that some segments need."""
        books = self.root.codebooks
        needed = {x for row in rows for x in needed_codebooks(index.segments, row, len(books))}
        return sum(len(codebook_kinds(books[x].attribute, sh_degree)) for x in needed)

    def _pages_of(self, chunks: Iterable[int]) -> I64:
        """Return the page of each chunk; -1 for the root."""
        return np.searchsorted(self._ends, np.array(list(chunks), np.int64), side="right") - 1

    def _with(self, pages: set[int]) -> Index:
        """Read missing pages among `pages` and return an index of all pages read so far."""
        new = sorted(pages - {-1} - self._pages.keys())
        if new or self._joined is None:
            ranges = page_ranges(self._extent, self._positions, new)
            with prefetching(self._source, ranges):
                for number in new:
                    position = self._positions[number]
                    self._pages[number] = read_page(self._source, self.root, number, position)
            self._joined = join_pages(
                self._source, self._extent, self._positions, self._pages, keep_numbers=True
            )
        return self._joined

    def for_description(self, *, pictures: bool) -> Index:
        """Return an index with the row of the description and, on request, of its pictures.

        The root lists the description, the last page its pictures (SPEC 5.13, 5.14). Rows of other
        pages are placeholders.

        Parameters
        ----------
        pictures : bool
            Whether to read the last page.

        Raises
        ------
        CogsplatError
            The page cannot be read, or breaks SPEC.
        """
        with self._lock:
            return self._with({len(self.root.pages) - 1} if pictures else set())

    def whole(self) -> Index:
        """Read all missing pages and return the whole index."""
        with self._lock:
            return self._with(set(range(len(self.root.pages))))
