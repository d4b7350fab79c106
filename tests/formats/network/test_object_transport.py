"""Object stores, of which the server of faults stands for one: S3 is HTTP with ranges."""

import subprocess
import sys

import pytest
from cogs_samples import assert_same, file_of
from fault_server import FaultServer, broken_after, right, serving, status

import cogsplat
from cogsplat.codec.errors import MissingExtraError, StorageError
from cogsplat.formats.network.network_options import NetworkOptions
from cogsplat.formats.network.object_transport import ObjectTransport
from cogsplat.formats.network.open_url import open_url
from cogsplat.tools.lab.conformance.reference_folders import folder_of_file

URL = "s3://bucket/scenes/a.cogs"


@pytest.fixture(scope="module")
def data():
    return file_of("vq", 6000, 3, 500)


def options_of(server, **changes):
    store = {
        "endpoint": f"http://127.0.0.1:{server.port}",
        "region": "us-east-1",
        "skip_signature": "true",
    }
    return NetworkOptions(options_of_store=store, pause_seconds=0.01, **changes)


def test_a_scene_is_read_by_ranges(data):
    with serving(FaultServer(data)) as server:
        assert_same(cogsplat.decode(URL, network=options_of(server)), cogsplat.decode(data))
    assert [asked.path for asked in server.asked][:1] == ["/bucket/scenes/a.cogs"]
    assert (server.asked[0].first, server.asked[0].end) == (0, 65536)


def test_a_folder_is_read_object_by_object(data):
    objects = folder_of_file(data)

    async def one_object(exchange):
        exchange.server.data = objects[exchange.asked.path.removeprefix("/bucket/scenes/")]
        await right(exchange)

    with serving(FaultServer(b"", always=one_object)) as server:
        network = options_of(server)
        with cogsplat.open("s3://bucket/scenes/", network=network) as file:
            assert_same(file.decode([3]), cogsplat.decode(data, chunks=(3, 4)))
            assert file.traffic.requests == 3
        assert_same(cogsplat.decode("s3://bucket/scenes/", network=network), cogsplat.decode(data))


def test_what_breaks_is_asked_for_again(data):
    faults = [right, status(503), broken_after(5000)]
    with serving(FaultServer(data, faults)) as server, open_url(URL, options_of(server)) as source:
        assert source.read(100_000, 9000) == data[100_000:109_000]
        assert source.traffic.failures >= 1


@pytest.mark.parametrize(("answer", "code"), [(404, "not-found"), (403, "permission")])
def test_refusals_are_told_apart(answer, code):
    with (
        serving(FaultServer(b"", always=status(answer))) as server,
        pytest.raises(StorageError, match=r"a\.cogs: the store") as caught,
    ):
        open_url(URL, options_of(server))
    assert caught.value.code == code


# obstore asks a future whether it was cancelled, and then reports to its loop. The pause between
# the two is what a busy machine adds by chance: the loop is closed before the report.
_LATE_REPORTS = """
import asyncio, sys, threading, time
from cogsplat.formats.network.open_url import open_url
from cogsplat.formats.network.network_options import NetworkOptions

class SlowFuture(asyncio.Future):
    def cancelled(self):
        found = super().cancelled()
        if threading.current_thread() not in python_threads:
            time.sleep(0.05)
        return found

python_threads = {threading.main_thread()}
asyncio.BaseEventLoop.create_future = lambda loop: SlowFuture(loop=loop)
start = threading.Thread.start
threading.Thread.start = lambda thread: (python_threads.add(thread), start(thread))[1]
store = {"endpoint": sys.argv[1], "region": "us-east-1", "skip_signature": "true"}
for _ in range(5):
    with open_url("s3://bucket/scenes/a.cogs", NetworkOptions(options_of_store=store)) as source:
        ranges = [(offset, 9000) for offset in range(100_000, 400_000, 100_000)]
        with source.prefetch(ranges):
            pass
time.sleep(0.2)
"""


def test_requests_that_end_after_their_source_print_nothing(data):
    with serving(FaultServer(data)) as server:
        words = [sys.executable, "-c", _LATE_REPORTS, f"http://127.0.0.1:{server.port}"]
        done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=True)
    assert done.stderr == ""


def test_options_that_no_store_has_are_told():
    with pytest.raises(StorageError, match="s3://bucket") as caught:
        ObjectTransport(URL, NetworkOptions(options_of_store={"no_such_option": "1"}))
    assert caught.value.code == "store-options"


def test_without_the_extra_its_name_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "obstore", None)
    with pytest.raises(MissingExtraError, match=r"cogsplat\[cloud\]") as caught:
        open_url(URL)
    assert caught.value.code == "needs-cloud"
