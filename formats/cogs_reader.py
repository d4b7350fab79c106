"""Open a COGS file and decode all of it, a prefix, or a set of chunks (SPEC 8)."""

from __future__ import annotations

import hashlib
import os
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec import decoder
from cogsplat.codec.decoder import Codebook
from cogsplat.codec.errors import FormatError, LimitError, TruncatedError
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import MAX_SH_DEGREE, Splats, empty, sh_coefficients

from . import cogs_layout as layout
from . import cogs_root, strict_msgpack
from .cogs_layout import SegmentKind
from .cogs_root import ChunkTable, CodebookEntry, Root, SegmentTable
from .source import Source

# Means, scales, quats, opacities and sh0 of one splat, float32.
_HEAD_ROW_BYTES: Final = 4 * (3 + 3 + 4 + 1 + 3)


@dataclass(frozen=True)
class Limits:
    """What a reader allocates at most for a file it does not trust (SPEC 9.2).

    Parameters
    ----------
    decoded_bytes : int
        Bytes of all decoded arrays together.
    expansion : int
        Decoded bytes per byte of the file, for results above 64 MiB.
    """

    decoded_bytes: int = 1 << 35
    expansion: int = 4096


_SMALL_RESULT: Final = 64 * 1024 * 1024


class CogsFile:
    """An open file: its root, its tables, and its chunks on demand.

    Use `open_cogs`. A context manager; safe to decode from several threads.

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

    def __init__(self, source: Source, root: Root, limits: Limits, file_length: int) -> None:
        self.root = root
        self._source = source
        self._limits = limits
        self.file_length = file_length
        self.missing_bytes = max(0, file_length - source.size)
        self.segments = root.segments
        self.chunks = root.chunks
        self.offsets: NDArray[np.int64] = np.zeros(0, np.int64)
        self._codebooks: dict[tuple[int, int], Codebook] = {}
        self._head_rows: NDArray[np.int64] = np.zeros(0, np.int64)
        self._tail_rows: NDArray[np.int64] = np.zeros(0, np.int64)

    def __enter__(self) -> CogsFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the source."""
        self._source.close()

    @property
    def name(self) -> str:
        """Names the file in messages."""
        return self._source.name

    @property
    def num_chunks(self) -> int:
        """Chunks the tables list; a partial file may lack the last pages' chunks."""
        return len(self.chunks)

    @property
    def page_bytes(self) -> int:
        """Bytes of all index pages."""
        return sum(page.length for page in self.root.pages)

    def complete_chunks(self) -> int:
        """Return how many chunks, counted from the first, have heads that can be decoded."""
        for chunk in range(self.num_chunks):
            row = int(self._head_rows[chunk])
            if not (self._present(row) and self._needs_present(row)):
                return chunk
        return self.num_chunks

    def has_tail(self, chunk: int) -> bool:
        """Whether a chunk's shN can be decoded, or there is none to decode."""
        row = int(self._tail_rows[chunk])
        return row < 0 or (self._present(row) and self._needs_present(row))

    def chunks_for_splats(self, splats: int) -> int:
        """Return how many whole chunks hold at least `splats` splats, or all chunks there are."""
        reached = np.cumsum(self.chunks.splats.astype(np.int64)) >= splats
        if splats <= 0:
            return 0
        return int(reached.argmax()) + 1 if reached.any() else self.num_chunks

    def read_segment(self, row: int) -> memoryview:
        """Return a segment's bytes, its CRC checked.

        Raises
        ------
        TruncatedError
            ``file-truncated``: a partial source does not hold it.
        FormatError
            ``segment-crc``.
        """
        offset = int(self.offsets[row])
        length = int(self.segments.length[row])
        data = self._source.read(offset, length)
        if zlib.crc32(data) != int(self.segments.crc[row]):
            raise FormatError(
                "segment-crc",
                f"{self.name}: segment {row} at byte {offset}, {length} bytes: "
                "its CRC does not match the table's",
                clause="5.3",
                offset=offset,
            )
        return memoryview(data)

    def decode(
        self,
        chunks: Iterable[int] | None = None,
        *,
        sh_degree: int | None = None,
        threads: int = 0,
        progress: Progress = silent,
    ) -> Splats:
        """Decode chunks into one scene, in the order given.

        Parameters
        ----------
        chunks : iterable of int, optional
            Chunk numbers; by default all that are complete.
        sh_degree : int, optional
            Highest SH degree wanted; lower than the file's, bands and perhaps tails are skipped.
        threads : int
            0 uses all cores. The result does not depend on it.
        progress : Progress

        Returns
        -------
        Splats
            Stored rows, shN zero where a partial file lacks the tail.

        Raises
        ------
        FormatError, UnsupportedError
            The file breaks SPEC.
        TruncatedError
            A chunk asked for by number is not there.
        LimitError
            ``decoded-size``: more than `Limits` allow.
        """
        if sh_degree is not None and not 0 <= sh_degree <= MAX_SH_DEGREE:
            raise ValueError(f"SH degree {sh_degree}, expected 0 to {MAX_SH_DEGREE}")
        wanted = list(range(self.complete_chunks()) if chunks is None else chunks)
        for chunk in wanted:
            if not 0 <= chunk < self.num_chunks:
                raise ValueError(f"chunk {chunk}, expected 0 to {self.num_chunks - 1}")
        degree = min(self.root.sh_degree, MAX_SH_DEGREE if sh_degree is None else sh_degree)
        counts = [int(self.chunks.splats[chunk]) for chunk in wanted]
        self._check_size(sum(counts), degree)
        out = _allocate(sum(counts), degree, self.root)
        stops = np.cumsum(counts).tolist()
        tasks = [
            (chunk, out.take(slice(stop - count, stop)))
            for chunk, count, stop in zip(wanted, counts, stops, strict=True)
        ]
        # Codebooks first, on this thread, so that the workers only read them.
        for chunk in wanted:
            self._load_codebooks(chunk, degree)
        workers = min(threads or os.cpu_count() or 1, len(tasks))
        done = 0
        if workers <= 1:
            for chunk, rows in tasks:
                self._decode_chunk(chunk, rows)
                done += 1
                progress("decode", done, len(tasks))
            return out
        with ThreadPoolExecutor(workers) as pool:
            try:
                for _ in pool.map(lambda task: self._decode_chunk(*task), tasks):
                    done += 1
                    progress("decode", done, len(tasks))
            except BaseException:
                pool.shutdown(wait=True, cancel_futures=True)
                raise
        return out

    def iter_chunks(self, *, sh_degree: int | None = None) -> Iterator[Splats]:
        """Decode the complete chunks one by one."""
        for chunk in range(self.complete_chunks()):
            yield self.decode([chunk], sh_degree=sh_degree, threads=1)

    def verify(self, progress: Progress = silent) -> None:
        """Check every segment's CRC and hash and decode every chunk.

        Raises
        ------
        FormatError
            ``segment-crc``, ``segment-hash``, or what decoding finds.
        """
        for row in range(len(self.segments)):
            digest = hashlib.sha256(self.read_segment(row)).digest()[: cogs_root.HASH_BYTES]
            if digest != self.segments.hash[row].tobytes():
                raise FormatError(
                    "segment-hash",
                    f"{self.name}: segment {row}: its SHA-256 does not match the table's",
                    clause="5.3",
                    offset=int(self.offsets[row]),
                )
            progress("verify", row + 1, len(self.segments))
        for chunk in range(self.num_chunks):
            self.decode([chunk])

    def segment_rows(self, kind: SegmentKind, owner: int) -> list[int]:
        """Return the rows of the segments of a kind that belong to a chunk or codebook."""
        mask = (self.segments.kind == kind) & (self.segments.owner == owner)
        return [int(row) for row in np.flatnonzero(mask)]

    def _present(self, row: int) -> bool:
        return bool(self.offsets[row] + self.segments.length[row] <= self._source.size)

    def _needs_present(self, row: int) -> bool:
        return all(
            self._present(need)
            for book in self._needed(row)
            for need in self._codebook_rows(book, self.root.sh_degree)
        )

    def _needed(self, row: int) -> list[int]:
        needs = int(self.segments.needs[row])
        return [book for book in range(len(self.root.codebooks)) if needs >> book & 1]

    def _codebook_rows(self, book: int, degree: int) -> list[int]:
        kinds: Sequence[SegmentKind]
        if self.root.codebooks[book].attribute == "shape":
            kinds = [SegmentKind.SHAPE_CODEBOOK]
        else:
            kinds = layout.COLOUR_BANDS[:degree]
        return [row for kind in kinds for row in self.segment_rows(kind, book)]

    def _check_size(self, splats: int, degree: int) -> None:
        size = splats * (_HEAD_ROW_BYTES + 12 * (sh_coefficients(degree) - 1))
        limits = self._limits
        allowed = min(
            limits.decoded_bytes, max(_SMALL_RESULT, limits.expansion * self._source.size)
        )
        if size > allowed:
            raise LimitError(
                "decoded-size",
                f"{self.name}: {splats} splats take {size} bytes, expected at most {allowed} "
                f"from a file of {self._source.size} bytes (SPEC 9.2)",
            )

    def _load_codebooks(self, chunk: int, degree: int) -> None:
        rows = [int(self._head_rows[chunk])]
        if degree and self._tail_rows[chunk] >= 0 and self.has_tail(chunk):
            rows.append(int(self._tail_rows[chunk]))
        for row in rows:
            for book in self._needed(row):
                entry = self.root.codebooks[book]
                key = (book, degree if entry.attribute == "colour" else 0)
                if key not in self._codebooks:
                    self._codebooks[key] = self._load_codebook(book, entry, degree)

    def _load_codebook(self, book: int, entry: CodebookEntry, degree: int) -> Codebook:
        where = f"{self.name}: codebook {book}"
        rows = self._codebook_rows(book, degree)
        # Nothing is allocated for rows that no segment brings.
        self._check_size(entry.rows, degree)
        if entry.attribute == "shape":
            return decoder.decode_shape_codebook(self.read_segment(rows[0]), entry.rows, where)
        payloads = {band: self.read_segment(row) for band, row in enumerate(rows, start=1)}
        return decoder.decode_colour_codebook(payloads, entry.rows, degree, where)

    def _decode_chunk(self, chunk: int, out: Splats) -> None:
        degree = out.sh_degree
        head = int(self._head_rows[chunk])
        where = f"{self.name}: chunk {chunk}"
        payload = self.read_segment(head)
        decoder.decode_head(payload, self._books(head, degree), out, f"{where} head")
        if not degree:
            return
        tail = int(self._tail_rows[chunk])
        if tail < 0 or not self.has_tail(chunk):
            out.shN[:] = 0
            return
        payload = self.read_segment(tail)
        decoder.decode_tail(payload, self._books(tail, degree), out.shN, f"{where} tail")

    def _books(self, row: int, degree: int) -> dict[int, Codebook]:
        books: dict[int, Codebook] = {}
        for book in self._needed(row):
            colour = self.root.codebooks[book].attribute == "colour"
            loaded = self._codebooks.get((book, degree if colour else 0))
            if loaded is not None:
                books[book] = loaded
        return books


def open_cogs(source: Source, *, partial: bool = False, limits: Limits | None = None) -> CogsFile:
    """Read the index of a file and check it.

    Parameters
    ----------
    source : Source
    partial : bool
        Accept a source that ends before the file does; its complete chunks can be decoded.
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
        A newer major version, or something that must be understood and is not.
    """
    name = source.name
    first = source.read(0, min(layout.FIRST_READ, source.size))
    preamble = layout.unpack_preamble(first[: layout.PREAMBLE_BYTES], name)
    root_end = layout.PREAMBLE_BYTES + preamble.root_length
    if len(first) < root_end:
        raise TruncatedError(
            "root-truncated",
            f"{name}: {len(first)} bytes, expected a root up to byte {root_end}",
            clause="3.3",
            needed=root_end,
        )
    data = first[layout.PREAMBLE_BYTES : root_end]
    if zlib.crc32(data) != preamble.root_crc:
        raise FormatError(
            "root-crc", f"{name}: the root's CRC does not match", clause="3.3", offset=64
        )
    root = cogs_root.parse_root(strict_msgpack.unpack(data, f"{name}: root"), f"{name}: root")
    if source.size < preamble.file_length and not partial:
        raise TruncatedError(
            "file-truncated",
            f"{name}: {source.size} bytes, expected {preamble.file_length}",
            clause="3.3",
            needed=preamble.file_length,
        )
    if source.size > preamble.file_length:
        raise FormatError(
            "file-trailing",
            f"{name}: {source.size} bytes, expected {preamble.file_length}",
            clause="3.3",
            offset=preamble.file_length,
        )
    file = CogsFile(source, root, limits or Limits(), preamble.file_length)
    _load_tables(file, source, root_end)
    return file


def _load_tables(file: CogsFile, source: Source, root_end: int) -> None:
    root = file.root
    segments, chunks = [root.segments], [root.chunks]
    offsets = [_offsets(root.segments, root_end)]
    position = root_end + int(root.segments.length.sum(dtype=np.uint64))
    whole = True
    for number, entry in enumerate(root.pages):
        where = f"{file.name}: index page {number}"
        end = position + entry.length
        if end > file.file_length:
            raise _leaves(file, end)
        if end > source.size:
            whole = False
            break
        data = source.read(position, entry.length)
        if zlib.crc32(data) != entry.crc:
            raise FormatError(
                "page-crc", f"{where}: its CRC does not match", clause="5.6", offset=position
            )
        page = cogs_root.parse_page(strict_msgpack.unpack(data, where), entry, where)
        segments.append(page[0])
        chunks.append(page[1])
        offsets.append(_offsets(page[0], end))
        position = end + entry.span
    if whole and position != file.file_length:
        raise _leaves(file, position)
    file.segments = SegmentTable(
        *(np.concatenate([getattr(t, n) for t in segments]) for n in _SEGMENT_COLUMNS)
    )
    file.chunks = ChunkTable(
        *(np.concatenate([getattr(t, n) for t in chunks]) for n in _CHUNK_COLUMNS)
    )
    file.offsets = np.concatenate(offsets)
    _check_tables(file, whole)


_SEGMENT_COLUMNS: Final = ("kind", "owner", "length", "crc", "hash", "needs")
_CHUNK_COLUMNS: Final = ("splats", "box", "contribution", "layer", "cell", "object")


def _offsets(table: SegmentTable, start: int) -> NDArray[np.int64]:
    lengths = table.length.astype(np.int64)
    offsets: NDArray[np.int64] = start + np.cumsum(lengths) - lengths
    return offsets


def _leaves(file: CogsFile, end: int) -> FormatError:
    return FormatError(
        "segments-length",
        f"{file.name}: index and segments end at byte {end}, the file at {file.file_length}",
        clause="5.1",
    )


def _check_tables(file: CogsFile, whole: bool) -> None:
    """Check what the tables say of one another (SPEC 5.3 to 5.5)."""
    table, chunks, root = file.segments, file.chunks, file.root

    def refuse(code: str, message: str, clause: str) -> FormatError:
        return FormatError(code, f"{file.name}: {message}", clause=clause)

    heads = np.flatnonzero(table.kind == SegmentKind.HEAD)
    if not np.array_equal(table.owner[heads], np.arange(len(heads))) or len(heads) != len(chunks):
        raise refuse(
            "chunk-heads",
            f"{len(heads)} heads of {len(chunks)} chunks, expected one each, in chunk order",
            "5.4",
        )
    tails = np.flatnonzero(table.kind == SegmentKind.TAIL)
    owners = table.owner[tails]
    if len(np.unique(owners)) != len(owners) or (len(owners) and owners.max() >= len(chunks)):
        raise refuse(
            "chunk-tails",
            f"tails of chunks {owners.tolist()[:8]}, expected one at most for each of "
            f"{len(chunks)} chunks",
            "5.4",
        )
    if len(tails) and root.sh_degree == 0:
        raise refuse("chunk-tails", "tails in a scene of SH degree 0, expected none", "5.4")
    total = int(chunks.splats.sum(dtype=np.uint64))
    if total > root.splats or (whole and total != root.splats):
        raise refuse(
            "splat-count", f"chunks of {total} splats, the root states {root.splats}", "5.4"
        )
    books = len(root.codebooks)
    if len(table) and int(table.needs.max()) >> books:
        raise refuse(
            "needs-range", f"a segment needs a codebook above the {books} there are", "5.3"
        )
    _check_codebooks(file, whole, refuse)
    file._head_rows = heads.astype(np.int64)
    file._tail_rows = np.full(len(chunks), -1, np.int64)
    file._tail_rows[owners] = tails


def _check_codebooks(
    file: CogsFile, whole: bool, refuse: Callable[[str, str, str], FormatError]
) -> None:
    table, root = file.segments, file.root
    found: set[tuple[int, int]] = set()
    for row in np.flatnonzero(
        (table.kind >= SegmentKind.SHAPE_CODEBOOK) & (table.kind < layout.SKIPPABLE_KIND)
    ):
        kind, owner = SegmentKind(int(table.kind[row])), int(table.owner[row])
        if owner >= len(root.codebooks) or (kind, owner) in found:
            raise refuse(
                "codebook-segments",
                f"segment {row}, {kind.name.lower()} of codebook {owner}: there is none, or it is "
                "the second",
                "5.5",
            )
        shape = root.codebooks[owner].attribute == "shape"
        if shape != (kind == SegmentKind.SHAPE_CODEBOOK):
            raise refuse(
                "codebook-segments",
                f"segment {row}: {kind.name.lower()} in a codebook of "
                f"{root.codebooks[owner].attribute!r}",
                "5.5",
            )
        found.add((kind, owner))
    if not whole:
        return
    for number, entry in enumerate(root.codebooks):
        kinds: Sequence[SegmentKind] = [SegmentKind.SHAPE_CODEBOOK]
        if entry.attribute == "colour":
            kinds = layout.COLOUR_BANDS[: root.sh_degree]
        missing = [kind.name.lower() for kind in kinds if (kind, number) not in found]
        if missing:
            raise refuse("codebook-segments", f"codebook {number} has no {missing}", "5.5")


def _allocate(rows: int, degree: int, root: Root) -> Splats:
    blank = empty(degree, 0, root.info)
    return replace(
        blank,
        means=np.empty((rows, 3), np.float32),
        scales=np.empty((rows, 3), np.float32),
        quats=np.empty((rows, 4), np.float32),
        opacities=np.empty(rows, np.float32),
        sh0=np.empty((rows, 3), np.float32),
        shN=np.empty((rows, sh_coefficients(degree) - 1, 3), np.float32),
    )
