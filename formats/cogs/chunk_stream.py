"""Chunks of an open file, decoded one after the other as their bytes come (SPEC 8.3, 8.8)."""

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
from .index import Index
from .layout import CODEBOOK_KINDS


@dataclass(frozen=True, eq=False)
class ChunkUpdate:
    """What is there of a chunk; a later update of the same chunk takes the place of this one.

    Parameters
    ----------
    chunk : int
    splats : Splats
        From `ChunkDecoder.decode`: coarse without the refinement, shN zero without the tail.
    is_refined, has_tail : bool
        Whether the refinement and the tail are in it, or there are none that were asked for.
    is_complete : bool
        Whether no further update of the chunk will come.
    """

    chunk: int
    splats: Splats
    is_refined: bool
    has_tail: bool
    is_complete: bool


class ChunkStream:
    """Updates of chunks as their bytes come; see `reader.CogsFile.stream`.

    An iterator for ``for`` and for ``async for``, which decodes and waits on another thread. One
    user at a time; `cancel` may be called from any thread.
    """

    def __init__(
        self,
        file: ChunkDecoder,
        source: Source,
        index: Index,
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
        with self._running:
            return next(self._updates, None)

    def cancel(self) -> None:
        """End the stream from any thread: whoever waits for the next update gets `Cancelled`."""
        self._cancelled = True
        self._cancel()

    def close(self) -> None:
        """End the requests; no update comes any more."""
        self.cancel()
        # A task that was cancelled may leave a thread in the middle of the last update.
        with self._running:
            self._updates.close()

    def _plan(self, chunks: Sequence[int]) -> dict[int, list[int]]:
        """Return the rows of each wanted chunk, chunks in the order in which they are wanted."""
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
        """Return the rows to fetch, codebooks before what needs them."""
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
        index, arrived = self._index, self._arrived
        order = self._order()
        owners = {row: chunk for chunk, rows in self._wanted.items() for row in rows}
        missing = {chunk: set(rows) for chunk, rows in self._wanted.items()}
        ranges = [(int(index.offsets[row]), int(index.segments.length[row])) for row in order]
        shown: dict[int, tuple[bool, bool, bool]] = {}
        coarse: dict[int, None] = {}
        kept = {row for row in order if self._file.is_kept(row)}
        ahead = [span for row, span in zip(order, ranges, strict=True) if row not in kept]
        with prefetching(self._source, ahead) as self._cancel:
            for row, (offset, length) in zip(order, ranges, strict=True):
                is_here = row in kept or has_arrived(self._source, offset, length)
                if coarse and not is_here:
                    # While the next segment is on its way there is time to show what came.
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
        """Yield an update of each chunk of which more has come than was shown."""
        for chunk in list(chunks):
            state = self._state(chunk, last=not missing[chunk])
            if state is None or state == shown.get(chunk):
                continue
            shown[chunk] = state
            yield self._decoded(chunk, *state)
            if state[2]:
                del missing[chunk]
                for row in self._wanted[chunk]:
                    del self._arrived.held[row]

    def _state(self, chunk: int, *, last: bool) -> tuple[bool, bool, bool] | None:
        """Return whether a chunk is refined, has its tail, and is complete; None without a head."""
        arrived = self._arrived
        head = int(self._index.heads[chunk])
        if not arrived.is_ready(head, 0):
            return None
        refined = not self._refine or arrived.has_refinement(chunk)
        tail = not self._degree or arrived.has_tail(chunk, self._degree)
        complete = last and all(arrived.is_ready(row, self._degree) for row in self._wanted[chunk])
        return refined, tail, complete

    def _decoded(self, chunk: int, refined: bool, tail: bool, complete: bool) -> ChunkUpdate:
        splats = self._arrived.decode(
            [chunk],
            sh_degree=self._degree,
            refine=self._refine,
            extras=complete,
            threads=1,
        )
        return ChunkUpdate(chunk, splats, refined, tail, complete)


class _ArrivedFile(ChunkDecoder):
    """A file of which the segments that were received are there, and no others."""

    def __init__(self, source: Source, index: Index, limits: Limits) -> None:
        super().__init__(_Unread(source.name, source.size), index, limits)
        self.held: dict[int, memoryview] = {}

    def is_present(self, row: int) -> bool:
        """Whether a segment was received."""
        return row in self.held

    def is_ready(self, row: int, degree: int) -> bool:
        """Whether a segment was received, and the codebooks it needs up to an SH degree."""
        return self._complete(row, degree)

    def read_segment(self, row: int) -> memoryview:
        """Return a segment that was received; its CRC is checked already."""
        return self.held[row]


class _Unread:
    """Stands for the source of a file whose segments are all received: nothing is read of it."""

    def __init__(self, name: str, size: int) -> None:
        self.name = name
        self.size = size

    def read(self, offset: int, length: int) -> bytes:
        """Refuse: see the class."""
        raise AssertionError(f"{self.name}: bytes {offset} to {offset + length - 1} are read")

    def close(self) -> None:
        """Do nothing: it holds nothing."""
