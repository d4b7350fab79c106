"""The local server gives one file and its page, to this machine, by GET and HEAD."""

import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from http.client import HTTPConnection, HTTPResponse, IncompleteRead
from pathlib import Path

import pytest

from cogsplat.codec.errors import StorageError
from cogsplat.tools.delivery import connection_limit
from cogsplat.tools.delivery.local_server import SceneServer
from cogsplat.tools.delivery.threaded_server import HOST

CONTENT = bytes(range(256)) * 5


@pytest.fixture
def server(tmp_path: Path) -> Iterator[SceneServer]:
    (tmp_path / "garden.cogs").write_bytes(CONTENT)
    (tmp_path / "secret.txt").write_text("secret", encoding="utf-8")
    with SceneServer(tmp_path / "garden.cogs", "garden <1>") as server:
        thread = threading.Thread(target=server.serve_forever, args=[0.01])
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def ask(
    server: SceneServer, path: str, method: str = "GET", host: str | None = None, **headers: str
) -> tuple[HTTPResponse, bytes]:
    connection = HTTPConnection(HOST, server.server_port, timeout=30)
    connection.putrequest(method, path, skip_host=True)
    if host != "":
        connection.putheader("Host", host or f"{HOST}:{server.server_port}")
    for name, value in headers.items():
        connection.putheader(name.replace("_", "-"), value)
    connection.endheaders()
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer, body


def test_page_and_its_parts(server: SceneServer) -> None:
    answer, body = ask(server, "/")
    assert (answer.status, answer.headers["Content-Type"]) == (200, "text/html; charset=utf-8")
    assert b"<title>garden &lt;1&gt;</title>" in body
    assert ask(server, "/index.html")[1] == body
    for name, kind in {
        "viewer.js": "javascript",
        "viewer_extras.js": "javascript",
        "worker.js": "javascript",
        "viewer_worker.js": "javascript",
        "viewer.css": "css",
    }.items():
        answer, body = ask(server, f"/{name}")
        assert answer.status == 200
        assert answer.headers["Content-Type"] == f"text/{kind}; charset=utf-8"
        assert len(body) > 100


def test_scene_by_ranges(server: SceneServer) -> None:
    answer, body = ask(server, "/scene.cogs")
    assert (answer.status, body) == (200, CONTENT)
    assert answer.headers["Accept-Ranges"] == "bytes"
    etag = answer.headers["ETag"]
    answer, body = ask(server, "/scene.cogs", Range="bytes=100-299", If_Range=etag)
    assert (answer.status, body) == (206, CONTENT[100:300])
    assert answer.headers["Content-Range"] == f"bytes 100-299/{len(CONTENT)}"
    assert answer.headers["ETag"] == etag
    answer, body = ask(server, "/scene.cogs", Range="bytes=100-299", If_Range='"other"')
    assert (answer.status, body) == (200, CONTENT)
    answer, _ = ask(server, "/scene.cogs", Range=f"bytes={len(CONTENT)}-")
    assert answer.status == 416
    assert answer.headers["Content-Range"] == f"bytes */{len(CONTENT)}"
    answer, body = ask(server, "/scene.cogs", If_None_Match=etag)
    assert (answer.status, body) == (304, b"")


def test_head_has_the_headers_alone(server: SceneServer) -> None:
    answer, body = ask(server, "/scene.cogs", "HEAD", Range="bytes=0-9")
    assert (answer.status, body) == (200, b"")
    assert answer.headers["Content-Length"] == str(len(CONTENT))


def test_etag_changes_with_the_file(server: SceneServer, tmp_path: Path) -> None:
    before = ask(server, "/scene.cogs")[0].headers["ETag"]
    (tmp_path / "garden.cogs").write_bytes(CONTENT[:-1])
    answer, body = ask(server, "/scene.cogs")
    assert answer.headers["ETag"] != before
    assert body == CONTENT[:-1]
    (tmp_path / "garden.cogs").unlink()
    assert ask(server, "/scene.cogs")[0].status == 404


@pytest.mark.parametrize(
    "path",
    [
        "/secret.txt",
        "/garden.cogs",
        "/../secret.txt",
        "/%2e%2e/secret.txt",
        "/scene.cogs/../secret.txt",
        "//etc/passwd",
        "/..%5csecret.txt",
        "/types/",
        "http://127.0.0.1/secret.txt",
        "scene.cogs",
    ],
)
def test_other_paths_are_not_found(server: SceneServer, path: str) -> None:
    answer, body = ask(server, path)
    assert answer.status == 404
    assert b"secret" not in body


@pytest.mark.parametrize(
    "host", ["example.org", "127.0.0.1.example.org", "localhost@a", "10.0.0.1"]
)
def test_other_hosts_are_refused(server: SceneServer, host: str) -> None:
    assert ask(server, "/scene.cogs", host=f"{host}:{server.server_port}")[0].status == 403


def test_a_host_must_be_named(server: SceneServer) -> None:
    assert ask(server, "/", host="")[0].status == 400
    assert ask(server, "/", host="LocalHost")[0].status == 200


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "BREW"])
def test_other_methods_are_refused(server: SceneServer, method: str) -> None:
    answer, _ = ask(server, "/scene.cogs", method)
    assert (answer.status, answer.headers["Allow"]) == (405, "GET, HEAD")


def test_a_port_that_is_taken_is_an_error_of_output(server: SceneServer, tmp_path: Path) -> None:
    with pytest.raises(StorageError, match=str(server.server_port)):
        SceneServer(tmp_path / "garden.cogs", "again", server.server_port)


def test_connections_of_a_burst_do_not_wait(tmp_path: Path) -> None:
    (tmp_path / "garden.cogs").write_bytes(CONTENT)
    # Nothing is accepted yet. A connection beyond the backlog would wait for a second or more.
    with SceneServer(tmp_path / "garden.cogs", "garden") as server, ExitStack() as peers:
        for _ in range(100):
            address = (HOST, server.server_port)
            peers.enter_context(socket.create_connection(address, timeout=0.9))


def test_short_packets_are_sent_at_once(server: SceneServer) -> None:
    with socket.create_connection((HOST, server.server_port), timeout=60) as peer:
        peer.sendall(b"GET /scene.cogs HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert peer.recv(1)
        (accepted,) = server.connections._connections
        assert isinstance(accepted, socket.socket)
        assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_silent_peers_are_closed(server: SceneServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection_limit, "IDLE_SECONDS", 0.2)
    for sent in (b"", b"GET /scene"):
        with socket.create_connection((HOST, server.server_port), timeout=60) as peer:
            peer.sendall(sent)
            assert peer.recv(1) == b""


def test_new_connections_wait_for_room(
    server: SceneServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection_limit, "CROWDED_IDLE_SECONDS", 0.2)
    server.connections.limit = 2
    with ExitStack() as peers:
        for _ in range(8):
            peers.enter_context(socket.create_connection((HOST, server.server_port)))
        assert ask(server, "/scene.cogs")[1] == CONTENT
        assert len(server.connections) <= 2


def test_a_scene_that_changes_breaks_its_answer_off(server: SceneServer, tmp_path: Path) -> None:
    scene = tmp_path / "garden.cogs"
    scene.write_bytes(bytes(16 << 20))
    connection = HTTPConnection(HOST, server.server_port, timeout=60)
    connection.request("GET", "/scene.cogs")
    answer = connection.getresponse()
    answer.read(1)
    scene.write_bytes(b"\1" * (16 << 20))
    with pytest.raises(IncompleteRead):
        answer.read()
    connection.close()


def test_long_heads_are_refused(server: SceneServer) -> None:
    assert ask(server, "/scene.cogs", Cookie="a" * 15_000)[1] == CONTENT
    fields = {f"Field_{index}": "a" * 1000 for index in range(20)}
    assert ask(server, "/scene.cogs", **fields)[0].status == 431
    with socket.create_connection((HOST, server.server_port), timeout=60) as peer:
        peer.sendall(b"GET /" + b"a" * 17_000)
        with suppress(ConnectionResetError):
            assert peer.recv(1) == b""
