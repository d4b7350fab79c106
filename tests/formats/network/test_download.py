from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import pytest
from fault_server import FaultServer, broken_after, right, serving, slow, status

from cogsplat.codec.errors import StorageError
from cogsplat.formats.network.download import download
from cogsplat.formats.network.network_options import NetworkOptions

DATA = np.random.default_rng(4).bytes(3_500_000)
QUICK = NetworkOptions(pause_seconds=0.01)


def test_all_bytes_arrive_and_progress_is_told(tmp_path):
    told = []
    with serving(FaultServer(DATA, [broken_after(20_000), right, broken_after(9)])) as server:
        size = download(
            server.url(), tmp_path / "a", QUICK, progress=lambda *step: told.append(step)
        )
    assert size == len(DATA)
    assert (tmp_path / "a").read_bytes() == DATA
    # The first request is part one.
    assert told == [("fetch", step, 5) for step in range(1, 6)]


def test_no_byte_is_asked_for_twice(tmp_path):
    with serving(FaultServer(DATA, always=slow(4e6, 8192))) as server:
        download(server.url(), tmp_path / "a", QUICK)
    spans = sorted((asked.first, asked.end) for asked in server.asked)
    assert spans[0][0] == 0
    assert spans[-1][1] == len(DATA)
    assert all(end == first for (_, end), (first, _) in pairwise(spans))


def test_a_failure_leaves_what_was_there(tmp_path):
    (tmp_path / "a").write_bytes(b"old")
    with (
        serving(FaultServer(DATA, [right], status(404))) as server,
        pytest.raises(StorageError, match="no such file"),
    ):
        download(server.url(), tmp_path / "a", QUICK, force=True)
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_bytes() == b"old"


def test_two_at_once_leave_one_whole_file(tmp_path):
    """F33: each writes to a file of its own and renames it."""
    with serving(FaultServer(DATA)) as server, ThreadPoolExecutor(2) as pool:

        def one(_):
            return download(server.url(), tmp_path / "a", force=True)

        assert list(pool.map(one, range(2))) == [len(DATA)] * 2
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_bytes() == DATA
