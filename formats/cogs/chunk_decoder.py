"""Decode all chunks of an open COGS file, a prefix, or a set of chunks (SPEC 8)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import LimitError
from cogsplat.codec.partition.nested_cells import parents
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.segments import codebooks
from cogsplat.codec.segments.attributes import unpack_attributes
from cogsplat.codec.segments.chunk_sets import equivalent_prefixes, has_all_parents
from cogsplat.codec.segments.codebooks import Codebook
from cogsplat.codec.segments.opacities import decode_opacities
from cogsplat.codec.segments.prefix_compensation import Compensation, Layer
from cogsplat.codec.segments.view_shares import ViewTable
from cogsplat.codec.segments.whole_chunk import decode_chunk
from cogsplat.codec.splats import MAX_SH_DEGREE, Splats, sh_coefficients
from cogsplat.codec.streams import decoding_tiers
from cogsplat.codec.threads import ordered_map, thread_count
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.source import (
    Cancel,
    RemoteSource,
    Source,
    stored_bytes,
)

from . import camera_segment, compensation_segment, view_table_segment
from .decoded_rows import SCRATCH_ROW_BYTES, allocate, row_bytes, scratch_bytes
from .drawn_chunks import drawn_chunks
from .fetch_order import opacity_rows, ranges_to_decode
from .index import Index
from .lazy_index import LazyIndex
from .stored_file import StoredFile

# Of one splat while compensation is applied: shifts of two layers and the codes' entries.
_COMPENSATION_ROW_BYTES: Final = 96

PART_SPLATS: Final = 1 << 18
"""Splats that are decoded together where a file is decoded in parts: enough for threads to pay."""

# Below this, and without compiled kernels, threads wait for the interpreter's lock longer than
# they save (measured in numpy: a scene of 80,000 splats takes a third longer on two threads).
_WORTH_THREADS: Final = 50_000

# A third of the work with kernels is done under that lock: more threads wait for each other.
_MOST_WORKERS: Final = 4


class ChunkDecoder(StoredFile):
    """An open file whose chunks are decoded on demand; `reader.CogsFile` adds the rest.

    A context manager; safe to decode from several threads.

    Attributes
    ----------
    root : Root
    segments : SegmentTable
        Of the root and of all pages that are there.
    chunks : ChunkTable
        Likewise.
    offsets : (s,) int64
        Byte offset of each segment.
    missing_bytes : int
        Bytes that a partial source lacks; 0 for a complete one.
    """

    def __init__(self, source: Source, index: Index | LazyIndex, limits: Limits) -> None:
        super().__init__(source, index)
        self._limits = limits
        self._allowed = limits.allowed(stored_bytes(source))
        self._codebooks: dict[tuple[int, int], Codebook] = {}

    def cameras(self) -> list[Camera]:
        """Return the cameras stored in the file; an empty list where there are none.

        Raises
        ------
        TruncatedError
            ``file-truncated``: a partial source does not hold them.
        FormatError, UnsupportedError
            They break SPEC 5.8.
        LimitError
            ``decoded-size``: they take more memory than `Limits` allow.
        """
        row = self.camera_row
        if row is None:
            return []
        if not self.is_present(row):
            raise self._not_there("the segment of cameras")
        payload = bytes(self.read_segment(row))
        return camera_segment.unpack_cameras(payload, f"{self.name}: cameras", self._allowed)

    def view_table(self) -> ViewTable | None:
        """Return what each chunk adds to the pictures of some viewpoints; None where it is absent.

        Raises
        ------
        TruncatedError
            ``file-truncated``: a partial source does not hold it.
        FormatError, UnsupportedError
            It breaks SPEC 5.12.
        LimitError
            ``decoded-size``: its codes take more memory than `Limits` allow.
        """
        row = self.view_table_row
        if row is None:
            return None
        if not self.is_present(row):
            raise self._not_there("the view table")
        payload = bytes(self.read_segment(row))
        return view_table_segment.unpack_view_table(
            payload, f"{self.name}: view table", self._pages.all_chunks, self._allowed
        )

    def compensation(self) -> Compensation:
        """Return the compensation of the scene's prefixes: the layers that are there.

        Raises
        ------
        FormatError, UnsupportedError
            They break SPEC 5.9.
        LimitError
            ``decoded-size``: their codes take more memory than `Limits` allow.
        """
        counts = self.chunks.splats.astype(np.int64)
        splats = counts.tolist()
        layers: list[Layer] = []
        allowed = self._allowed
        for number, row in enumerate(self._index.layers):
            if not self.is_present(row):
                break
            before = layers[-1].chunks if layers else 0
            where = f"{self.name}: compensation, layer {number}"
            payload = bytes(self.read_segment(row))
            layer = compensation_segment.unpack_layer(
                payload, where, before, splats, self._pages.all_chunks, allowed
            )
            if layer is None:
                break
            layers.append(layer)
            allowed -= len(payload) + len(layer.codes)
        # Chunks of pages that are not there count as one.
        rest = self.root.splats - int(counts.sum())
        whole = np.concatenate([counts, [rest]]) if rest else counts
        return Compensation(tuple(layers), whole.astype(np.int64))

    def decode(
        self,
        chunks: Iterable[int] | None = None,
        *,
        sh_degree: int | None = None,
        refine: bool = True,
        extras: bool = True,
        compensate: bool = False,
        level: int | None = None,
        threads: int = 0,
        progress: Progress = silent,
    ) -> Splats:
        """Decode chunks into one scene, in the order given.

        Parameters
        ----------
        chunks : iterable of int, optional
            Chunk numbers; by default those that `level` draws, or all that are complete and have
            not ended (SPEC 5.10).
        sh_degree : int, optional
            Highest SH degree wanted; lower than the file's, bands and perhaps tails are skipped.
        refine : bool
            Whether to read refinements, those that are there; otherwise the coarse values of
            the heads.
        extras : bool
            Whether to read extra attributes of the splats.
        compensate : bool
            Whether to make up for the chunks that are missing (SPEC 8.5). Those asked for must be
            the first ones of the file, in order; of a file that is cut into cells, also any others,
            ascending and each with its parent (5.4).
        level : int, optional
            Level whose opacities the splats have, 0 the coarsest (SPEC 5.11); by default the
            finest that is there.
        threads : int
            0 uses as many as pay. The result does not depend on it.
        progress : Progress

        Returns
        -------
        Splats
            Stored rows, coarse where a partial file lacks the refinement, shN zero where it lacks
            the tail. `Splats.extras` are there where every chunk has them.

        Raises
        ------
        FormatError, UnsupportedError
            The file breaks SPEC.
        TruncatedError
            A chunk asked for by number is not there.
        LimitError
            ``decoded-size``, ``too-many-splats``: more than `Limits` allow.
        """
        if level is not None and not 0 <= level < len(self.root.levels):
            raise ValueError(f"level {level}, expected one of {len(self.root.levels)}")
        count = self.complete_chunks() if level is None else self.root.levels[level].chunks
        wanted = self._wanted(chunks, count)
        prefixes = np.full(len(wanted), count, np.int64)
        if compensate and chunks is not None:
            prefixes = self._prefixes_of(wanted)
        file = self if compensate else self._knowing(wanted, sh_degree, refine, extras)
        decoding_tiers.load_if_worthwhile(int(file.chunks.splats[wanted].sum()))
        shifted = int(self.chunks.splats[wanted].sum()) if compensate else 0
        out = file._decode(
            wanted, sh_degree, refine, extras, level, shifted, threads=threads, progress=progress
        )
        if not compensate:
            return out
        return self.compensation().apply_per_chunk(out, np.array(wanted, np.int64), prefixes)

    def _prefixes_of(self, wanted: Sequence[int]) -> NDArray[np.int64]:
        """Return the prefix that each of some chunks is compensated as (SPEC 8.5)."""
        count = wanted[-1] + 1 if wanted else 0
        if list(wanted) in (list(range(count)), drawn_chunks(self.chunks, count)):
            return np.full(len(wanted), count, np.int64)
        above = parents(self.chunks.cell)
        ascend = all(one < other for one, other in pairwise(wanted))
        if not ascend or not self.chunks.cell.all() or not has_all_parents(wanted, above):
            raise ValueError(
                f"chunks {wanted[:8]} compensated, expected the first ones of the file in order "
                "or, in a file that is cut into cells, ascending ones that each have their parent"
            )
        return equivalent_prefixes(wanted, above, self.chunks.splats.astype(np.int64))

    def _knowing(
        self, chunks: Sequence[int], sh_degree: int | None, refine: bool, extras: bool
    ) -> ChunkDecoder:
        """Return the file with as much of its index as chunks take: of a lazy one, not all."""
        if not isinstance(self._pages, LazyIndex):
            return self
        degree = MAX_SH_DEGREE if sh_degree is None else sh_degree
        index = self._pages.for_chunks(
            chunks, sh_degree=min(self.root.sh_degree, degree), refine=refine, extras=extras
        )
        file = ChunkDecoder(self._source, index, self._limits)
        file._codebooks = self._codebooks
        return file

    def _decode(
        self,
        wanted: list[int],
        sh_degree: int | None,
        refine: bool,
        extras: bool,
        level: int | None = None,
        shifted_splats: int = 0,
        *,
        threads: int,
        progress: Progress = silent,
    ) -> Splats:
        if sh_degree is not None and not 0 <= sh_degree <= MAX_SH_DEGREE:
            raise ValueError(f"SH degree {sh_degree}, expected 0 to {MAX_SH_DEGREE}")
        degree = min(self.root.sh_degree, MAX_SH_DEGREE if sh_degree is None else sh_degree)
        counts = [int(self.chunks.splats[chunk]) for chunk in wanted]
        kinds = self.root.attributes if extras and all(map(self.has_extras, wanted)) else ()
        scratch = scratch_bytes(max(counts, default=0), degree, self.root)
        size = sum(counts) * row_bytes(degree, kinds) + scratch
        size += shifted_splats * _COMPENSATION_ROW_BYTES
        # Before codebooks are read, so that a file that is too large is refused at once.
        self._limits.require_splats(sum(counts), self.name)
        self._check_size(size, f"{sum(counts)} splats")
        with self._fetching(wanted, degree, refine=refine, extras=bool(kinds), level=level):
            # Codebooks first, on this thread, so that the workers only read them.
            for chunk in wanted:
                self._load_codebooks(chunk, degree)
            self._check_size(size, f"{sum(counts)} splats")
            out = allocate(sum(counts), degree, self.root, kinds)
            stops = np.cumsum(counts).tolist()
            tasks = [
                (chunk, out.take(slice(stop - count, stop)))
                for chunk, count, stop in zip(wanted, counts, stops, strict=True)
            ]

            def decode_one(task: tuple[int, Splats]) -> None:
                self._decode_chunk(*task, refine=refine, level=level)

            # More workers take the working memory of a chunk each: as many as the limit allows.
            room = 1 + (self._allowed - size) // max(scratch, 1)
            workers = min(thread_count(threads or _workers(sum(counts))), room, len(tasks) or 1)
            for done, _ in enumerate(ordered_map(decode_one, tasks, workers), start=1):
                progress("decode", done, len(tasks))
        return out

    def decode_parts(
        self,
        chunks: Iterable[int] | None = None,
        *,
        sh_degree: int | None = None,
        refine: bool = True,
        extras: bool = True,
        most_splats: int = PART_SPLATS,
        threads: int = 0,
        progress: Progress = silent,
    ) -> Iterator[Splats]:
        """Decode chunks as `decode` does, a few at a time: memory does not grow with the file.

        Parameters
        ----------
        chunks, sh_degree, refine, extras, threads, progress
            As in `decode`.
        most_splats : int
            Splats of a part, at most, unless one chunk has more.

        Yields
        ------
        Splats
            Whole chunks; joined they are what `decode` returns. All have the same extra attributes.

        Raises
        ------
        CogsplatError
            As `decode`; a file that is too large as a whole is refused before the first part.
        """
        wanted = self._wanted(chunks, self.complete_chunks())
        file = self._knowing(wanted, sh_degree, refine, extras)
        extras = extras and all(map(file.has_extras, wanted))
        degree = min(self.root.sh_degree, MAX_SH_DEGREE if sh_degree is None else sh_degree)
        counts = [int(file.chunks.splats[chunk]) for chunk in wanted]
        kinds = self.root.attributes if extras else ()
        self._limits.require_splats(sum(counts), self.name)
        self._check_size(sum(counts) * row_bytes(degree, kinds), f"{sum(counts)} splats")
        decoding_tiers.load_if_worthwhile(sum(counts))
        first = 0
        with file._fetching(wanted, degree, refine=refine, extras=bool(kinds)):
            while first < len(wanted):
                stop, rows = first + 1, counts[first]
                while stop < len(wanted) and rows + counts[stop] <= most_splats:
                    rows += counts[stop]
                    stop += 1
                yield file._decode(wanted[first:stop], sh_degree, refine, extras, threads=threads)
                progress("decode", stop, len(wanted))
                first = stop

    def iter_chunks(self, *, sh_degree: int | None = None, refine: bool = True) -> Iterator[Splats]:
        """Decode the chunks that are complete and have not ended one by one."""
        for chunk in self._wanted(None, self.complete_chunks()):
            yield self.decode([chunk], sh_degree=sh_degree, refine=refine, threads=1)

    def load_codebook(self, book: int) -> Codebook:
        """Return the rows of a codebook, all of its bands.

        Raises
        ------
        FormatError, UnsupportedError, LimitError
            Its segments break SPEC 7.1 or the limits.
        """
        return self._load_codebook(book, self.root.sh_degree)

    def require_size(self) -> None:
        """Refuse a file of which all splats at full degree take more than the limits allow.

        Raises
        ------
        LimitError
            ``decoded-size``.
        """
        each = row_bytes(self.root.sh_degree, self.root.attributes)
        counts = self.chunks.splats.tolist()
        scratch = scratch_bytes(max(counts, default=0), self.root.sh_degree, self.root)
        self._check_size(sum(counts) * each + scratch, f"{sum(counts)} splats")

    def _fetching(
        self,
        chunks: Sequence[int],
        degree: int,
        *,
        refine: bool,
        extras: bool,
        level: int | None = None,
    ) -> AbstractContextManager[Cancel]:
        """Have what chunks take fetched ahead, in a few requests, as long as the block lasts."""
        if not isinstance(self._source, RemoteSource):
            return nullcontext(lambda: None)
        return self._source.prefetch(
            ranges_to_decode(
                self._index,
                chunks,
                sh_degree=degree,
                refine=refine,
                extras=extras,
                level=level,
                is_kept=self.is_kept,
            ),
            any_order=True,
        )

    def _wanted(self, chunks: Iterable[int] | None, count: int) -> list[int]:
        """Return the chunks asked for, by default those that a prefix of `count` draws."""
        wanted = drawn_chunks(self.chunks, count) if chunks is None else list(chunks)
        for chunk in wanted:
            self._require_chunk(chunk)
        return wanted

    def _check_size(self, size: int, what: str) -> None:
        """Refuse to allocate `size` bytes beside the codebooks that are there already."""
        size += sum(book.nbytes for book in self._codebooks.values())
        if size > self._allowed:
            raise LimitError(
                "decoded-size",
                f"{self.name}: {what} and codebooks take {size} bytes, expected at most "
                f"{self._allowed} from {self._source.size} bytes (SPEC 9.2)",
            )

    def _load_codebooks(self, chunk: int, degree: int) -> None:
        tail = int(self._index.tails[chunk])
        with_tail = degree > 0 and tail >= 0 and self.has_tail(chunk, degree)
        books = self._shapes_needed(int(self._index.heads[chunk]))
        for book in [*books, *(self._needed(tail) if with_tail else ())]:
            key = self._codebook_key(book, degree)
            if key not in self._codebooks:
                self._codebooks[key] = self._load_codebook(book, degree)

    def _shapes_needed(self, head: int) -> list[int]:
        """Return the codebooks that a head uses: those of shapes, whatever it states (SPEC 8.2)."""
        books = self.root.codebooks
        return [book for book in self._needed(head) if books[book].attribute == "shape"]

    def _codebook_key(self, book: int, degree: int) -> tuple[int, int]:
        return book, degree if self.root.codebooks[book].attribute == "colour" else 0

    def _load_codebook(self, book: int, degree: int) -> Codebook:
        entry = self.root.codebooks[book]
        where = f"{self.name}: codebook {book}"
        rows = self._codebook_rows(book, degree)
        if rows is None:
            raise self._not_there(f"a segment of codebook {book}")
        row = 28 if entry.attribute == "shape" else 12 * (sh_coefficients(degree) - 1)
        self._check_size(entry.rows * (row + SCRATCH_ROW_BYTES), where)
        if entry.attribute == "shape":
            return codebooks.decode_shape_codebook(self.read_segment(rows[0]), entry.rows, where)
        payloads = {band: self.read_segment(row) for band, row in enumerate(rows, start=1)}
        return codebooks.decode_colour_codebook(payloads, entry.rows, degree, where)

    def _decode_chunk(self, chunk: int, out: Splats, *, refine: bool, level: int | None) -> None:
        degree = out.sh_degree
        head = int(self._index.heads[chunk])
        where = f"{self.name}: chunk {chunk}"
        payload = self.read_segment(head)
        row = int(self._index.refinements[chunk])
        finer = self.read_segment(row) if refine and row >= 0 and self.is_present(row) else None
        later = opacity_rows(self._index, chunk, level)
        if level is None:
            later = [row for row in later if self.is_present(row)]
        logits = self.read_segment(later[-1]) if later else None
        tail = int(self._index.tails[chunk])
        with_tail = degree > 0 and tail >= 0 and self.has_tail(chunk, degree)
        coefficients = self.read_segment(tail) if with_tail else None
        extras = self.read_segment(int(self._index.attributes[chunk])) if out.extras else None
        # All CRCs were checked before anything is decoded, in the order of SPEC 7.6.
        shapes = self._books(self._shapes_needed(head), degree)
        colours = self._books(self._needed(tail), degree) if with_tail else {}
        most = self.root.sh_degree
        decode_chunk(payload, finer, coefficients, (shapes, colours), out, where, sh_degree=most)
        if logits is not None:
            decode_opacities(logits, out.opacities, f"{where} opacities")
        if extras is not None:
            unpack_attributes(extras, self.root.attributes, out.extras, f"{where} attributes")

    def _books(self, books: Sequence[int], degree: int) -> dict[int, Codebook]:
        keys = {book: self._codebook_key(book, degree) for book in books}
        return {book: self._codebooks[key] for book, key in keys.items()}


def _workers(splats: int) -> int:
    """Return how many threads pay."""
    pays = decoding_tiers.is_compiled() and splats >= _WORTH_THREADS
    return min(thread_count(0), _MOST_WORKERS) if pays else 1
