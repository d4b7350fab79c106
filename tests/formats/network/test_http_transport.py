import asyncio
import struct
from functools import partial

import httpx
import numpy as np
import pytest
from fault_server import FaultServer, listening, serving, status
from h2.config import H2Configuration
from h2.connection import H2Connection
from h2.events import RequestReceived

from cogsplat.codec.errors import MissingExtraError, StorageError
from cogsplat.formats.network import http_transport
from cogsplat.formats.network.backoff import TransientError
from cogsplat.formats.network.http_transport import HttpTransport, new_client
from cogsplat.formats.network.network_options import NetworkOptions
from cogsplat.formats.network.range_source import RangeSource

DATA = np.random.default_rng(2).bytes(400_000)


def fetched(transport, first=0, end=100):
    """Return the bytes of one range request."""

    async def one():
        try:
            async with transport.get(first, end) as answer:
                return b"".join([part async for part in answer.parts])
        finally:
            await transport.close()

    return asyncio.run(one())


def mocked(handler, url="https://a.org/c.cogs", **options):
    network = NetworkOptions(**options)
    return HttpTransport(url, network, new_client(network, httpx.MockTransport(handler)))


def test_one_range_without_compression():
    with serving(FaultServer(DATA)) as server:
        assert fetched(HttpTransport(server.url(), NetworkOptions()), 5, 95) == DATA[5:95]
    assert server.asked[0].headers["range"] == "bytes=5-94"


@pytest.mark.parametrize(
    "target", ["http://a.org/c.cogs", "ftp://a.org/c.cogs", "data:,a", "https://[::1"]
)
def test_redirects_to_what_is_less_safe_are_refused(target):
    transport = mocked(lambda request: httpx.Response(302, headers={"Location": target}))
    with pytest.raises(StorageError, match="redirected") as caught:
        fetched(transport)
    assert caught.value.code == "redirect-refused"


def test_a_redirect_that_has_expired_is_asked_for_again():
    asked = []

    def handler(request):
        asked.append(request.url.path)
        if request.url.path == "/c.cogs":
            return httpx.Response(302, headers={"Location": f"/signed{len(asked)}"})
        if request.url.path == "/signed1" and len(asked) > 2:
            return httpx.Response(403)
        return httpx.Response(416, headers={"Content-Range": "bytes */0"})

    async def twice():
        transport = mocked(handler)
        for _ in range(2):
            async with transport.get(0, 10) as answer:
                assert answer.head.total == 0
        await transport.close()

    asyncio.run(twice())
    assert asked == ["/c.cogs", "/signed1", "/signed1", "/c.cogs", "/signed4"]


def test_a_certificate_that_is_wrong_is_not_tried_again():
    def handler(request):
        raise httpx.ConnectError("[SSL: CERTIFICATE_VERIFY_FAILED] self-signed")

    with pytest.raises(StorageError, match="self-signed") as caught:
        fetched(mocked(handler))
    assert caught.value.code == "host-unreachable"


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (httpx.ConnectError("no route"), "host-unreachable"),
        (httpx.ConnectTimeout(""), "network-timeout"),
        (httpx.ReadTimeout(""), "network-timeout"),
        (httpx.RemoteProtocolError("cut"), "connection-broken"),
        (httpx.ReadError(""), "connection-broken"),
    ],
)
def test_faults_that_may_pass(fault, code):
    def handler(request):
        raise fault

    with pytest.raises(TransientError, match=r"https://a.org/c.cogs: .{10}") as caught:
        fetched(mocked(handler))
    assert caught.value.code == code


def test_access_is_signed_once_for_a_request():
    signed = []

    def sign():
        signed.append(1)
        return "https://a.org/c.cogs?new"

    with pytest.raises(StorageError, match="refuses access"):
        fetched(mocked(lambda request: httpx.Response(403), sign=sign))
    assert signed == [1]


def test_without_the_extra_its_name_is_told(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "httpx", None)
    with pytest.raises(MissingExtraError, match=r"cogsplat\[http\]") as caught:
        HttpTransport("https://a.org/c.cogs", NetworkOptions())
    assert caught.value.code == "needs-http"


def test_redirect_statuses_without_a_place_are_refused():
    with serving(FaultServer(DATA, always=status(302))) as server:
        transport = HttpTransport(server.url(), NetworkOptions())
        with pytest.raises(StorageError, match="status 302"):
            fetched(transport)


class Http2Server:
    """Answers ranges over HTTP/2 without TLS; the first answer ends with GOAWAY, half way."""

    def __init__(self):
        self.asked = []
        self.connections = 0

    async def serve(self, reader, writer):
        self.connections += 1
        connection = H2Connection(H2Configuration(client_side=False, header_encoding="utf-8"))
        connection.initiate_connection()
        writer.write(connection.data_to_send())
        tasks = []
        while data := await reader.read(65536):
            events = connection.receive_data(data)
            tasks += [
                asyncio.create_task(self.answer(connection, event, writer))
                for event in events
                if isinstance(event, RequestReceived)
            ]
            writer.write(connection.data_to_send())
        await asyncio.gather(*tasks, return_exceptions=True)
        writer.close()

    async def answer(self, connection, event, writer):
        headers = dict(event.headers)
        first, last = map(int, headers["range"].removeprefix("bytes=").split("-"))
        part = DATA[first : last + 1]
        self.asked.append((first, last + 1))
        goes_away = len(self.asked) == 2
        span = f"bytes {first}-{first + len(part) - 1}/{len(DATA)}"
        told = [(":status", "206"), ("content-range", span), ("content-length", str(len(part)))]
        connection.send_headers(event.stream_id, told)
        sent = 0
        while sent < len(part):
            room = min(connection.local_flow_control_window(event.stream_id), 16384)
            if not room:
                await asyncio.sleep(0.001)
                continue
            connection.send_data(event.stream_id, part[sent : sent + room])
            writer.write(connection.data_to_send())
            sent += room
            if goes_away:
                connection.close_connection(last_stream_id=event.stream_id)
                writer.write(connection.data_to_send())
                await writer.drain()
                writer.close()
                return
        connection.end_stream(event.stream_id)
        writer.write(connection.data_to_send())
        await writer.drain()


def test_http2_shares_a_connection_and_survives_its_end(monkeypatch):
    """F23: GOAWAY in the middle of an answer."""
    server = Http2Server()
    with listening(server.serve) as port:
        # Without TLS nothing is negotiated: HTTP/2 from the first byte.
        only_http2 = partial(httpx.AsyncClient, http1=False, http2=True)
        monkeypatch.setattr(http_transport, "new_client", lambda options: only_http2())
        url = f"http://127.0.0.1:{port}/c.cogs"
        network = NetworkOptions(pause_seconds=0.01)
        transport = HttpTransport(url, network)
        with RangeSource(transport, url, network) as source:
            ranges = [(at, 100) for at in range(100_000, 399_000, 70_000)]
            with source.prefetch(ranges):
                for offset, length in ranges:
                    assert source.read(offset, length) == DATA[offset : offset + length]
            assert source.traffic.failures >= 1
            assert len(server.asked) > len(ranges)
    assert server.connections == 2


PREFACE = b"\x00\x00\x00\x04\x00\x00\x00\x00\x00"
"""An empty SETTINGS frame, with which every server begins."""


def frame(kind, flags, stream, payload=b""):
    """Return an HTTP/2 frame."""
    return struct.pack(">IBBI", len(payload), kind, flags, stream)[1:] + payload


def field(name, value):
    """Return a header in HPACK, literal and not indexed."""
    return b"\x00" + bytes([len(name)]) + name + bytes([len(value)]) + value


def informational():
    """Return a block of headers of a status that is not final."""
    return frame(1, 4, 1, field(b":status", b"103"))


HEAD = frame(1, 4, 1, field(b":status", b"206") + field(b"content-range", b"bytes 0-65535/400000"))

HOSTILE_FRAMES = {
    "informational": (b"", informational()),
    "pings": (b"", frame(6, 0, 0, bytes(8))),
    "settings": (b"", PREFACE),
    "window-updates": (HEAD, frame(8, 0, 0, struct.pack(">I", 1))),
    "empty-data": (HEAD, frame(0, 0, 1)),
    "one-byte": (HEAD, frame(0, 0, 1, b"A")),
    "continuations": (frame(1, 0, 1, field(b"a", b"b")), frame(9, 0, 1, field(b"c", b"d"))),
    "reset": (b"", frame(3, 0, 1, struct.pack(">I", 11))),
    "goaway": (b"", frame(7, 0, 0, bytes(8))),
    "push": (b"", frame(5, 4, 1, struct.pack(">I", 2) + field(b":method", b"GET"))),
    "unknown": (b"", frame(200, 255, 77, b"x" * 100)),
    "long": (b"", b"\xff\xff\xff\x00\x00\x00\x00\x00\x01" + b"x" * 1000),
    "bad-headers": (b"", frame(1, 4, 1, b"\xff\xff\xff\xff\xff\xff\xff")),
    "no-status": (b"", frame(1, 4, 1, field(b"a", b"b"))),
    "status-of-letters": (frame(1, 4, 1, field(b":status", b"2OO")), b""),
}


@pytest.mark.parametrize("name", HOSTILE_FRAMES)
def test_frames_without_end_are_left(name, monkeypatch):
    beginning, repeated = HOSTILE_FRAMES[name]

    async def serve(reader, writer):
        async def drain():
            while await reader.read(65536):
                pass

        reading = asyncio.create_task(drain())
        await asyncio.sleep(0.05)
        writer.write(PREFACE + beginning)
        try:
            while True:
                writer.write(repeated * 10)
                await writer.drain()
                await asyncio.sleep(0.01)
        except ConnectionError:
            writer.close()
        finally:
            reading.cancel()

    with listening(serve) as port:
        only_http2 = partial(httpx.AsyncClient, http1=False, http2=True)
        monkeypatch.setattr(http_transport, "new_client", lambda options: only_http2())
        url = f"http://127.0.0.1:{port}/c.cogs"
        network = NetworkOptions(
            pause_seconds=0.01, idle_seconds=0.2, connect_seconds=0.2, retries=1
        )
        with (
            pytest.raises(StorageError) as caught,
            RangeSource(HttpTransport(url, network), url, network) as source,
        ):
            source.read(0, 65536)
        assert caught.value.code in ("network-timeout", "connection-broken", "http-status")


def test_the_module_imports_without_the_extra():
    """The module's imports at the top leave httpx out."""
    assert "httpx" not in vars(http_transport)
