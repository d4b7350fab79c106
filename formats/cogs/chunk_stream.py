"""Decode the chunks of an open file as their bytes arrive (SPEC 8.3, 8.8)."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType

from cogsplat.codec.errors import Cancelled
from cogsplat.codec.splats import Splats
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.source import Cancel, Source, has_arrived, prefetching

from .chunk_decoder import ChunkDecoder
from .fetch_order import codebook_rows, rows_of_chunk
from .layout import CODEBOOK_KINDS
from .scene_index import SceneIndex


@dataclass(frozen=True, eq=False)
class ChunkUpdate:
    """Splats of a chunk so far, which replace the previous update of the chunk.

    Parameters
    ----------
    chunk : int
        Chunk number.
    splats : Splats
        Decoded splats; coarse without the refinement, shN zero without the tail.
    is_refined, has_tail : bool
        Whether the refinement and the tail were applied, if the stream includes such segments.
    is_complete : bool
        Whether this is the last update of the chunk.
    """

    chunk: int
    splats: Splats
    is_refined: bool
    has_tail: bool
    is_complete: bool


class ChunkStream:
    """Iterator of `ChunkUpdate` in arrival order; see `reader.CogsFile.stream`.

    For ``for`` and ``async for``; the latter waits and decodes on another thread. For one consumer
    at a time; `cancel` may be called from any thread.

    Parameters
    ----------
    file : ChunkDecoder
        Open file.
    source : Source
        Source of the file.
    index : SceneIndex
        Whole index of the file.
    limits : Limits
        Memory and size limits.
    chunks : sequence of int
        Chunk numbers by descending priority.
    in_file_order : bool
        Whether to fetch segments in file order instead of chunk by chunk.
    sh_degree : int
        Highest SH degree to decode.
    refine : bool
        Whether to fetch refinements.
    """

    def __init__(
        self,
        file: ChunkDecoder,
        source: Source,
        index: SceneIndex,
        limits: Limits,
        chunks: Sequence[int],
        *,
        in_file_order: bool,
        sh_degree: int,
        refine: bool,
    ) -> None:
        self._arrived = _ArrivedFile(source, index, limits)
        self._file = file
        self._source = source
        self._index = index
        self._degree = sh_degree
        self._refine = refine
        self._cancel: Cancel = lambda: None
        self._cancelled = False
        self._running = threading.Lock()
        self._in_file_order = in_file_order
        self._wanted = self._plan(chunks)
        self._updates = self._run()

    def __enter__(self) -> ChunkStream:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def __iter__(self) -> ChunkStream:
        return self

    def __next__(self) -> ChunkUpdate:
        return next(self._updates)

    def __aiter__(self) -> ChunkStream:
        return self

    async def __anext__(self) -> ChunkUpdate:
        try:
            update = await asyncio.to_thread(self._next)
        except asyncio.CancelledError:
            self.cancel()
            raise
        if update is None:
            raise StopAsyncIteration
        return update

    def _next(self) -> ChunkUpdate | None:
        """Return the next update, or None at the end."""
        with self._running:
            return next(self._updates, None)

    def cancel(self) -> None:
        """End the stream from any thread: a pending ``next`` raises `Cancelled`."""
        self._cancelled = True
        self._cancel()

    def close(self) -> None:
        """Cancel all requests and end the iteration."""
        self.cancel()
        # A cancelled task may leave a thread in the middle of the last update.
        with self._running:
            self._updates.close()

    def _plan(self, chunks: Sequence[int]) -> dict[int, list[int]]:
        """Return the rows to fetch for each chunk, chunks by descending priority."""
        wanted = {}
        for chunk in chunks:
            rows = rows_of_chunk(
                self._index,
                chunk,
                sh_degree=self._degree,
                refine=self._refine,
                extras=self._file.has_extras(chunk),
            )
            wanted[chunk] = [row for row in rows if self._file.is_present(row)]
        return wanted

    def _order(self) -> list[int]:
        """Return the rows to fetch in order, each codebook before the segments that need it."""
        every = [row for rows in self._wanted.values() for row in rows]
        if self._in_file_order:
            books = codebook_rows(self._index, every, self._degree)
            return sorted({*every, *(row for row in books if self._file.is_present(row))})
        ordered: dict[int, None] = {}
        for rows in self._wanted.values():
            for row in rows:
                books = codebook_rows(self._index, [row], self._degree)
                ordered.update(dict.fromkeys([*books, row]))
        return list(ordered)

    def _run(self) -> Generator[ChunkUpdate, None, None]:
        """Read segments in fetch order and yield updates of their chunks."""
        index, arrived = self._index, self._arrived
        order = self._order()
        owners = {row: chunk for chunk, rows in self._wanted.items() for row in rows}
        missing = {chunk: set(rows) for chunk, rows in self._wanted.items()}
        ranges = [(int(index.offsets[row]), int(index.segments.length[row])) for row in order]
        shown: dict[int, tuple[bool, bool, bool]] = {}
        coarse: dict[int, None] = {}
        cached = {row for row in order if self._file.is_cached(row)}
        ahead = [span for row, span in zip(order, ranges, strict=True) if row not in cached]
        with prefetching(self._source, ahead) as self._cancel:
            for row, (offset, length) in zip(order, ranges, strict=True):
                is_here = row in cached or has_arrived(self._source, offset, length)
                if coarse and not is_here:
                    # Decode coarse updates while the next segment is in flight.
                    yield from self._changed(coarse, shown, missing)
                    coarse.clear()
                if self._cancelled:
                    raise Cancelled
                arrived.held[row] = self._file.read_segment(row)
                if index.segments.kind[row] in CODEBOOK_KINDS:
                    changed = [c for c, rows in missing.items() if len(rows) < len(self._wanted[c])]
                else:
                    changed = [owners[row]]
                    missing[owners[row]].discard(row)
                coarse.update(dict.fromkeys(changed))
                whole = [c for c in changed if not missing[c] and self._state(c, last=True)]
                yield from self._changed(whole, shown, missing)
                for chunk in whole:
                    del coarse[chunk]
            yield from self._changed(coarse, shown, missing)

    def _changed(
        self,
        chunks: Iterable[int],
        shown: dict[int, tuple[bool, bool, bool]],
        missing: dict[int, set[int]],
    ) -> Iterator[ChunkUpdate]:
        """Yield an update of each chunk whose state differs from its last update."""
        for chunk in list(chunks):
            state = self._state(chunk, last=not missing[chunk])
            if state is None or state == shown.get(chunk):
                continue
            shown[chunk] = state
            yield self._update(chunk, *state)
            if state[2]:
                del missing[chunk]
                for row in self._wanted[chunk]:
                    del self._arrived.held[row]

    def _state(self, chunk: int, *, last: bool) -> tuple[bool, bool, bool] | None:
        """Return whether a chunk is refined, has its tail, is complete; None without its head."""
        arrived = self._arrived
        head = int(self._index.heads[chunk])
        if not arrived.is_ready(head, 0):
            return None
        refined = not self._refine or arrived.has_refinement(chunk)
        tail = not self._degree or arrived.has_tail(chunk, self._degree)
        complete = last and all(arrived.is_ready(row, self._degree) for row in self._wanted[chunk])
        return refined, tail, complete

    def _update(self, chunk: int, refined: bool, tail: bool, complete: bool) -> ChunkUpdate:
        """Decode the received segments of a chunk into an update."""
        splats = self._arrived.decode(
            [chunk],
            sh_degree=self._degree,
            refine=self._refine,
            extras=complete,
            threads=1,
        )
        return ChunkUpdate(chunk, splats, refined, tail, complete)


class _ArrivedFile(ChunkDecoder):
    """File with only the segments received so far, kept in memory."""

    def __init__(self, source: Source, index: SceneIndex, limits: Limits) -> None:
        super().__init__(_Unread(source.name, source.size), index, limits)
        self.held: dict[int, memoryview] = {}

    def is_present(self, row: int) -> bool:
        """Whether a segment was received."""
        return row in self.held

    def is_ready(self, row: int, degree: int) -> bool:
        """Whether a segment and the codebooks it needs up to an SH degree were received."""
        return self._is_decodable(row, degree)

    def read_segment(self, row: int) -> memoryview:
        """Return a received segment, whose CRC was checked on arrival."""
        return self.held[row]


class _Unread:
    """Source that refuses reads: placeholder for a file whose segments are in memory."""

    def __init__(self, name: str, size: int) -> None:
        self.name = name
        self.size = size

    def read(self, offset: int, length: int) -> bytes:
        """Raise AssertionError: all segments are in memory, so no read is expected."""
        end = offset + length
        raise AssertionError(f"{self.name}: read of bytes {offset} to {end - 1}, expected none")

    def close(self) -> None:
        """Do nothing: no resources are held."""
