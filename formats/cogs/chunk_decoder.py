"""Decode chunks of an open COGS file (SPEC 8)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import LimitError
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.segments.attributes import unpack_attributes
from cogsplat.codec.segments.chunk_sets import (
    descendant_parts,
    equivalent_prefixes,
    has_all_parents,
)
from cogsplat.codec.segments.codebooks import Codebook, EncodedCodebook
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

from . import (
    camera_segment,
    compensation_segment,
    description_segment,
    view_table_segment,
)
from .decoded_rows import SCRATCH_ROW_BYTES, allocate, row_bytes, scratch_bytes
from .description import Description, Picture
from .fetch_order import opacity_rows, ranges_to_decode
from .known_chunks import known_chunks
from .lazy_index import LazyIndex
from .scene_index import SceneIndex
from .stored_file import StoredFile

# Working memory per splat of compensation, bytes: shifts of two layers, and codebook entries.
_COMPENSATION_ROW_BYTES: Final = 96

PART_SPLATS: Final = 1 << 18
"""Default size of a part in `decode_parts`, splats: enough for threads to save time."""

# Minimum number of splats for several threads. Below it, and without compiled kernels, the
# interpreter's lock costs more than threads save (in numpy, 80,000 splats take a third longer on
# two threads).
_WORTH_THREADS: Final = 50_000

# With kernels, a third of the work still holds that lock, so more threads wait for each other.
_MAX_WORKERS: Final = 4


class ChunkDecoder(StoredFile):
    """Open file whose chunks are decoded on demand. A context manager.

    Safe to decode from several threads. `reader.CogsFile` adds streaming and verification.

    Parameters
    ----------
    source : Source
        Source of the file, closed with it.
    index : SceneIndex or LazyIndex
        Index of the file.
    limits : Limits
        Memory and size limits.
    """

    def __init__(self, source: Source, index: SceneIndex | LazyIndex, limits: Limits) -> None:
        super().__init__(source, index)
        self._limits = limits
        self._allowed = limits.allowed(stored_bytes(source))
        self._codebooks: dict[tuple[int, int], Codebook] = {}

    def cameras(self) -> list[Camera]:
        """Return the cameras stored in the file; an empty list for none.

        Raises
        ------
        TruncatedError
            ``file-truncated``: a partial source lacks the cameras.
        FormatError, UnsupportedError
            The segment breaks SPEC 5.8.
        LimitError
            ``decoded-size``: the cameras exceed the memory of `Limits`.
        """
        index = self._pages.for_path(())
        if index.cameras < 0:
            return []
        root = ChunkDecoder(self._source, index, self._limits)
        payload = bytes(root._read_present(index.cameras, "the segment of cameras"))
        return camera_segment.unpack_cameras(payload, f"{self.name}: cameras", self._allowed)

    def description(self, *, pictures: bool = False) -> Description | None:
        """Return the description of the scene; None for none.

        Over a network, one small segment is read, and pages only for pictures.

        Parameters
        ----------
        pictures : bool
            Whether to read the files of the pictures as well, whose headers are then checked.

        Raises
        ------
        TruncatedError
            ``file-truncated``: a partial source lacks the description or a picture.
        FormatError, UnsupportedError
            The segments break SPEC 5.13 or 5.14.
        LimitError
            ``decoded-size``: the description exceeds the memory of `Limits`.
        """
        index = self._pages.for_description(pictures=False)
        if index.description < 0:
            return None
        root = ChunkDecoder(self._source, index, self._limits)
        where = f"{self.name}: description"
        payload = bytes(root._read_present(index.description, "the description"))
        found = description_segment.unpack_description(payload, where, self._allowed)
        if not pictures:
            return found
        index = self._pages.for_description(pictures=True)
        last = ChunkDecoder(self._source, index, self._limits)
        # A partial file may lack the page that lists the pictures.
        if any(each.lists_pictures for each in index.indices):
            description_segment.require_pictures(found, index.pictures, self.name)
        filled: dict[str, Picture] = {}
        for name, picture in found.pictures().items():
            if name not in index.pictures:
                raise self._missing_error(f"the {name}")
            data = bytes(last._read_present(index.pictures[name], f"the {name}"))
            description_segment.check_picture(picture, data, f"{self.name}: {name}")
            filled[name] = replace(picture, data=data)
        return found.with_pictures(filled)

    def _read_present(self, row: int, what: str) -> memoryview:
        """Return the bytes of a segment, or raise ``file-truncated``."""
        if not self.is_present(row):
            raise self._missing_error(what)
        return self.read_segment(row)

    def view_table(self, path: tuple[int, ...] = ()) -> ViewTable | None:
        """Return the view table of an index, the contribution of each chunk to some views.

        Its columns are the chunks and then the pages that the index lists.

        Parameters
        ----------
        path : tuple of int
            Rows of the pages on the way from the root to the index; by default the root.

        Returns
        -------
        ViewTable or None
            None where the index lists no table.

        Raises
        ------
        TruncatedError
            ``file-truncated``: a partial source lacks the view table.
        FormatError, UnsupportedError
            The segment breaks SPEC 5.12.
        LimitError
            ``decoded-size``: the codes exceed the memory of `Limits`.
        """
        index = self._pages.for_path(path)
        row, listed = index.view_tables.get(path), index.at(path)
        if row is None or listed is None:
            return None
        file = ChunkDecoder(self._source, index, self._limits)
        payload = bytes(file._read_present(row, "the view table"))
        columns = len(listed.tables.chunks) + len(listed.tables.pages)
        return view_table_segment.unpack_view_table(
            payload, f"{self.name}: view table", columns, self._allowed
        )

    def compensation(self) -> Compensation:
        """Return the compensation of prefixes, from the layers received so far.

        Raises
        ------
        FormatError, UnsupportedError
            A layer breaks SPEC 5.9.
        LimitError
            ``decoded-size``: the codes exceed the memory of `Limits`.
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
        # The chunks of missing pages count as one chunk.
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
        """Decode chunks into one scene, in the given order.

        Parameters
        ----------
        chunks : iterable of int, optional
            Chunk numbers. By default the chunks that `level` draws, or all complete chunks without
            ended preview chunks (SPEC 5.10).
        sh_degree : int, optional
            Highest SH degree to decode; by default the file's.
        refine : bool
            Whether to apply the refinements received so far to the coarse values of the heads.
        extras : bool
            Whether to decode extra attributes.
        compensate : bool
            Whether to apply the compensation for missing chunks (SPEC 8.5). `chunks` must then be a
            prefix of the file. In a file cut into cells, `chunks` may also be any ascending numbers
            that include the parent of each chunk (5.4).
        level : int, optional
            Level whose opacities to decode, 0 the coarsest (SPEC 5.11); by default the finest
            received so far.
        threads : int
            Number of threads; 0 chooses. The result does not depend on it.
        progress : Progress
            Callback, called with ``("decode", chunks done, chunks)``.

        Returns
        -------
        Splats
            Decoded splats. In a partial file, values without their refinement are coarse, and shN
            without its tail is zero. `Splats.extras` are present if every chunk has them.

        Raises
        ------
        FormatError, UnsupportedError
            The file breaks SPEC.
        TruncatedError
            A requested chunk is missing.
        LimitError
            ``decoded-size``, ``too-many-splats``: `Limits` are exceeded.
        """
        if level is not None and not 0 <= level < len(self.root.levels):
            raise ValueError(f"level {level}, expected one of {len(self.root.levels)}")
        count = self.complete_chunks() if level is None else self.root.levels[level].chunks
        wanted = self._chunk_list(chunks, count)
        file = self if compensate else self._with_pages_above(wanted)
        decoding_tiers.load_if_worthwhile(int(file.chunks.splats[wanted].sum()))
        shifted = int(self.chunks.splats[wanted].sum()) if compensate else 0
        out = file._decode(
            wanted, sh_degree, refine, extras, level, shifted, threads=threads, progress=progress
        )
        if not compensate:
            return out
        return self._compensated(out, wanted, count if chunks is None else None)

    def _compensated(self, splats: Splats, wanted: Sequence[int], prefix: int | None) -> Splats:
        """Return the splats of chunks compensated for the missing ones (SPEC 8.5).

        Parameters
        ----------
        splats : Splats
            Decoded splats.
        wanted : sequence of int
            Their chunks.
        prefix : int, optional
            Length of the prefix that they are, in chunks; found if it is not given.
        """
        compensation, numbers = self.compensation(), np.array(wanted, np.int64)
        count = (wanted[-1] + 1 if wanted else 0) if prefix is None else prefix
        if prefix is None and list(wanted) in (list(range(count)), self.drawn_chunks(count)):
            prefix = count
        if prefix is None or (self.chunks.cell.all() and len(self.chunks)):
            # Rows of these chunks are their numbers: unread pages stand behind all of them.
            known = known_chunks(self._index)
            held = list(range(prefix)) if prefix is not None else list(wanted)
            ascend = all(one < other for one, other in pairwise(held))
            if not ascend or not self.chunks.cell.all() or not has_all_parents(held, known.parents):
                raise ValueError(
                    f"chunks {wanted[:8]} with compensation, expected a prefix of the file or, in "
                    "a file cut into cells, ascending chunks that include their parents"
                )
            rows = np.searchsorted(held, numbers)
            prefixes = equivalent_prefixes(held, known.parents, known.splats)[rows]
            parts = descendant_parts(held, known.parents, known.splats, compensation.last_chunks)[
                rows
            ]
            return compensation.apply_per_chunk(splats, numbers, prefixes, parts)
        return compensation.apply_per_chunk(splats, numbers, np.full(len(numbers), prefix))

    def _with_pages_above(self, chunks: Sequence[int]) -> ChunkDecoder:
        """Return the file with an index that covers some chunks, without reading all pages."""
        if not isinstance(self._pages, LazyIndex):
            return self
        file = ChunkDecoder(self._source, self._pages.for_chunks(chunks), self._limits)
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
        """Decode chunks after checks of degree and size; see `decode`.

        The size check includes the compensation of `shifted_splats` splats.
        """
        if sh_degree is not None and not 0 <= sh_degree <= MAX_SH_DEGREE:
            raise ValueError(f"SH degree {sh_degree}, expected 0 to {MAX_SH_DEGREE}")
        degree = min(self.root.sh_degree, MAX_SH_DEGREE if sh_degree is None else sh_degree)
        counts = [int(self.chunks.splats[chunk]) for chunk in wanted]
        kinds = self.root.attributes if extras and all(map(self.has_extras, wanted)) else ()
        scratch = scratch_bytes(max(counts, default=0), degree, self.root)
        size = sum(counts) * row_bytes(degree, kinds) + scratch
        size += shifted_splats * _COMPENSATION_ROW_BYTES
        # Checked before codebooks are read, so that a file that is too large fails at once.
        self._limits.require_splats(sum(counts), self.name)
        self._check_size(size, f"{sum(counts)} splats")
        with self._prefetch(wanted, degree, refine=refine, extras=bool(kinds), level=level):
            # Codebooks are loaded on this thread, so that workers only read them.
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

            # Each worker needs the working memory of a chunk; the memory limit caps their number.
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
        max_splats: int = PART_SPLATS,
        threads: int = 0,
        progress: Progress = silent,
    ) -> Iterator[Splats]:
        """Decode a few chunks at a time, in memory that does not grow with the file.

        Parameters
        ----------
        chunks, sh_degree, refine, extras, threads, progress
            As in `decode`.
        max_splats : int
            Maximum number of splats per part; a larger chunk is a part of its own.

        Yields
        ------
        Splats
            Splats of whole chunks; concatenated, the result of `decode`. All parts have the same
            extra attributes.

        Raises
        ------
        CogsplatError
            The errors of `decode`; limits apply to all parts together, before the first.
        """
        wanted = self._chunk_list(chunks, self.complete_chunks())
        file = self._with_pages_above(wanted)
        extras = extras and all(map(file.has_extras, wanted))
        degree = min(self.root.sh_degree, MAX_SH_DEGREE if sh_degree is None else sh_degree)
        counts = [int(file.chunks.splats[chunk]) for chunk in wanted]
        kinds = self.root.attributes if extras else ()
        self._limits.require_splats(sum(counts), self.name)
        self._check_size(sum(counts) * row_bytes(degree, kinds), f"{sum(counts)} splats")
        decoding_tiers.load_if_worthwhile(sum(counts))
        first = 0
        with file._prefetch(wanted, degree, refine=refine, extras=bool(kinds)):
            while first < len(wanted):
                stop, rows = first + 1, counts[first]
                while stop < len(wanted) and rows + counts[stop] <= max_splats:
                    rows += counts[stop]
                    stop += 1
                yield file._decode(wanted[first:stop], sh_degree, refine, extras, threads=threads)
                progress("decode", stop, len(wanted))
                first = stop

    def iter_chunks(self, *, sh_degree: int | None = None, refine: bool = True) -> Iterator[Splats]:
        """Yield the splats of each leading chunk whose head can be decoded, one chunk at a time.

        Preview chunks that later chunks have replaced are left out.
        """
        for chunk in self._chunk_list(None, self.complete_chunks()):
            yield self.decode([chunk], sh_degree=sh_degree, refine=refine, threads=1)

    def load_codebook(self, book: int) -> Codebook:
        """Return a codebook with all its SH bands.

        Raises
        ------
        FormatError, UnsupportedError, LimitError
            The segments break SPEC 7.1 or the limits.
        """
        return self._load_codebook(book, self.root.sh_degree)

    def stored_codebook(self, book: int, sh_degree: int | None = None) -> EncodedCodebook:
        """Return a codebook as it is stored, for files that shall have the same.

        Parameters
        ----------
        book : int
            Number of the codebook.
        sh_degree : int, optional
            Highest SH degree of its bands; by default the file's.

        Raises
        ------
        TruncatedError
            ``file-truncated``: a partial source lacks a segment of it.
        FormatError
            ``segment-crc``.
        """
        entry = self.root.codebooks[book]
        rows = self._codebook_rows(book, self.root.sh_degree if sh_degree is None else sh_degree)
        if rows is None:
            raise self._missing_error(f"a segment of codebook {book}")
        payloads = tuple(bytes(self.read_segment(row)) for row in rows)
        return EncodedCodebook(entry.attribute, entry.rows, payloads)

    def require_size(self) -> None:
        """Refuse a file whose splats, decoded at full SH degree, exceed the limits.

        Raises
        ------
        LimitError
            ``decoded-size``.
        """
        each = row_bytes(self.root.sh_degree, self.root.attributes)
        counts = self.chunks.splats.tolist()
        scratch = scratch_bytes(max(counts, default=0), self.root.sh_degree, self.root)
        self._check_size(sum(counts) * each + scratch, f"{sum(counts)} splats")

    def _prefetch(
        self,
        chunks: Sequence[int],
        degree: int,
        *,
        refine: bool,
        extras: bool,
        level: int | None = None,
    ) -> AbstractContextManager[Cancel]:
        """Prefetch the segments of chunks in a few requests, until the block ends."""
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
                is_cached=self.is_cached,
            ),
            any_order=True,
        )

    def _chunk_list(self, chunks: Iterable[int] | None, count: int) -> list[int]:
        """Check chunk numbers; by default, return the chunks that a prefix of `count` draws."""
        wanted = self.drawn_chunks(count) if chunks is None else list(chunks)
        for chunk in wanted:
            self._require_chunk(chunk)
        return wanted

    def _check_size(self, size: int, what: str) -> None:
        """Refuse an allocation of `size` bytes that, with loaded codebooks, exceeds the limit."""
        size += sum(book.nbytes for book in self._codebooks.values())
        if size > self._allowed:
            raise LimitError(
                "decoded-size",
                f"{self.name}: {what} and codebooks take {size} bytes, expected at most "
                f"{self._allowed} for a source of {self._source.size} bytes (SPEC 9.2)",
            )

    def _load_codebooks(self, chunk: int, degree: int) -> None:
        """Load the codebooks of a chunk that are not loaded yet."""
        tail = int(self._index.tails[chunk])
        with_tail = degree > 0 and tail >= 0 and self.has_tail(chunk, degree)
        books = self._shapes_needed(int(self._index.heads[chunk]))
        for book in [*books, *(self._needed_codebooks(tail) if with_tail else ())]:
            key = self._codebook_key(book, degree)
            if key not in self._codebooks:
                self._codebooks[key] = self._load_codebook(book, degree)

    def _shapes_needed(self, head: int) -> list[int]:
        """Return the shape codebooks that a head, given by its segment row, needs (SPEC 8.2)."""
        books = self.root.codebooks
        return [book for book in self._needed_codebooks(head) if books[book].attribute == "shape"]

    def _codebook_key(self, book: int, degree: int) -> tuple[int, int]:
        """Return the key of a loaded codebook: its number, and the SH degree of a colour one."""
        return book, degree if self.root.codebooks[book].attribute == "colour" else 0

    def _load_codebook(self, book: int, degree: int) -> Codebook:
        """Read and decode a codebook up to an SH degree."""
        entry = self.root.codebooks[book]
        where = f"{self.name}: codebook {book}"
        row = 28 if entry.attribute == "shape" else 12 * (sh_coefficients(degree) - 1)
        self._check_size(entry.rows * (row + SCRATCH_ROW_BYTES), where)
        return self.stored_codebook(book, degree).decode(degree, where)

    def _decode_chunk(self, chunk: int, out: Splats, *, refine: bool, level: int | None) -> None:
        """Decode one chunk into preallocated splats."""
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
        # All CRCs have been checked before decoding begins, in the order of SPEC 7.6.
        shapes = self._loaded_codebooks(self._shapes_needed(head), degree)
        colours = self._loaded_codebooks(self._needed_codebooks(tail), degree) if with_tail else {}
        most = self.root.sh_degree
        decode_chunk(payload, finer, coefficients, (shapes, colours), out, where, sh_degree=most)
        if logits is not None:
            decode_opacities(logits, out.opacities, f"{where} opacities")
        if extras is not None:
            unpack_attributes(extras, self.root.attributes, out.extras, f"{where} attributes")

    def _loaded_codebooks(self, books: Sequence[int], degree: int) -> dict[int, Codebook]:
        """Return loaded codebooks by number."""
        keys = {book: self._codebook_key(book, degree) for book in books}
        return {book: self._codebooks[key] for book, key in keys.items()}


def _workers(splats: int) -> int:
    """Return the number of threads that decode a number of splats fastest."""
    pays = decoding_tiers.is_compiled() and splats >= _WORTH_THREADS
    return min(thread_count(0), _MAX_WORKERS) if pays else 1
