import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from fault_server import FaultServer, no_ranges, reset, right, serving, slow, stating, status

from cogsplat.codec.errors import Cancelled, CogsplatWarning, StorageError, TruncatedError
from cogsplat.formats.network.network_options import NetworkOptions
from cogsplat.formats.network.open_url import open_url
from cogsplat.formats.storage.source import PrefixSource, RemoteSource

DATA = np.random.default_rng(1).bytes(3_000_000)
QUICK = NetworkOptions(pause_seconds=0.01, idle_seconds=1)


@pytest.fixture
def server():
    with serving(FaultServer(DATA)) as made:
        yield made


def test_ranges_are_what_was_asked_for(server):
    with open_url(server.url()) as source:
        assert source.size == len(DATA)
        assert source.name == server.url()
        assert isinstance(source, RemoteSource)
        for offset, length in [(0, 8), (65530, 20), (1_000_000, 5000), (len(DATA), 0), (9, 0)]:
            assert source.read(offset, length) == DATA[offset : offset + length]
        assert source.reread(4, 6) == DATA[4:10]
        traffic = source.traffic
    # The beginning, two ranges behind it, and the one that was read again.
    assert traffic.requests == len(server.asked) == 4
    assert traffic.received_bytes == 65536 + 20 + 5000 + 6
    assert server.asked[3].headers["cache-control"] == "no-cache"
    assert all(asked.headers["accept-encoding"] == "identity" for asked in server.asked)


@pytest.mark.parametrize(("offset", "length"), [(len(DATA) - 1, 2), (1 << 60, 1)])
def test_reading_past_the_end_is_a_truncation(server, offset, length):
    with open_url(server.url()) as source, pytest.raises(TruncatedError) as caught:
        source.read(offset, length)
    assert caught.value.code == "file-truncated"
    assert caught.value.needed == offset + length


def test_negative_ranges_and_closed_sources_are_misuse(server):
    with open_url(server.url()) as source, pytest.raises(ValueError, match="negative"):
        source.read(-1, 5)
    with pytest.raises(ValueError, match="closed"):
        source.read(100_000, 5)


def test_empty_and_short_files():
    for data in (b"", b"short"):
        with serving(FaultServer(data)) as server, open_url(server.url()) as source:
            assert source.size == len(data)
            assert source.read(0, len(data)) == data


def test_what_is_fetched_ahead_takes_few_requests(server):
    ranges = [(at, 1000) for at in range(60_000, 2_000_000, 2000)]
    with open_url(server.url()) as source:
        with source.prefetch(ranges):
            for offset, length in ranges:
                assert source.read(offset, length) == DATA[offset : offset + length]
        assert source.traffic.requests < 8
        # Gaps are fetched with what lies around them, nothing twice.
        assert source.traffic.received_bytes < 2_000_000


def test_far_ranges_are_requests_of_their_own(server):
    ranges = [(2_000_000, 10), (200_000, 10), (1_000_000, 10)]
    with open_url(server.url()) as source, source.prefetch(ranges):
        parts = [source.read(*span) for span in reversed(ranges)]
    assert parts == [DATA[at : at + 10] for at, _ in reversed(ranges)]
    assert [asked.first for asked in server.asked] == [0, 2_000_000, 200_000, 1_000_000]


def test_memory_ahead_is_bounded_and_reading_out_of_order_goes_on(server):
    network = NetworkOptions(window_bytes=200_000, request_bytes=100_000)
    ranges = [(at, 50_000) for at in range(100_000, 2_900_000, 50_000)]
    with open_url(server.url(), network) as source, source.prefetch(ranges):
        # Nothing reads; what was fetched stays within the window and what began inside it.
        threading.Event().wait(0.3)
        assert source.traffic.received_bytes < 65536 + 200_000 + 3 * 100_000
        for offset, length in [ranges[-1], *ranges[:-1]]:
            assert source.read(offset, length) == DATA[offset : offset + length]


def test_threads_share_a_source(server):
    def read(number: int) -> bool:
        offset = number * 7919 % (len(DATA) - 100)
        return source.read(offset, 100) == DATA[offset : offset + 100]

    with open_url(server.url()) as source, ThreadPoolExecutor(8) as pool:
        assert all(pool.map(read, range(100)))


def test_no_more_requests_at_once_than_allowed():
    now = most = 0
    lock = threading.Lock()

    async def counted(exchange):
        nonlocal now, most
        with lock:
            now += 1
            most = max(most, now)
        await slow(200_000, 500)(exchange)
        with lock:
            now -= 1

    with serving(FaultServer(DATA, always=counted)) as server, open_url(server.url()) as source:
        ranges = [(at, 2000) for at in range(200_000, 2_800_000, 100_000)]
        with source.prefetch(ranges):
            assert source.read(*ranges[-1]) == DATA[ranges[-1][0] : ranges[-1][0] + 2000]
    assert 2 <= most <= 6


def test_a_server_without_ranges_is_read_as_far_as_is_wanted():
    data = DATA * 10
    with serving(FaultServer(data, always=no_ranges)) as server:
        with pytest.warns(CogsplatWarning, match="whole file"):
            source = open_url(server.url())
        assert source.read(100_000, 50) == data[100_000:100_050]
        assert source.read(10, 50) == data[10:60]
        with source.prefetch([(5_000_000, 10)]):
            assert source.read(5_000_000, 10) == data[5_000_000:5_000_010]
        source.close()
    assert len(server.asked) == 1
    assert server.sent < len(data) - 5_000_000


def test_a_whole_file_whose_connection_breaks_goes_on_where_it_ended():
    async def breaking(exchange):
        size = str(len(DATA))
        await exchange.send(200, exchange.stated(Content_Range=None, Content_Length=size))
        exchange.writer.write(DATA[: 500_000 * len(exchange.server.asked)])
        await exchange.writer.drain()
        exchange.break_off()

    with serving(FaultServer(DATA, [breaking, breaking, breaking], no_ranges)) as server:
        with pytest.warns(CogsplatWarning, match="whole file"):
            source = open_url(server.url(), QUICK)
        with source:
            assert source.read(2_900_000, 100) == DATA[2_900_000:2_900_100]


def test_a_whole_file_of_unknown_length_is_read_to_its_end():
    async def unknown(exchange):
        headers = exchange.stated(Content_Range=None, Content_Length=None, Connection="close")
        await exchange.send(200, headers, exchange.data)
        exchange.keep = False

    with serving(FaultServer(DATA[:300_000], always=unknown)) as server:
        with pytest.warns(CogsplatWarning, match="whole file"):
            source = open_url(server.url(), QUICK)
        with source:
            assert source.size == 300_000
            assert source.read(299_000, 1000) == DATA[299_000:300_000]


def test_reads_after_a_failure_ask_again(server):
    with open_url(server.url(), NetworkOptions(retries=0)) as source:
        server.faults[:] = [reset, right]
        with pytest.raises(StorageError, match="1 attempt without"):
            source.read(100_000, 10)
        assert source.read(100_000, 10) == DATA[100_000:100_010]


def test_waiting_can_be_cancelled():
    with (
        serving(FaultServer(DATA, [right], slow(1000, 100))) as server,
        open_url(server.url()) as source,
        source.prefetch([(100_000, 50_000)]) as cancel,
    ):
        timer = threading.Timer(0.05, cancel)
        timer.start()
        with pytest.raises(Cancelled):
            source.read(100_000, 50_000)
        timer.join()


def test_another_length_is_another_file(server):
    with open_url(server.url()) as source:
        server.data = DATA[:-1]
        with pytest.raises(StorageError, match="2999999 bytes, expected 3000000") as caught:
            source.read(100_000, 10)
    assert caught.value.code == "source-changed"


def test_another_etag_is_another_file_where_it_begins_differently(server):
    with open_url(server.url()) as source:
        server.etag = '"two"'
        assert source.read(100_000, 10) == DATA[100_000:100_010]
        server.data, server.etag = b"?" + DATA[1:], '"three"'
        with pytest.raises(StorageError, match='"three"') as caught:
            source.read(100_000, 10)
    assert caught.value.code == "source-changed"


def test_a_server_that_hides_the_length_is_refused():
    hidden = stating(Content_Range="bytes 0-65535/*")
    with (
        serving(FaultServer(DATA, always=hidden)) as server,
        pytest.raises(StorageError, match="length of the file"),
    ):
        open_url(server.url())


def test_a_prefix_of_a_source_fetches_ahead_as_well(server):
    with open_url(server.url()) as source:
        prefix = PrefixSource(source, 1_000_000)
        ranges = [(at, 1000) for at in range(100_000, 1_200_000, 1000)]
        with prefix.prefetch(ranges):
            assert prefix.read(*ranges[0]) == DATA[100_000:101_000]
        assert prefix.reread(5, 5) == DATA[5:10]
        assert prefix.traffic.requests == source.traffic.requests
        with pytest.raises(TruncatedError):
            prefix.reread(999_999, 2)


def test_threads_end_with_their_sources(server):
    open_url(server.url()).close()
    with (
        pytest.raises(StorageError, match="no such file"),
        serving(FaultServer(DATA, always=status(404))) as other,
    ):
        open_url(other.url())
    assert not [thread for thread in threading.enumerate() if "fetches" in thread.name]


def test_a_file_that_is_wanted_whole_is_asked_for_at_once(server):
    ranges = [(0, 64), (60_000, 10_000), (2_900_000, 100_000), (65_536, 2_000_000), (70_000, 5)]
    with open_url(server.url()) as source:
        source.fetch_all()
        source.fetch_all()
        with source.prefetch(ranges, any_order=True):
            for offset, length in ranges:
                assert source.read(offset, length) == DATA[offset : offset + length]
                assert source.arrived(offset, length)
        assert source.read(0, len(DATA)) == DATA
        assert source.traffic.received_bytes == len(DATA)
        assert source.reread(100_000, 4) == DATA[100_000:100_004]
    asked = sorted((asked.first, asked.end) for asked in server.asked[:-1])
    # Nothing is asked for twice.
    assert [end for _, end in asked[:-1]] == [first for first, _ in asked[1:]]


def test_of_a_file_longer_than_the_window_nothing_is_asked_for_before_it_is_known(server):
    with open_url(server.url(), NetworkOptions(window_bytes=1_000_000)) as source:
        source.fetch_all()
        assert source.read(2_000_000, 10) == DATA[2_000_000:2_000_010]
        assert source.traffic.received_bytes == 65536 + 10


def test_waiting_for_a_file_that_was_wanted_whole_is_cancelled():
    async def stalling(exchange):
        await (right if exchange.asked.first == 0 else slow(1, 100))(exchange)

    with serving(FaultServer(DATA, always=stalling)) as server, open_url(server.url()) as source:
        source.fetch_all()
        with source.prefetch([(100_000, 5)]) as cancel:
            cancel()
            with pytest.raises(Cancelled):
                source.read(100_000, 5)
