"""Servers that cost more than an answer: bounded in bytes, requests and time, with coded errors."""

import asyncio
import errno
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from cogs_samples import assert_same, file_of
from fault_server import Exchange, Fault, FaultServer, broken_after, right, serving, stating, status

import cogsplat
from cogsplat.codec.errors import CogsplatError
from cogsplat.formats.network import http_transport, range_source
from cogsplat.formats.network.download import download
from cogsplat.formats.network.network_options import NetworkOptions
from cogsplat.formats.network.open_url import open_url

pytestmark = pytest.mark.filterwarnings("ignore:.*the server ignores range requests")

QUICK = NetworkOptions(pause_seconds=0.01, idle_seconds=0.25, connect_seconds=0.25)

# For servers that must be read, a timeout that a busy machine meets.
PATIENT = NetworkOptions(pause_seconds=0.01)

FOREVER = 10_000


@pytest.fixture(scope="module")
def data() -> bytes:
    return file_of("vq", 6000, 3, 500)


def outcome_of(server: FaultServer, network: NetworkOptions = QUICK) -> str:
    """Return the reason code of decoding, or ``works``."""
    try:
        found = cogsplat.decode(server.url(), network=network)
    except CogsplatError as error:
        return error.code if error.message.isprintable() else error.message
    assert_same(found, cogsplat.decode(server.data))
    return "works"


async def dripping(exchange: Exchange) -> None:
    """Send a byte of the body at a time, more often than the timeout."""
    exchange.head(206, exchange.stated())
    for at in range(FOREVER):
        exchange.writer.write(exchange.part[at : at + 1])
        await exchange.writer.drain()
        await asyncio.sleep(0.05)


async def dripping_headers(exchange: Exchange) -> None:
    """Send a header at a time, without end."""
    exchange.writer.write(b"HTTP/1.1 206 Said\r\n")
    for at in range(FOREVER):
        exchange.writer.write(b"x-%d: 1\r\n" % at)
        await exchange.writer.drain()
        await asyncio.sleep(0.05)


async def continuing(exchange: Exchange) -> None:
    """Send informational responses without end."""
    for _ in range(FOREVER):
        exchange.writer.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        await exchange.writer.drain()
        await asyncio.sleep(0.02)


async def one_byte(exchange: Exchange) -> None:
    """Answer with the first byte of the range, and say so."""
    asked, size = exchange.asked, len(exchange.data)
    await stating(
        body=exchange.part[:1], Content_Range=f"bytes {asked.first}-{asked.first}/{size}"
    )(exchange)


def endless(beginning: bytes = b"", block: bytes = b"A" * 65536, **headers: str) -> Fault:
    """Send a whole file without its length, and block after block behind it."""

    async def fault(exchange: Exchange) -> None:
        exchange.head(200, {"Connection": "close", **headers})
        exchange.writer.write(beginning)
        while True:
            exchange.writer.write(block)
            await exchange.writer.drain()
            exchange.server.sent += len(block)

    return fault


def raw(text: bytes) -> Fault:
    """Send bytes in place of a response, and close the connection."""

    async def fault(exchange: Exchange) -> None:
        exchange.writer.write(text)
        await exchange.writer.drain()
        exchange.writer.write_eof()
        await asyncio.sleep(0.05)
        exchange.keep = False

    return fault


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (dripping, "network-timeout"),
        (dripping_headers, "network-timeout"),
        (continuing, "network-timeout"),
        (broken_after(1), "connection-broken"),
        (one_byte, "connection-broken"),
    ],
    ids=["body", "headers", "100-continue", "byte-a-connection", "byte-a-range"],
)
def test_a_server_without_progress_is_left_after_five_attempts(
    fault: Fault, code: str, data: bytes
) -> None:
    with serving(FaultServer(data, always=fault)) as server:
        assert outcome_of(server) == code
    assert len(server.asked) == 5


def test_a_drip_behind_a_good_beginning_ends_as_well(data: bytes) -> None:
    with serving(FaultServer(data, [right], always=dripping)) as server:
        assert outcome_of(server) == "network-timeout"
    # The ranges are asked for side by side, each five times.
    assert len(server.asked) < 40


def test_a_link_that_is_slower_than_the_timeout_but_makes_progress_works(data: bytes) -> None:
    async def slow_start(exchange: Exchange) -> None:
        """Break after 6 KiB: three attempts make progress, and the count of failures restarts."""
        await broken_after(6 << 10)(exchange)

    with serving(FaultServer(data, always=slow_start)) as server:
        assert outcome_of(server, PATIENT) == "works"
    assert len(server.asked) > 20


def test_bytes_that_are_not_of_our_format_are_refused_by_the_first_of_them(data: bytes) -> None:
    with serving(FaultServer(data, always=endless())) as server:
        assert outcome_of(server) == "not-cogs"
    assert len(server.asked) <= 2
    # What buffers of sockets hold.
    assert server.sent < 64 << 20


def test_a_body_without_end_ends_where_the_file_does(data: bytes) -> None:
    with serving(FaultServer(data, always=endless(data))) as server:
        assert outcome_of(server, PATIENT) == "works"
    assert len(server.asked) == 1


def test_a_body_without_a_length_that_breaks_is_asked_for_again(data: bytes) -> None:
    async def chunked(exchange: Exchange) -> None:
        exchange.head(200, {"Transfer-Encoding": "chunked"})
        exchange.writer.write(b"%x\r\n%s\r\n" % (len(data), data))
        exchange.writer.write(b"0\r\n\r\n")
        await exchange.writer.drain()

    async def cut(exchange: Exchange) -> None:
        exchange.head(200, {"Transfer-Encoding": "chunked"})
        exchange.writer.write(b"%x\r\n%s" % (len(data), data[:90_000]))
        await exchange.writer.drain()
        await asyncio.sleep(0.02)
        exchange.break_off()

    with serving(FaultServer(data, [cut, cut], always=chunked)) as server:
        assert outcome_of(server, PATIENT) == "works"
    assert len(server.asked) == 3
    # Less than a preamble arrives, and the length is still unknown: nobody waits for ever.
    with serving(FaultServer(data, always=raw(b"HTTP/1.1 200 OK\r\n\r\n" + data[:5]))) as server:
        assert outcome_of(server) == "preamble-truncated"


def test_a_server_that_sends_the_whole_file_and_then_ranges_is_read(data: bytes) -> None:
    async def cut(exchange: Exchange) -> None:
        exchange.head(200, {"Content-Length": str(len(data))})
        exchange.writer.write(data[:90_000])
        await exchange.writer.drain()
        await asyncio.sleep(0.02)
        exchange.break_off()

    with serving(FaultServer(data, [cut])) as server:
        assert outcome_of(server, PATIENT) == "works"
    assert [asked.first for asked in server.asked] == [0, 90_000]
    with serving(FaultServer(data, [right, cut])) as server:
        assert outcome_of(server, PATIENT) == "works"
    # The same with bodies of which nothing is right.
    bad = raw(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n-1\r\nabc")
    with serving(FaultServer(data, [right, bad])) as server:
        assert outcome_of(server, PATIENT) == "works"


def test_a_stated_length_beyond_all_disks_takes_no_more_than_is_read(data: bytes) -> None:
    fault = endless(Content_Length="9" * 18)
    with serving(FaultServer(data, always=fault)) as server:
        assert outcome_of(server) == "not-cogs"
    assert server.sent < 64 << 20


def test_a_download_without_a_length_ends_at_the_limit(tmp_path: Path) -> None:
    network = NetworkOptions(unstated_bytes=1 << 20)
    with serving(FaultServer(b"", always=endless())) as server:
        with pytest.raises(cogsplat.StorageError, match="unstated_bytes") as caught:
            download(server.url("a.ply"), tmp_path / "a.ply", network)
        assert caught.value.code == "answer-length"
    assert list(tmp_path.iterdir()) == []


def test_a_download_of_a_length_beyond_all_memory_is_refused_by_what_comes(tmp_path: Path) -> None:
    async def large(exchange: Exchange) -> None:
        asked = exchange.asked
        if asked.first:
            await status(404)(exchange)
            return
        span = f"bytes 0-{asked.end - 1}/{10**18}"
        await stating(body=bytes(asked.end), Content_Range=span)(exchange)

    with serving(FaultServer(bytes(65536), always=large)) as server:
        with pytest.raises(cogsplat.StorageError) as caught:
            download(server.url("a.ply"), tmp_path / "a.ply", QUICK)
        assert caught.value.code == "not-found"


def test_a_full_disk_of_temporary_files_is_told(
    data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Full(tempfile.SpooledTemporaryFile):  # type: ignore[type-arg]
        def write(self, part: bytes) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "SpooledTemporaryFile", Full)
    with serving(FaultServer(data, always=endless(data))) as server:
        assert outcome_of(server) == "disk-full"


def test_cookies_are_not_kept(data: bytes) -> None:
    async def baking(exchange: Exchange) -> None:
        name = f"c{len(exchange.server.asked)}"
        await exchange.send(
            206, exchange.stated() | {"Set-Cookie": f"{name}={'x' * 60_000}"}, exchange.part
        )

    with (
        serving(FaultServer(data, always=baking)) as server,
        cogsplat.open(server.url(), network=QUICK) as file,
    ):
        for chunk in range(3):
            file.decode([chunk])
    assert len(server.asked) > 3
    assert all("cookie" not in asked.headers for asked in server.asked)


@pytest.mark.parametrize(
    "location",
    [
        "http://h:99999/",
        "http://h:-1/",
        "http://h:x/",
        "http://h:0/",
        "http://xn--a/",
        "http://a..b/",
        "http://[::1",
        "http:///x",
        "http://",
        "ftp://h/a",
        "file:///etc/passwd",
        "data:,a",
        "http://h/\x7f",
        "http://h\x01/",
        "http://\xff\xfe/",
        "http://" + "a" * 300 + "/",
        "http://u:p@/",
        "s3://bucket/a",
    ],
)
def test_redirects_that_lead_nowhere_are_refused(location: str, data: bytes) -> None:
    async def away(exchange: Exchange) -> None:
        exchange.writer.write(
            f"HTTP/1.1 302 Found\r\nLocation: {location}\r\nContent-Length: 0\r\n\r\n".encode(
                "latin-1"
            )
        )
        await exchange.writer.drain()

    with serving(FaultServer(data, always=away)) as server:
        assert outcome_of(server) in (
            "redirect-refused", "redirect-loop", "host-unreachable", "connection-broken",
        )  # fmt: skip
    assert len(server.asked) <= 6


@pytest.mark.parametrize(
    "headers",
    [
        {"Retry-After": "Sun, 22 Nov 2026 12:00:30 +9999"},
        {"Retry-After": "Fri, 31 Dec 9999 23:59:59 -2359"},
        {"Retry-After": "1", "Date": "Mon, 01 Jan 0001 00:00:00 +2359"},
        {"Retry-After": "9" * 400},
        {"Retry-After": "\x80"},
        {"Retry-After": "Sun, 22 Nov 2026 12:00:30 -99999999999"},
        {
            "Retry-After": "Fri, 31 Dec 9999 23:59:59 GMT",
            "Date": "Sun, 22 Nov 2026 12:00:30 -9999999",
        },
    ],
)
def test_absurd_times_to_retry_are_coded(headers: dict[str, str], data: bytes) -> None:
    async def later(exchange: Exchange) -> None:
        lines = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
        text = f"HTTP/1.1 503 Later\r\nContent-Length: 0\r\n{lines}\r\n"
        exchange.writer.write(text.encode("latin-1"))
        await exchange.writer.drain()

    network = NetworkOptions(pause_seconds=0.01, longest_wait_seconds=0.5)
    with serving(FaultServer(data, always=later)) as server:
        assert outcome_of(server, network) == "http-status"
    assert len(server.asked) <= 5


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"\r\n" * 1000,
        b"garbage\r\n\r\n",
        b"\0" * 100_000,
        b"HTTP/1.1 999 No\r\n\r\n",
        b"HTTP/9.9 200 OK\r\n\r\n",
        b"HTTP/1.1 -1 OK\r\n\r\n",
        b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\r\n",
        b"HTTP/1.1 204 None\r\n\r\n",
        b"HTTP/1.1 206 Part\r\n\r\n",
        b"HTTP/1.1 304 Same\r\n\r\n",
        b"HTTP/1.1 416 Not\r\nContent-Range: bytes */x\r\nContent-Length: 0\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nContent-Length: -1\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\nab",
        b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nffffffffffffffffffffff\r\nabc",
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n-5\r\nabc",
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: bogus\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nno colon\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nx: \xff\0\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nx: " + b"y" * 300_000 + b"\r\n\r\n",
        b"HTTP/1.1 206 Part\r\nContent-Range: bytes 0-65535/\xd9\xa3\r\n\r\n",
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes(200),
    ],
)
def test_what_is_no_response_is_a_coded_error(text: bytes, data: bytes) -> None:
    with serving(FaultServer(data, always=raw(text))) as server:
        assert outcome_of(server) in {
            "connection-broken", "http-status", "not-cogs", "answer-range", "source-changed",
            "file-truncated", "network-timeout", "preamble-truncated",
        }  # fmt: skip
    assert len(server.asked) <= 10


@pytest.mark.parametrize(
    "url",
    [
        "http://h:99999/",
        "http://h:-1/",
        "http://h:x/a",
        "http://h:0/a",
        "http://[::1/a",
        "http://a\nb/",
        "http://127.0.0.1:1/\n",
        "http://\ud800/",
        "http://h/\ud800",
        "http://xn--a/",
        "https:///x",
        "https://?x",
        "http://u:p@/a",
        "s3://b:99999/a",
        "s3://bucket/a/../b",
        "s3://bucket/..",
        "s3://bucket/a\nb",
        "s3://b\0/a",
        "s3://[::1/a",
        "az://..",
    ],
)
def test_malformed_addresses_of_the_caller_are_coded(url: str) -> None:
    network = NetworkOptions(
        options_of_store={"skip_signature": "true", "region": "us-east-1"}, retries=0
    )
    for work in (cogsplat.open, cogsplat.decode, open_url):
        with pytest.raises(cogsplat.StorageError) as caught:
            work(url, network=network) if work is not open_url else work(url, network)
        assert caught.value.code in ("bad-url", "store-options")
        assert caught.value.message.isprintable()


def test_a_bucket_that_climbs_is_coded() -> None:
    store = {"endpoint": "http://127.0.0.1:9", "skip_signature": "true", "region": "us-east-1"}
    for url in ("s3://../..", "s3://../../a"):
        with pytest.raises(cogsplat.StorageError) as caught:
            cogsplat.open(url, network=NetworkOptions(options_of_store=store, retries=0))
        assert caught.value.code in ("bad-url", "connection-broken")


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("SSL_CERT_FILE", "/no/such/file.pem"),
        ("HTTP_PROXY", "nonsense://h:1"),
        ("ALL_PROXY", "socks5://127.0.0.1:1"),
    ],
)
def test_environments_that_no_client_can_use_are_coded(
    variable: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    http_transport._certificates.cache_clear()
    monkeypatch.setenv(variable, value)
    with pytest.raises(cogsplat.StorageError, match=variable) as caught:
        cogsplat.open("http://127.0.0.1:1/a.cogs", network=NetworkOptions(retries=0))
    assert caught.value.code == "network-settings"
    http_transport._certificates.cache_clear()


def test_a_process_without_descriptors_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    class NoLoop:
        def __init__(self) -> None:
            raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(range_source, "_EventLoop", NoLoop)
    with pytest.raises(cogsplat.StorageError, match="Too many open files") as caught:
        cogsplat.open("http://127.0.0.1:1/a.cogs")
    assert caught.value.code == "io"


def test_malformed_addresses_on_the_command_line_are_coded() -> None:
    for url in ("http://[::1/a.cogs", "http://h:99999/a.ply", "s3://bucket/../a.ply"):
        done = subprocess.run(
            [sys.executable, "-m", "cogsplat.tools.main", "info", url],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 4, done.stderr
        assert "Traceback" not in done.stderr
        assert "[bad-url]" in done.stderr


def test_a_range_that_was_read_does_not_end_the_download_of_the_whole_file(data: bytes) -> None:
    async def slow_whole(exchange: Exchange) -> None:
        exchange.head(200, {"Content-Length": str(len(data))})
        for at in range(0, len(data), 1 << 14):
            exchange.writer.write(data[at : at + (1 << 14)])
            await exchange.writer.drain()
            await asyncio.sleep(0.005)

    with (
        serving(FaultServer(data, [right], always=slow_whole)) as server,
        open_url(server.url(), PATIENT) as source,
    ):
        for offset in range(66_000, len(data), 20_000):
            length = min(20_000, len(data) - offset)
            assert source.read(offset, length) == data[offset : offset + length]
    assert len(server.asked) == 2


def test_a_whole_file_is_begun_five_times_at_most(data: bytes) -> None:
    async def further(exchange: Exchange) -> None:
        """Send 20 KiB more than the last time; all of it is received again."""
        exchange.head(200, {"Content-Length": str(len(data))})
        exchange.writer.write(data[: len(exchange.server.asked) * 20_480])
        await exchange.writer.drain()
        await asyncio.sleep(0.02)
        exchange.break_off()

    with serving(FaultServer(data, always=further)) as server:
        assert outcome_of(server) == "connection-broken"
    assert len(server.asked) == 5
