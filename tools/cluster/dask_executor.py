"""Run the encoder's work on Dask: on processes of this machine, or on a cluster."""

from __future__ import annotations

import logging
import pickle
import time
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sized
from contextlib import contextmanager, suppress
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, TypeVar

from cogsplat.codec.errors import CogsplatError, MissingExtraError, StorageError
from cogsplat.codec.threads import thread_count

if TYPE_CHECKING:
    from distributed import Client, Future

Item = TypeVar("Item")
Result = TypeVar("Result")

LOCAL: Final = "local"
"""In place of an address: processes of this machine."""

# How long a scheduler and its first worker are waited for, seconds.
_PATIENCE_S: Final = 20.0

# How long until a scheduler without workers is asked again, seconds.
_AGAIN_S: Final = 0.05

# Tasks that wait for each thread of the workers, so that none is idle while results are taken.
_AHEAD: Final = 2

# A map of few items over a small scene is one of many, as in a stage of the order by gain or a step
# of the fit. There a task's way through the scheduler costs more than a thread gains by taking the
# next item alone, so up to so many items go together: with two workers the client and the scheduler
# took 7.4 s of processor time in place of 13.3. Of large scenes each result takes much memory.
_FEW: Final = 32
_TOGETHER: Final = 4
_SMALL_BYTES: Final = 1 << 26


class DaskExecutor:
    """An `Executor` on the workers of a Dask scheduler.

    What calls share is brought to the workers once, and stays there for as long as the object
    lives. A task whose worker ends is run again on another one. The scheduler keeps a copy, packed.

    Parameters
    ----------
    client : distributed.Client
        Connected; whoever made it closes it.

    Examples
    --------
    .. code-block:: python

        from cogsplat.tools.cluster.dask_executor import connected

        if __name__ == "__main__":
            with connected("local") as executor:
                cogsplat.encode("scene.ply", "scene.cogs", executor=executor)
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        # What the workers hold, by the identity of the object here.
        self._brought: dict[int, tuple[weakref.ref[object], Future]] = {}

    def map(
        self, function: Callable[..., Result], items: Iterable[Item], *shared: object
    ) -> Iterator[Result]:
        """As `codec.executor.Executor.map`.

        Raises
        ------
        StorageError
            ``scheduler-lost`` where the scheduler does not answer any more; ``worker-lost`` where
            one task ended several workers.
        """
        waiting: deque[Future] = deque()
        small = sum(getattr(value, "nbytes", 0) for value in shared) <= _SMALL_BYTES
        given = list(items) if small and isinstance(items, Sized) else items
        try:
            # By turns: left to itself, the scheduler gives most tasks to the worker that has the
            # scene already.
            turns = self._threads()
            for turn, batch in enumerate(_batches(given, len(turns))):
                with self._told():
                    held = [self._bring(value) for value in shared]
                    future = self._client.submit(
                        _call_all,
                        function,
                        batch,
                        *held,
                        pure=False,
                        workers=turns[turn % len(turns)],
                        # Should that one end.
                        allow_other_workers=True,
                    )
                waiting.append(future)
                if len(waiting) > _AHEAD * len(turns):
                    yield from self._results(waiting.popleft())
            while waiting:
                yield from self._results(waiting.popleft())
        finally:
            self._cancel(list(waiting))

    def _threads(self) -> list[str]:
        """Return the address of the worker of every thread, workers by turns.

        Raises
        ------
        StorageError
            ``worker-lost``: none is left for as long as a scheduler is waited for.
        """
        # Asked of the scheduler itself: what a local cluster knows of its workers may be old, and a
        # worker that ended is gone from the list before another has taken its place.
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            with self._told():
                threads: Mapping[str, int] = self._client.nthreads()
            if threads:
                break
            if time.monotonic() > deadline:
                raise StorageError(
                    "worker-lost", "the scheduler has no workers left, expected at least 1"
                )
            time.sleep(_AGAIN_S)
        most = max(threads.values())
        return [address for turn in range(most) for address in threads if threads[address] > turn]

    def _bring(self, value: object) -> object:
        """Return the future of the workers' copy of a value; bring it there the first time.

        Numbers and other values that cannot be referred to weakly go along with each task.
        """
        if type(value).__weakrefoffset__ == 0:
            return value
        import cloudpickle

        known = self._brought.get(id(value))
        if known is not None and known[0]() is value:
            return known[1]
        # As a task that unpacks it: should every worker that has a copy end, the scheduler runs the
        # task again. Scattered values would be lost.
        future = self._client.submit(pickle.loads, cloudpickle.dumps(value), pure=False)
        key = id(value)
        # Dropping the future lets go of the copies.
        gone = weakref.ref(value, lambda _: self._brought.pop(key, None))
        self._brought[key] = gone, future
        return future

    def _results(self, future: Future) -> Iterator[Any]:
        """Yield what a task gave for its items, up to the one that it failed at."""
        results, error = self._result(future)
        yield from results
        if error is not None:
            raise error

    def _result(self, future: Future) -> Any:
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError
        from distributed.comm import CommClosedError

        try:
            return future.result()
        except KilledWorker as error:
            raise StorageError(
                "worker-lost",
                "a task ended every worker that began it, perhaps for want of memory, "
                f"expected one to finish it: {error}",
            ) from None
        except (FutureCancelledError, CommClosedError, ConnectionError) as error:
            # Nobody else cancels: the scheduler is gone, or another one is in its place.
            raise _scheduler_lost() from error

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Turn the errors of a connection that ended into ours."""
        from distributed.client import ClosedClientError

        # The client closes when a scheduler has not answered for a while.
        if self._client.status in ("closing", "closed"):
            raise _scheduler_lost()
        try:
            yield
        except (ClosedClientError, OSError) as error:
            raise _scheduler_lost() from error

    def _cancel(self, futures: list[Future]) -> None:
        """Drop tasks that nobody waits for."""
        if not futures or self._client.status != "running":
            return
        # Without a scheduler there is nothing to cancel, and what is raised already says so.
        with suppress(OSError, TimeoutError):
            self._client.cancel(futures)


def _batches(items: Iterable[Item], threads: int) -> Iterator[list[Item]]:
    """Give items in the runs that one task works through: of many items each alone."""
    if not isinstance(items, list) or len(items) > _FEW:
        for item in items:
            yield [item]
        return
    # As many for each thread, so that none waits for another.
    count = min(threads * -(-len(items) // (threads * _TOGETHER)), len(items))
    bounds = [len(items) * number // max(count, 1) for number in range(count + 1)]
    for first, last in pairwise(bounds):
        yield items[first:last]


def _call_all(
    function: Callable[..., Result], items: Iterable[Item], *shared: object
) -> tuple[list[Result], CogsplatError | None]:
    """Return what a function gives for each item, on a worker, and what ended that early."""
    results: list[Result] = []
    try:
        for item in items:
            results.append(function(item, *shared))  # noqa: PERF401 - those before an error count
    except CogsplatError as error:
        return results, error
    return results, None


def _scheduler_lost() -> StorageError:
    return StorageError(
        "scheduler-lost",
        "the Dask scheduler does not answer any more, expected it to stay until the work is done",
    )


@contextmanager
def connected(scheduler: str, *, workers: int = 0) -> Iterator[DaskExecutor]:
    """Connect to a Dask scheduler, or start one with workers on this machine.

    Parameters
    ----------
    scheduler : str
        An address such as ``tcp://10.0.0.1:8786``, or ``local``.
    workers : int
        Processes of ``local``, of one thread each; 0 for one a core.

    Yields
    ------
    DaskExecutor
        What was brought to the workers is let go of at the end, and ``local`` is shut down.

    Raises
    ------
    MissingExtraError
        ``needs-extra``: Dask is not installed.
    StorageError
        ``scheduler-unreachable``: no scheduler, or one without workers.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            "needs-extra",
            "this takes Dask, which is not installed; it needs the extra: "
            "pip install 'cogsplat[dask]'",
        ) from error
    # Scenes go along with tasks that unpack them; by default Dask warns of tasks so large.
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"}):
        if scheduler == LOCAL:
            with (
                LocalCluster(
                    n_workers=thread_count(workers),
                    threads_per_worker=1,
                    # The machine's memory is theirs together, as it is that of threads.
                    memory_limit=0,
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.CRITICAL,
                ) as cluster,
                Client(cluster, set_as_default=False) as client,
            ):
                yield DaskExecutor(client)
            return
        try:
            client = Client(scheduler, timeout=_PATIENCE_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise _unreachable(scheduler, "no answer") from error
        with client:
            try:
                client.wait_for_workers(1, timeout=_PATIENCE_S)
            except TimeoutError as error:
                raise _unreachable(scheduler, "no workers") from error
            yield DaskExecutor(client)


def _unreachable(scheduler: str, found: str) -> StorageError:
    return StorageError(
        "scheduler-unreachable",
        f"{scheduler}: {found} within {_PATIENCE_S:g} s, expected a Dask scheduler with a worker",
    )
