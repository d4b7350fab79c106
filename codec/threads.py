"""Work spread over threads whose results come back in order, whatever the number of threads."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

# Results that wait for an earlier, slower one: enough to keep every thread busy, little memory.
_AHEAD = 2

# By the number of their threads. Taking and returning one is a single operation of a list.
_idle: dict[int, list[ThreadPoolExecutor]] = {}
if hasattr(os, "register_at_fork"):
    # A child process has no threads but the one that called fork.
    os.register_at_fork(after_in_child=_idle.clear)


def thread_count(threads: int) -> int:
    """Return how many threads `threads` asks for; 0 means every core this process may use.

    Raises
    ------
    ValueError
        A negative number.
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

    At most ``threads + 2`` items are under way or waiting to be taken. When the function raises, or
    the caller leaves the loop, items that have not begun are dropped.
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
    """Yield a pool that nobody else uses and that has no work left at the end of the block.

    Pools are kept: to encode a small scene takes hundreds, and starting a thread takes milliseconds
    where others hold the interpreter.
    """
    idle = _idle.setdefault(threads, [])
    try:
        pool = idle.pop()
    except IndexError:
        pool = ThreadPoolExecutor(threads)
    try:
        yield pool
    except BaseException:
        # An interrupt may have come while a thread started: only a pool that is shut down tells
        # such a one to end, without which the process would not.
        pool.shutdown()
        raise
    idle.append(pool)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let numpy's BLAS work on one thread, for this thread and those it starts, in the block.

    Work that is spread over threads anyway is slowed down by BLAS's own, which wait for each other
    on the same cores; and the order of BLAS's sums, so their last bits, depends on their number.
    Also a decorator. Blocks may be nested.

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
