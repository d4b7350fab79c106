"""Where work runs that falls into many pieces: on threads of this process, or anywhere else.

The encoder gives such work to an `Executor`: a function, the items that it is called with, and the
large arrays that all of these calls read. Sums over items are always made by the caller, in the
order of the items, so that the bytes of a file do not depend on who did the work.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar

from .threads import ordered_map, thread_count

Item = TypeVar("Item")
Result = TypeVar("Result")


class Executor(Protocol):
    """Runs a function over many items and gives the results in the order of the items."""

    def map(
        self, function: Callable[..., Result], items: Iterable[Item], *shared: object
    ) -> Iterator[Result]:
        """Call ``function(item, *shared)`` for every item.

        Parameters
        ----------
        function : callable
            Of a module's top level, or a `functools.partial` of one with few small arguments, so
            that other processes can find it. It may be called more than once for an item and must
            not change its arguments.
        items : iterable
            Small: cameras, numbers, slices.
        *shared : object
            Large values that all calls read. They are recognised as objects: what was shared before
            is not brought to the workers again, and must not change for as long as it lives.

        Yields
        ------
        object
            The results in the order of the items. Leaving the loop drops what has not begun.

        Raises
        ------
        CogsplatError
            What the function raised, or ``scheduler-lost`` or ``worker-lost`` of executors that
            reach other processes.
        """
        ...


class LocalThreads:
    """The executor of this process.

    Parameters
    ----------
    threads : int
        0 for every core this process may use.

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
        """As `Executor.map`."""
        return ordered_map(lambda item: function(item, *shared), items, self._threads)
