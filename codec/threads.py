"""Thread pools: a parallel map with ordered results, and BLAS limited to one thread."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

# Items in flight beyond the number of threads: keeps threads busy while an earlier item is slow.
_AHEAD = 2

# Idle pools by number of threads. `append` and `pop` of a list are atomic.
_idle: dict[int, list[ThreadPoolExecutor]] = {}
if hasattr(os, "register_at_fork"):
    # A forked child has no threads except the one that called fork.
    os.register_at_fork(after_in_child=_idle.clear)


def thread_count(threads: int) -> int:
    """Return the number of threads for the setting `threads`, where 0 means every usable core.

    Raises
    ------
    ValueError
        `threads` is negative.
    """
    if threads < 0:
        raise ValueError(f"{threads} threads, expected 0 (all cores) or more")
    if threads:
        return threads
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def ordered_map(
    function: Callable[[Item], Result], items: Iterable[Item], threads: int
) -> Iterator[Result]:
    """Apply a function to every item on `threads` threads and yield the results in item order.

    At most ``threads + 2`` items are in flight or not yet yielded. When the function raises, or the
    caller leaves the loop, items that have not started are cancelled.
    """
    if threads <= 1:
        yield from map(function, items)
        return
    with _pool(threads) as pool:
        waiting: deque[Future[Result]] = deque()
        try:
            for item in items:
                waiting.append(pool.submit(function, item))
                if len(waiting) >= threads + _AHEAD:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            wait([future for future in waiting if not future.cancel()])


@contextmanager
def _pool(threads: int) -> Iterator[ThreadPoolExecutor]:
    """Yield an exclusive pool, which must have no work left at the end of the block.

    Pools are reused: encoding a small scene needs hundreds, and starting a thread takes
    milliseconds while other threads hold the interpreter's lock.
    """
    idle = _idle.setdefault(threads, [])
    try:
        pool = idle.pop()
    except IndexError:
        pool = ThreadPoolExecutor(threads)
    try:
        yield pool
    except BaseException:
        # After an interrupt during the start of a thread, only `shutdown` ends that thread; without
        # it the process would never exit.
        pool.shutdown()
        raise
    idle.append(pool)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread within the block; also usable as a decorator, and nestable.

    BLAS threads slow down work that is already spread over threads, because they compete for the
    same cores. The order of BLAS's sums, and so their last bits, depends on its thread count.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.threads import one_blas_thread
    >>> with one_blas_thread():
    ...     float(np.ones(3) @ np.ones(3))
    3.0
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield
