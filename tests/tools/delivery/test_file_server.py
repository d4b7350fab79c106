import os
import socket
import ssl
import struct
import sys
import time
from contextlib import suppress

import h2.connection
import h2.events
import httpx
import numpy as np
import pytest
from certificates import made_certificate
from cogs_samples import assert_same, file_of

import cogsplat
from cogsplat.codec.errors import MissingExtraError, StorageError
from cogsplat.formats.network import http_transport
from cogsplat.tools.delivery import connection_limit, file_server, served_content
from cogsplat.tools.delivery.file_app import FileApp
from cogsplat.tools.delivery.file_server import FileServer, running
from cogsplat.tools.delivery.shaped_link import LinkQuality, ShapedLink


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.cogs"
    path.write_bytes(file_of("vq", 6000, 3, 500))
    return path


def served(path, certificate=None, **quality):
    app = FileApp(path, ShapedLink(LinkQuality(**quality)))
    return running(FileServer(app, certificate=certificate))


def test_a_scene_is_read_from_it(scene):
    with served(scene) as server, cogsplat.open(server.url + "scene.cogs") as file:
        assert_same(file.decode(), cogsplat.decode(scene))
        assert file.traffic.received_bytes <= scene.stat().st_size


def test_a_bad_link_gives_the_same_scene(scene):
    network = cogsplat.NetworkOptions(pause_seconds=0.01, retries=20)
    bad = {"loss": 0.4, "fail_rate": 0.3, "bits_per_second": 50e6, "latency_seconds": 0.005}
    failures = 0
    for seed in range(3):
        with (
            served(scene, seed=seed, **bad) as server,
            cogsplat.open(server.url + "scene.cogs", network=network) as file,
        ):
            assert_same(file.decode(), cogsplat.decode(scene))
            failures += file.traffic.failures
    assert failures


def test_http2_with_a_certificate(scene, tmp_path, monkeypatch):
    certificate = made_certificate(tmp_path)
    context = ssl.create_default_context(cafile=certificate.certificate)
    clients = []

    def new_client(options):
        clients.append(httpx.AsyncClient(http2=True, verify=context, event_hooks=hooks))
        return clients[-1]

    versions = set()

    async def seen(response):
        versions.add(response.http_version)

    hooks = {"response": [seen]}
    monkeypatch.setattr(http_transport, "new_client", new_client)
    with served(scene, certificate) as server:
        assert server.url.startswith("https://")
        assert_same(cogsplat.decode(server.url + "scene.cogs"), cogsplat.decode(scene))
    assert versions == {"HTTP/2"}


def test_a_port_in_use_is_an_error(scene):
    with served(scene) as server:
        app = FileApp(scene, ShapedLink(LinkQuality()))
        with pytest.raises(StorageError, match=str(server.port)):
            FileServer(app, server.port)


def test_stopping_before_it_began(scene):
    server = FileServer(FileApp(scene, ShapedLink(LinkQuality())))
    server.stop()
    server.serve_forever()
    server.close()


def test_the_missing_extra_is_named(scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "hypercorn.asyncio.tcp_server", None)
    with pytest.raises(MissingExtraError, match=r"cogsplat\[serve\]"):
        FileServer(FileApp(scene, ShapedLink(LinkQuality())))


def test_many_readers_at_once(scene):
    """A short form of `tools.lab.benchmark.many_readers`."""
    data = scene.read_bytes()
    rng = np.random.default_rng(1)

    async def read(client, url):
        first = int(rng.integers(0, len(data) - 5000))
        headers = {"Range": f"bytes={first}-{first + 4999}"}
        answer = await client.get(url, headers=headers)
        return answer.content == data[first : first + 5000]

    async def all_of_them(url):
        limits = httpx.Limits(max_connections=50)
        async with httpx.AsyncClient(limits=limits, timeout=60) as client:
            return await asyncio.gather(*(read(client, url) for _ in range(400)))

    import asyncio

    with served(scene) as server:
        assert all(asyncio.run(all_of_them(server.url + "scene.cogs")))


def connected(server):
    """Open a connection to a server."""
    peer = socket.create_connection(("127.0.0.1", server.port), timeout=60)
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    return peer


def request(name="scene.cogs", *headers):
    return "\r\n".join([f"GET /{name} HTTP/1.1", "Host: localhost", *headers, "", ""]).encode()


def wait_for(condition):
    """Wait until the server is in a state."""
    for _ in range(6000):
        if condition():
            return
        time.sleep(0.01)
    raise AssertionError("the server did not get there")


@pytest.fixture
def large(tmp_path):
    path = tmp_path / "large.cogs"
    path.write_bytes(bytes(8 << 20))
    return path


def test_short_packets_are_sent_at_once(scene):
    with served(scene) as server, connected(server):
        wait_for(lambda: len(server.connections) == 1)
        (peer,) = server.connections._connections
        assert peer.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_connections_that_a_peer_closed_are_released(scene, large):
    with served(scene.parent) as server:
        peers = []
        for sent in (b"", request(), b"GET /", request("large.cogs"), 50 * request("large.cogs")):
            peers.append(connected(server))
            peers[-1].sendall(sent)
        wait_for(lambda: len(server.connections) == 5)
        peers[3].recv(1)
        for peer in peers:
            peer.close()
        wait_for(lambda: not len(server.connections))


@pytest.mark.skipif(not hasattr(os, "sendfile"), reason="needs os.sendfile")
def test_most_bytes_are_sent_without_a_copy(tmp_path, monkeypatch):
    data = np.random.default_rng(1).bytes(8 << 20)
    (tmp_path / "random.cogs").write_bytes(data)
    read, copied = served_content.Content.read, []

    def counting_read(content, first, end):
        copied.append(end - first)
        return read(content, first, end)

    monkeypatch.setattr(served_content.Content, "read", counting_read)
    with served(tmp_path) as server, httpx.Client() as client:
        # Both on one connection, which h11 keeps if the bytes are those of Content-Length.
        url = server.url + "random.cogs"
        part = client.get(url, headers={"Range": "bytes=1000-5000000"})
        assert part.content == data[1000:5000001]
        assert client.get(url).content == data
        assert len(server.connections) == 1
    assert 0 < sum(copied) < 13e6 / 2


def test_silent_and_slow_peers_are_closed(scene, large, monkeypatch):
    monkeypatch.setattr(connection_limit, "IDLE_SECONDS", 0.2)
    with served(scene.parent) as server:
        peers = [connected(server) for _ in range(3)]
        peers[1].sendall(b"GET /scene.c")
        peers[2].sendall(request("large.cogs"))
        wait_for(lambda: not len(server.connections))
        assert peers[0].recv(1) == b""
        for peer in peers:
            peer.close()


def test_a_slow_link_is_no_idle_peer(scene, monkeypatch):
    monkeypatch.setattr(connection_limit, "IDLE_SECONDS", 0.2)
    with served(scene, latency_seconds=1.5) as server, connected(server) as peer:
        peer.sendall(request())
        assert peer.recv(12) == b"HTTP/1.1 200"


def test_new_connections_wait_for_room(scene, monkeypatch):
    monkeypatch.setattr(connection_limit, "CROWDED_IDLE_SECONDS", 0.2)
    with served(scene) as server:
        server.connections.limit = 2
        silent = [connected(server) for _ in range(8)]
        with connected(server) as peer:
            peer.sendall(request())
            assert peer.recv(12) == b"HTTP/1.1 200"
            assert len(server.connections) <= 2
        for other in silent:
            other.close()


def test_requests_beyond_the_limit_are_refused_for_now(scene, large, monkeypatch):
    monkeypatch.setattr(file_server, "_MAX_REQUESTS", 1)
    with served(scene.parent) as server, connected(server) as unread:
        unread.sendall(request("large.cogs"))
        unread.recv(1)
        with connected(server) as peer:
            peer.sendall(request())
            answer = peer.recv(1000)
            assert answer.startswith(b"HTTP/1.1 503")
            assert b"retry-after: 1" in answer


def test_pipelined_requests_of_an_unread_connection_wait(scene, large):
    with served(scene.parent) as server, connected(server) as peer:
        peer.setblocking(False)
        data = request("large.cogs") * 1000
        sent = 0
        with suppress(BlockingIOError):
            while sent < 16 << 20:
                sent += peer.send(data)
        # What buffers of both kernels, of asyncio and of h11 hold.
        assert sent < 16 << 20
        wait_for(lambda: server.requests == 1)


def test_websocket_upgrades_are_refused(scene):
    upgrade = ["Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Version: 13"]
    upgrade.append("Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==")
    with served(scene) as server, connected(server) as peer:
        peer.sendall(request("scene.cogs", *upgrade))
        answer = b""
        while part := peer.recv(1000):
            answer += part
        assert answer.startswith(b"HTTP/1.1 404")
        assert answer.endswith(b"404 Not Found\n")


def test_aborted_downloads_print_nothing(scene, large, capfd):
    with served(scene.parent) as server:
        for _ in range(5):
            with connected(server) as peer:
                peer.sendall(request("large.cogs"))
                peer.recv(1)
                # Closing sends a reset.
                peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        wait_for(lambda: not len(server.connections))
    assert capfd.readouterr().err == ""


def test_an_error_is_printed_once(scene, capfd, monkeypatch):
    def fails(self, name):
        raise RuntimeError(f"no {name}")

    monkeypatch.setattr(FileApp, "_content", fails)
    with served(scene) as server:
        for _ in range(3):
            assert httpx.get(server.url + "scene.cogs").status_code == 500
    assert capfd.readouterr().err.count("\n") == 1


def test_streams_that_are_reset_end(large, tmp_path):
    certificate = made_certificate(tmp_path)
    context = ssl.create_default_context(cafile=certificate.certificate)
    context.set_alpn_protocols(["h2"])
    with (
        served(large, certificate) as server,
        context.wrap_socket(connected(server), server_hostname="127.0.0.1") as peer,
    ):
        client = h2.connection.H2Connection()
        client.initiate_connection()
        head = [(":method", "GET"), (":path", "/large.cogs"), (":scheme", "https")]
        head.append((":authority", "127.0.0.1"))
        for stream in range(1, 201, 2):
            client.send_headers(stream, head, end_stream=True)
            client.reset_stream(stream)
        peer.sendall(client.data_to_send())
        wait_for(lambda: server.requests == 0)
        # The connection still answers.
        client.send_headers(201, [*head, ("range", "bytes=0-9")], end_stream=True)
        peer.sendall(client.data_to_send())
        ended = False
        while not ended:
            for event in client.receive_data(peer.recv(1 << 16)):
                ended |= isinstance(event, h2.events.StreamEnded) and event.stream_id == 201
            peer.sendall(client.data_to_send())
