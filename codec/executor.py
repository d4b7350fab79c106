"""Executors: parallel maps over views or chunks, on threads of this process or elsewhere.

The encoder passes an `Executor` a function, the items to call it with, and the large arrays that
all calls read. The caller sums results in the order of the items, so that the bytes of a file do
not depend on the executor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar

from .threads import ordered_map, thread_count

Item = TypeVar("Item")
Result = TypeVar("Result")


class Executor(Protocol):
    """Parallel map that yields results in the order of the items."""

    def map(
        self, function: Callable[..., Result], items: Iterable[Item], *shared: object
    ) -> Iterator[Result]:
        """Call ``function(item, *shared)`` for every item.

        Parameters
        ----------
        function : callable
            Function at a module's top level, or a `functools.partial` of one with few small
            arguments, so that other processes can import it. It may be called more than once for
            an item and must not change its arguments.
        items : iterable
            Small values: cameras, numbers, slices.
        *shared : object
            Large values that all calls read. An object shared in an earlier call is not sent to
            the workers again, so it must not change during its lifetime.

        Yields
        ------
        object
            Results in the order of the items. Leaving the loop cancels calls that have not started.

        Raises
        ------
        CogsplatError
            The function raised it, or an executor with other processes lost its scheduler
            (``scheduler-lost``) or a worker (``worker-lost``).
        """
        ...


class LocalThreads:
    """Executor on threads of this process.

    Parameters
    ----------
    threads : int
        Number of threads; 0 for every core this process may use.

    Examples
    --------
    >>> from operator import mul
    >>> executor = LocalThreads(2)
    >>> list(executor.map(mul, [1, 2, 3], 10))
    [10, 20, 30]
    """

    def __init__(self, threads: int = 0) -> None:
        self._threads = thread_count(threads)

    def map(
        self, function: Callable[..., Result], items: Iterable[Item], *shared: object
    ) -> Iterator[Result]:
        """Call ``function(item, *shared)`` for every item; see `Executor.map`."""
        return ordered_map(lambda item: function(item, *shared), items, self._threads)
