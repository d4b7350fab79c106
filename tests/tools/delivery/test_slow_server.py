"""The slow server sends files and ranges in small blocks, and logs each block."""

from collections.abc import Iterator
from http import HTTPStatus
from http.client import HTTPConnection, IncompleteRead

import pytest

from cogsplat.tools.delivery import slow_server
from cogsplat.tools.delivery.slow_server import Link, Reply, SlowServer, running
from cogsplat.tools.delivery.threaded_server import HOST

CONTENT = bytes(range(256)) * 40
FILES = {"index.html": b"<p>page</p>", "parts/scene.spz": CONTENT, "viewer.js": b"0"}


def ask(server: SlowServer, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    connection = HTTPConnection(HOST, server.server_port, timeout=30)
    try:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()
    finally:
        connection.close()


def test_files_and_ranges() -> None:
    with running(SlowServer(FILES)) as server:
        status, headers, body = ask(server, "/")
        assert (status, body) == (200, b"<p>page</p>")
        assert headers["Content-Type"] == "text/html; charset=utf-8"
        assert ask(server, "/viewer.js")[1]["Content-Type"] == "text/javascript; charset=utf-8"
        status, headers, body = ask(server, "/parts/scene.spz?a=1", Range="bytes=10-19")
        assert (status, body) == (206, CONTENT[10:20])
        assert headers["Content-Range"] == f"bytes 10-19/{len(CONTENT)}"
        assert headers["Content-Type"] == "application/octet-stream"
        assert headers["Cache-Control"] == "no-store"
        status, headers, _ = ask(server, "/parts/scene.spz", Range="bytes=99999-")
        assert (status, headers["Content-Range"]) == (416, f"bytes */{len(CONTENT)}")
        assert ask(server, "/parts/../secret")[0] == 404
        assert server.traffic.size_bytes("index.html") == len(FILES["index.html"])


def test_browsers_may_keep_what_the_server_says() -> None:
    with running(SlowServer(FILES, cached=["viewer.js"])) as server:
        assert ask(server, "/viewer.js")[1]["Cache-Control"] == "max-age=3600"
        assert ask(server, "/")[1]["Cache-Control"] == "no-store"


def test_blocks_wait_for_the_link(monkeypatch: pytest.MonkeyPatch) -> None:
    # A clock that only sleeping moves: no time is measured.
    now = 100.0
    slept: list[float] = []

    def sleep(seconds: float) -> None:
        nonlocal now
        slept.append(seconds)
        now += seconds

    monkeypatch.setattr(slow_server.time, "sleep", sleep)
    monkeypatch.setattr(slow_server.time, "monotonic", lambda: now)
    link = Link(5e6)
    assert link.block_bytes == 3750
    link.wait(62_500)
    link.wait(62_500)
    assert slept == pytest.approx([0.1, 0.1])
    now += 5.0
    link.wait(6250)
    assert slept[-1] == pytest.approx(0.01)
    Link().wait(10**9)
    assert len(slept) == 3


def test_a_thread_that_wakes_late_does_not_slow_the_link_down(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 100.0

    def sleep(seconds: float) -> None:
        nonlocal now
        now += seconds + 0.05

    monkeypatch.setattr(slow_server.time, "sleep", sleep)
    monkeypatch.setattr(slow_server.time, "monotonic", lambda: now)
    link = Link(5e6)
    passed = None
    for _ in range(20):
        passed = link.wait(62_500, passed)
    assert passed == pytest.approx(102.0)
    # The next answer begins when it is asked for.
    now = 110.0
    assert link.wait(62_500) == pytest.approx(110.1)


def test_traffic_is_counted_by_file_and_time() -> None:
    with running(SlowServer(FILES, Link(20e6, latency_seconds=0.001))) as server:
        assert ask(server, "/parts/scene.spz")[2] == CONTENT
        ask(server, "/")
    rows = server.traffic.rows
    assert len([row for row in rows if row[1] == "parts/scene.spz"]) == 1
    assert rows == sorted(rows, key=lambda row: row[0])
    assert server.traffic.size_bytes("parts/scene.spz") == len(CONTENT)
    assert server.traffic.size_bytes("parts/scene.spz", until=rows[0][0] - 1) == 0


def test_a_body_that_breaks_off_ends_the_connection() -> None:
    class Broken(SlowServer):
        def reply(self, name: str, wanted: str | None) -> Reply:
            def body() -> Iterator[bytes]:
                yield CONTENT[:100]
                raise ConnectionAbortedError

            return Reply(HTTPStatus.OK, {"Content-Length": str(len(CONTENT))}, body())

    with running(Broken(FILES)) as server, pytest.raises(IncompleteRead) as caught:
        ask(server, "/parts/scene.spz")
    assert caught.value.partial == CONTENT[:100]
