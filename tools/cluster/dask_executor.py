"""Executor of the encoder on Dask: on local processes, or on a cluster."""

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
"""Name that stands for local processes, instead of a scheduler's address."""

# Timeout for a scheduler and its first worker, seconds.
_TIMEOUT_S: Final = 20.0

# Interval between queries of a scheduler without workers, seconds.
_POLL_S: Final = 0.05

# Queued tasks per worker thread, so that no thread is idle while the client reads results.
_QUEUED_TASKS: Final = 2

# A short map over small arrays is usually one of many, e.g. in training. There the
# scheduler's cost per task exceeds the gain of balancing single items, so a task gets up to
# `_BATCH_ITEMS` items. With two workers this cut the processor time of client and scheduler from
# 13.3 s to 7.4 s. Larger arrays give larger results, of which a batch would take too much memory.
_SHORT_MAP_ITEMS: Final = 32
_BATCH_ITEMS: Final = 4
_SMALL_BYTES: Final = 1 << 26


class DaskExecutor:
    """An `Executor` on the workers of a Dask scheduler.

    Shared arguments are sent to the workers once and stay there while the local object exists. The
    scheduler keeps a pickled copy. If a worker dies, its tasks run again on another worker.

    Parameters
    ----------
    client : distributed.Client
        Connected client; the caller closes it.

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
        # Futures of the shared arguments, by the identity of the local object.
        self._shared: dict[int, tuple[weakref.ref[object], Future]] = {}

    def map(
        self, function: Callable[..., Result], items: Iterable[Item], *shared: object
    ) -> Iterator[Result]:
        """Call a function for each item on the workers, like `codec.executor.Executor.map`.

        Parameters
        ----------
        function : callable
            Function of an item and the shared arguments.
        items : iterable
            Items.
        *shared : object
            Arguments common to all calls, sent to the workers once.

        Yields
        ------
        Result
            Results in the order of the items.

        Raises
        ------
        StorageError
            ``scheduler-lost``: the scheduler no longer responds; ``worker-lost``: one task killed
            several workers.
        """
        pending: deque[Future] = deque()
        small = sum(getattr(value, "nbytes", 0) for value in shared) <= _SMALL_BYTES
        sized = list(items) if small and isinstance(items, Sized) else items
        try:
            # Assign workers round-robin: the scheduler itself would prefer the worker that already
            # has the scene.
            workers = self._worker_of_threads()
            for number, batch in enumerate(_batches(sized, len(workers))):
                with self._connection_errors():
                    arguments = [self._share(value) for value in shared]
                    future = self._client.submit(
                        _call_all,
                        function,
                        batch,
                        *arguments,
                        pure=False,
                        workers=workers[number % len(workers)],
                        # If the assigned worker dies.
                        allow_other_workers=True,
                    )
                pending.append(future)
                if len(pending) > _QUEUED_TASKS * len(workers):
                    yield from self._results(pending.popleft())
            while pending:
                yield from self._results(pending.popleft())
        finally:
            self._cancel(list(pending))

    def _worker_of_threads(self) -> list[str]:
        """Return one worker address per thread, in round-robin order over the workers.

        Raises
        ------
        StorageError
            ``worker-lost``: the scheduler has had no worker for `_TIMEOUT_S`.
        """
        # Query the scheduler, because a local cluster's list of workers may be outdated. The list
        # may be empty while a dead worker is replaced.
        deadline = time.monotonic() + _TIMEOUT_S
        while True:
            with self._connection_errors():
                threads: Mapping[str, int] = self._client.nthreads()
            if threads:
                break
            if time.monotonic() > deadline:
                raise StorageError(
                    "worker-lost", "the scheduler has no workers left, expected at least 1"
                )
            time.sleep(_POLL_S)
        most = max(threads.values())
        return [address for turn in range(most) for address in threads if threads[address] > turn]

    def _share(self, value: object) -> object:
        """Return the future of a shared argument, which the first call sends to the workers.

        Numbers and other values without weak references are returned as they are, and so are sent
        with each task.
        """
        if type(value).__weakrefoffset__ == 0:
            return value
        import cloudpickle

        known = self._shared.get(id(value))
        if known is not None and known[0]() is value:
            return known[1]
        # A task that unpickles the value, because the scheduler reruns tasks if all workers with a
        # copy die. `Client.scatter` would lose the value.
        future = self._client.submit(pickle.loads, cloudpickle.dumps(value), pure=False)
        key = id(value)
        # Dropping the future frees the workers' copies.
        reference = weakref.ref(value, lambda _: self._shared.pop(key, None))
        self._shared[key] = reference, future
        return future

    def _results(self, future: Future) -> Iterator[Any]:
        """Yield a task's results, then raise the error of the item that failed, if any."""
        results, error = self._result(future)
        yield from results
        if error is not None:
            raise error

    def _result(self, future: Future) -> Any:
        """Wait for a task and return its value; turn Dask's exceptions into `StorageError`."""
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError
        from distributed.comm import CommClosedError

        try:
            return future.result()
        except KilledWorker as error:
            raise StorageError(
                "worker-lost",
                "every worker that ran a task died, perhaps out of memory, "
                f"expected one to finish it: {error}",
            ) from None
        except (FutureCancelledError, CommClosedError, ConnectionError) as error:
            # Only a lost or restarted scheduler cancels tasks.
            raise _scheduler_lost() from error

    @contextmanager
    def _connection_errors(self) -> Iterator[None]:
        """Turn exceptions of a closed connection into ``scheduler-lost``, as a context manager."""
        from distributed.client import ClosedClientError

        # The client closes after a scheduler has not responded for some time.
        if self._client.status in ("closing", "closed"):
            raise _scheduler_lost()
        try:
            yield
        except (ClosedClientError, OSError) as error:
            raise _scheduler_lost() from error

    def _cancel(self, futures: list[Future]) -> None:
        """Cancel tasks whose results are not needed."""
        if not futures or self._client.status != "running":
            return
        # Ignore connection errors here: the caller already raises one.
        with suppress(OSError, TimeoutError):
            self._client.cancel(futures)


def _batches(items: Iterable[Item], threads: int) -> Iterator[list[Item]]:
    """Group the items of a map into tasks for a number of worker threads.

    A long map has one item per task, for balance; a short one has several, to save overhead.
    """
    if not isinstance(items, list) or len(items) > _SHORT_MAP_ITEMS:
        for item in items:
            yield [item]
        return
    # A multiple of the number of threads, so that all threads get equal numbers of batches.
    count = min(threads * -(-len(items) // (threads * _BATCH_ITEMS)), len(items))
    bounds = [len(items) * number // max(count, 1) for number in range(count + 1)]
    for first, last in pairwise(bounds):
        yield items[first:last]


def _call_all(
    function: Callable[..., Result], items: Iterable[Item], *shared: object
) -> tuple[list[Result], CogsplatError | None]:
    """Call a function for each item, on a worker; return the results up to the first error.

    Returns
    -------
    results : list
        Results of the items before the error.
    error : CogsplatError or None
        The error, if any.
    """
    results: list[Result] = []
    try:
        for item in items:
            results.append(function(item, *shared))  # noqa: PERF401 - keep results before an error
    except CogsplatError as error:
        return results, error
    return results, None


def _scheduler_lost() -> StorageError:
    """Return the error about a scheduler that no longer responds."""
    return StorageError(
        "scheduler-lost",
        "the Dask scheduler no longer responds, expected it to run until the end of the work",
    )


@contextmanager
def connected(scheduler: str, *, workers: int = 0) -> Iterator[DaskExecutor]:
    """Connect to a Dask scheduler, or start one with workers on this machine.

    Parameters
    ----------
    scheduler : str
        Address such as ``tcp://10.0.0.1:8786``, or ``local``.
    workers : int
        Number of ``local`` processes, with one thread each; 0 for one per core.

    Yields
    ------
    DaskExecutor
        Executor. On exit, shared arguments are freed and ``local`` processes end.

    Raises
    ------
    MissingExtraError
        ``needs-extra``: Dask is not installed.
    StorageError
        ``scheduler-unreachable``: there is no scheduler at the address, or it has no workers.
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
    # Tasks that unpickle a scene contain it; raise the size from which Dask warns.
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"}):
        if scheduler == LOCAL:
            with (
                LocalCluster(
                    n_workers=thread_count(workers),
                    threads_per_worker=1,
                    # No limit per process: the processes share the machine's memory.
                    memory_limit=0,
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.CRITICAL,
                ) as cluster,
                Client(cluster, set_as_default=False) as client,
            ):
                yield DaskExecutor(client)
            return
        try:
            client = Client(scheduler, timeout=_TIMEOUT_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise _unreachable(scheduler, "no response") from error
        with client:
            try:
                client.wait_for_workers(1, timeout=_TIMEOUT_S)
            except TimeoutError as error:
                raise _unreachable(scheduler, "no workers") from error
            yield DaskExecutor(client)


def _unreachable(scheduler: str, found: str) -> StorageError:
    """Return the error about a scheduler that did not respond or has no workers."""
    return StorageError(
        "scheduler-unreachable",
        f"{scheduler}: {found} within {_TIMEOUT_S:g} s, expected a Dask scheduler with a worker",
    )
