"""Encoding on Dask: the bytes of a local encode, whoever works and whoever is lost."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from running import Run, SmallScene

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.errors import Cancelled, DataError, MissingExtraError, StorageError
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.tools.cluster import dask_executor
from cogsplat.tools.cluster.dask_executor import DaskExecutor, connected
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

pytestmark = [
    pytest.mark.slow,
    # Sockets that Dask's event loop closes after the test; what it deprecates of Python's.
    pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning"),
    pytest.mark.skipif(os.name != "posix", reason="ends processes by signals"),
]

CONFIG = EncodeConfig(chunk_splats=200, threads=1)


@pytest.fixture(scope="module")
def scene() -> tuple[Splats, list[Camera]]:
    return synth(1200), synth_cameras(4, 48, 36)


@pytest.fixture(scope="module")
def expected(scene: tuple[Splats, list[Camera]], tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The file of threads of this process."""
    path = tmp_path_factory.mktemp("local") / "a.cogs"
    cogsplat.encode(scene[0], path, cameras=scene[1], config=CONFIG)
    return path.read_bytes()


def encoded(
    scene: tuple[Splats, list[Camera]],
    executor: DaskExecutor,
    folder: Path,
    progress: Progress = silent,
) -> bytes:
    path = folder / "b.cogs"
    cogsplat.encode(
        scene[0],
        path,
        cameras=scene[1],
        config=CONFIG,
        request=EncodeRequest(executor=executor),
        progress=progress,
    )
    return path.read_bytes()


@contextmanager
def cluster(
    folder: Path, workers: int, host: str = "127.0.0.1", inside: Sequence[str] = ()
) -> Iterator[tuple[str, list["subprocess.Popen[bytes]"]]]:
    """Start a scheduler and workers; yield its address and the processes, the scheduler first.

    The scheduler listens on the address `host`; with `inside`, each worker runs in one of these
    network namespaces.
    """
    file = folder / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    started = []

    def start(*words: str, before: Sequence[str] = ()) -> None:
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        command = [*before, *dask, *words, "--scheduler-file", str(file)]
        started.append(subprocess.Popen(command, **quiet))

    try:
        start("scheduler", "--host", host, "--port", "0", "--no-dashboard")
        while not file.exists() or not file.read_text():
            assert started[0].poll() is None
            time.sleep(0.05)
        for number in range(workers):
            before = ["ip", "netns", "exec", inside[number]] if inside else []
            start("worker", "--nthreads", "1", "--no-nanny", "--no-dashboard", before=before)
        yield json.loads(file.read_text())["address"], started
    finally:
        for process in started:
            process.kill()
        for process in started:
            process.wait()


@pytest.fixture
def networks() -> Iterator[tuple[str, list[str]]]:
    """Two network namespaces on a bridge: the bridge's address here, and their names."""
    if not hasattr(os, "geteuid") or os.geteuid() or not shutil.which("ip"):
        pytest.skip("network namespaces take Linux, root and `ip`")
    name = f"cogs{os.getpid()}"
    # Of the block for tests of networks (RFC 2544), which no real one has.
    net = "198.18.77"
    bridge, names = f"{name}b", [f"{name}-{number}" for number in range(2)]

    def ip(*words: str) -> None:
        subprocess.run(["ip", *words], check=True, capture_output=True)

    try:
        try:
            ip("link", "add", bridge, "type", "bridge")
        except subprocess.CalledProcessError as error:
            pytest.skip(f"no bridges here: {error.stderr.decode()}")
        ip("addr", "add", f"{net}.1/24", "dev", bridge)
        ip("link", "set", bridge, "up")
        for number, space in enumerate(names):
            here, there = f"{name}h{number}", f"{name}t{number}"
            ip("netns", "add", space)
            ip("link", "add", here, "type", "veth", "peer", "name", there)
            ip("link", "set", here, "master", bridge, "up")
            ip("link", "set", there, "netns", space)
            ip("-n", space, "addr", "add", f"{net}.{10 + number}/24", "dev", there)
            ip("-n", space, "link", "set", there, "up")
            ip("-n", space, "link", "set", "lo", "up")
        yield f"{net}.1", names
    finally:
        # The links end with their namespaces.
        for words in (["link", "del", bridge], *(["netns", "del", space] for space in names)):
            subprocess.run(["ip", *words], check=False, capture_output=True)


def once_at(stage: str, step: int, act: Callable[[], object]) -> Progress:
    """Return a progress that acts when a stage has come so far."""
    done = []

    def report(name: str, at: int, total: int) -> None:
        if name == stage and at >= step and not done:
            done.append(name)
            act()

    return report


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_bytes_are_those_of_a_local_encode(
    scene: tuple[Splats, list[Camera]], expected: bytes, tmp_path: Path, workers: int
) -> None:
    with connected("local", workers=workers) as executor:
        assert encoded(scene, executor, tmp_path) == expected


def test_views_are_planned_and_targets_met_alike(
    scene: tuple[Splats, list[Camera]], tmp_path: Path
) -> None:
    options = {"config": CONFIG, "preset": "fast", "target": 30_000}
    cogsplat.encode(scene[0], tmp_path / "a.cogs", **options)
    with connected("local", workers=2) as executor:
        request = EncodeRequest(executor=executor)
        cogsplat.encode(scene[0], tmp_path / "b.cogs", request=request, **options)
    assert (tmp_path / "a.cogs").read_bytes() == (tmp_path / "b.cogs").read_bytes()


def test_shared_arguments_are_sent_once_and_freed() -> None:
    shared = np.ones(4)
    with connected("local", workers=1) as executor:
        # A number goes along with each task.
        assert list(executor.map(pow, [2, 3], 2)) == [4, 9]
        assert not executor._shared
        assert list(executor.map(np.dot, [2, 3], shared))[1].tolist() == [3.0] * 4
        before = executor._shared[id(shared)][1].key
        assert len(list(executor.map(np.dot, [2, 3], shared))) == 2
        assert executor._shared[id(shared)][1].key == before
        key = id(shared)
        del shared
        assert key not in executor._shared


def test_few_items_of_a_small_scene_share_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    small, large = np.ones(1), np.ones(dask_executor._SMALL_BYTES // 8 + 1)
    with connected("local", workers=2) as executor:
        submit, tasks = executor._client.submit, []

        def counted(function: Callable[..., object], *words: object, **options: object) -> object:
            if function is dask_executor._call_all:
                tasks.append(function)
            return submit(function, *words, **options)

        monkeypatch.setattr(executor._client, "submit", counted)
        for items, count, shared, expected in (
            (range(7), 7, small, 2),
            (range(9), 9, small, 4),
            (range(1), 1, small, 1),
            (range(40), 40, small, 40),
            (range(7), 7, large, 7),
            (iter(range(7)), 7, small, 7),
            (range(0), 0, small, 0),
        ):
            tasks.clear()
            found = list(executor.map(_first_times, items, shared))
            assert found == [float(item) for item in range(count)]
            assert len(tasks) == expected


def _first_times(item: int, shared: np.ndarray) -> float:
    return float(shared[0] * item)


def test_errors_of_the_work_come_back_as_they_are() -> None:
    with connected("local", workers=1) as executor:
        found = executor.map(_refuse, [1, -1])
        assert next(found) == 1
        with pytest.raises(DataError, match="-1, expected 0 or more"):
            next(found)


def _refuse(item: int) -> int:
    if item < 0:
        raise DataError("negative", f"{item}, expected 0 or more")
    return item


def test_a_worker_that_dies_does_not_change_the_results(
    scene: tuple[Splats, list[Camera]], expected: bytes, tmp_path: Path
) -> None:
    with cluster(tmp_path, 2) as (address, started), connected(address) as executor:
        executor._client.wait_for_workers(2, timeout=60)
        end = once_at("gain", 100, lambda: started[1].send_signal(signal.SIGKILL))
        assert encoded(scene, executor, tmp_path, end) == expected
        assert started[1].wait() == -signal.SIGKILL


def test_workers_of_other_networks_work_and_end_as_those_of_this_machine(
    scene: tuple[Splats, list[Camera]],
    expected: bytes,
    tmp_path: Path,
    networks: tuple[str, list[str]],
) -> None:
    host, inside = networks
    with (
        cluster(tmp_path, 2, host, inside) as (address, started),
        connected(address) as executor,
    ):
        executor._client.wait_for_workers(2, timeout=60)
        places = {worker.split("//")[1].split(":")[0] for worker in executor._client.nthreads()}
        assert len(places) == 2
        assert host not in places
        end = once_at("gain", 100, lambda: started[1].send_signal(signal.SIGKILL))
        assert encoded(scene, executor, tmp_path, end) == expected
        assert len(executor._client.nthreads()) == 1
        (tmp_path / "b.cogs").unlink()
        end = once_at("gain", 100, lambda: started[0].send_signal(signal.SIGKILL))
        with pytest.raises(StorageError) as error:
            encoded(scene, executor, tmp_path, end)
    assert error.value.code == "scheduler-lost"
    assert not (tmp_path / "b.cogs").exists()


def test_shared_arguments_of_a_dead_worker_are_sent_again(
    scene: tuple[Splats, list[Camera]], expected: bytes, tmp_path: Path
) -> None:
    with connected("local", workers=1) as executor:

        def end() -> None:
            (pid,) = executor._client.run(os.getpid).values()
            os.kill(pid, signal.SIGKILL)

        assert encoded(scene, executor, tmp_path, once_at("gain", 100, end)) == expected


def test_a_worker_that_begins_again_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    with connected("local", workers=1) as executor:
        client = executor._client
        # The scheduler dropped the worker that ended, and the next one has not come yet.
        answers = iter([{}, {}])
        nthreads = client.nthreads
        monkeypatch.setattr(client, "nthreads", lambda: next(answers, nthreads()))
        assert list(executor.map(abs, [-1, -2])) == [1, 2]


def test_a_scheduler_without_workers_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    with connected("local", workers=1) as executor:
        monkeypatch.setattr(dask_executor, "_TIMEOUT_S", 0.1)
        monkeypatch.setattr(executor._client, "nthreads", dict)
        with pytest.raises(StorageError, match="no workers left") as error:
            list(executor.map(abs, [-1, -2]))
    assert error.value.code == "worker-lost"


def test_a_scheduler_that_ends_is_an_error(
    scene: tuple[Splats, list[Camera]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with cluster(tmp_path, 1) as (address, started), connected(address) as executor:
        end = once_at("gain", 100, lambda: started[0].send_signal(signal.SIGKILL))
        with pytest.raises(StorageError) as error:
            encoded(scene, executor, tmp_path, end)
    assert error.value.code == "scheduler-lost"
    assert error.value.exit_code == 4
    assert not (tmp_path / "b.cogs").exists()


def test_a_closed_client_is_an_error() -> None:
    with connected("local", workers=1) as executor:
        executor._client.close()
        with pytest.raises(StorageError) as error:
            list(executor.map(abs, [-1]))
    assert error.value.code == "scheduler-lost"


def test_a_scheduler_that_refuses_connections_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def unanswered() -> None:
        raise OSError("Timed out trying to connect")

    with connected("local", workers=1) as executor:
        monkeypatch.setattr(executor._client, "nthreads", unanswered)
        with pytest.raises(StorageError) as error:
            list(executor.map(abs, [-1]))
    assert error.value.code == "scheduler-lost"


def test_cancelling_drops_what_waits(scene: tuple[Splats, list[Camera]], tmp_path: Path) -> None:
    def stop() -> None:
        raise Cancelled

    with connected("local", workers=1) as executor:
        with pytest.raises(Cancelled):
            encoded(scene, executor, tmp_path, once_at("score", 2, stop))
        deadline = time.monotonic() + 30
        while any(executor._client.processing().values()) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not any(executor._client.processing().values())
    assert not (tmp_path / "b.cogs").exists()


def test_no_scheduler_and_no_workers_are_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dask_executor, "_TIMEOUT_S", 1.0)
    with pytest.raises(StorageError, match="no response") as error, connected("tcp://127.0.0.1:9"):
        pass
    assert error.value.code == "scheduler-unreachable"
    with (
        cluster(tmp_path, 0) as (address, _),
        pytest.raises(StorageError, match="no workers"),
        connected(address),
    ):
        pass


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"cogsplat\[dask\]"), connected("local"):
        pass


def test_the_command_takes_a_scheduler(run: Run, small: SmallScene, tmp_path: Path) -> None:
    words = ["encode", small.ply, "--cameras", small.cameras, "--preset", "fast", "--threads", 2]
    plain = run(*words, tmp_path / "a.cogs", "--json")
    there = run(*words, tmp_path / "b.cogs", "--json", "--scheduler", "local")
    assert (plain.code, there.code) == (0, 0), there.out
    assert "connect" in there.json["seconds"]  # type: ignore[operator]
    assert (tmp_path / "a.cogs").read_bytes() == (tmp_path / "b.cogs").read_bytes()
