import asyncio
import os

import pytest

from cogsplat.codec.errors import StorageError
from cogsplat.tools.delivery import file_app
from cogsplat.tools.delivery.file_app import SEND_FILE, ConnectionLostError, FileApp
from cogsplat.tools.delivery.served_content import ContentChangedError
from cogsplat.tools.delivery.shaped_link import MAX_LARGE_BLOCKS, LinkQuality, ShapedLink

DATA = bytes(range(256)) * 2000


@pytest.fixture
def folder(tmp_path):
    root = tmp_path / "public"
    (root / "segments").mkdir(parents=True)
    (root / "scene.cogs").write_bytes(DATA)
    (root / "segments/0f.bin").write_bytes(b"segment")
    (root / "page.html").write_text("<p>")
    (root / "ä b.cogs").write_bytes(b"named")
    (root / ".hidden").write_text("secret")
    (tmp_path / "outside.txt").write_text("secret")
    return root


def asked(app, path, method="GET", send_file=None, **headers):
    """Return status, headers and body of an answer.

    `send_file` returns bytes that are sent past the application's messages.
    """
    sent = []

    def pass_on(descriptor, first, size):
        block = send_file(descriptor, first, size)
        sent.append({"body": block})
        return len(block)

    async def send(message):
        sent.append(message)

    async def receive():
        raise AssertionError("nothing is received")

    pairs = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    scope = {"type": "http", "method": method, "raw_path": path.encode(), "headers": pairs}
    if send_file is not None:
        scope["extensions"] = {SEND_FILE: pass_on}
    asyncio.run(app(scope, receive, send))
    start, *rest = sent
    got = {key.decode(): value.decode() for key, value in start["headers"]}
    return start["status"], got, b"".join(message["body"] for message in rest)


def app_of(root, **quality):
    return FileApp(root, ShapedLink(LinkQuality(**quality)))


def test_whole_files_and_ranges(folder):
    app = app_of(folder)
    status, headers, body = asked(app, "/scene.cogs")
    assert (status, body) == (200, DATA)
    assert headers["content-length"] == str(len(DATA))
    assert headers["content-type"] == "application/octet-stream"
    assert headers["accept-ranges"] == "bytes"
    status, headers, body = asked(app, "/scene.cogs?v=2", range="bytes=10-19")
    assert (status, body) == (206, DATA[10:20])
    assert headers["content-range"] == f"bytes 10-19/{len(DATA)}"
    status, headers, _ = asked(app, "/scene.cogs", range=f"bytes={len(DATA)}-")
    assert (status, headers["content-range"]) == (416, f"bytes */{len(DATA)}")


@pytest.mark.skipif(not hasattr(os, "pread"), reason="needs os.pread")
def test_a_connection_sends_bytes_of_files_as_far_as_it_has_room(folder):
    room = []

    def send_file(descriptor, first, size):
        room.append(30_000 if len(room) % 3 else 0)
        return os.pread(descriptor, min(size, room[-1]), first)

    assert asked(app_of(folder), "/scene.cogs", send_file=send_file)[2] == DATA
    assert len(room) > 10
    body = asked(app_of(folder), "/scene.cogs", send_file=send_file, range="bytes=7-99999")[2]
    assert body == DATA[7:100_000]
    # A slow link passes every block itself.
    room.clear()
    body = asked(app_of(folder, bits_per_second=1e9), "/scene.cogs", send_file=send_file)[2]
    assert (body, room) == (DATA, [])


@pytest.mark.skipif(not hasattr(os, "pread"), reason="needs os.pread")
def test_a_file_that_is_cut_while_a_connection_sends_it(folder):
    path = folder / "scene.cogs"

    def send_file(descriptor, first, size):
        os.truncate(path, 100_000)
        return os.pread(descriptor, size, first)

    with pytest.raises(ContentChangedError, match="was changed"):
        asked(app_of(folder), "/scene.cogs", send_file=send_file)


def test_a_head_has_no_body(folder):
    status, headers, body = asked(app_of(folder), "/scene.cogs", "HEAD", range="bytes=0-9")
    assert (status, body) == (200, b"")
    assert headers["content-length"] == str(len(DATA))


def test_names_are_decoded_and_types_set(folder):
    assert asked(app_of(folder), "/%C3%A4%20b.cogs")[2] == b"named"
    assert asked(app_of(folder), "/page.html")[1]["content-type"].startswith("text/html")


@pytest.mark.parametrize(
    "path",
    [
        "/../outside.txt",
        "/%2e%2e/outside.txt",
        "/segments/../../outside.txt",
        "/.hidden",
        "/link.txt",
        "/segments",
        "/segments/",
        "/",
        "/no",
        "/a%00b",
        "/..%5Coutside.txt",
        "/C:/outside.txt",
        "//etc/passwd",
        "/to-hidden.txt",
        "/to-hidden-folder/config",
        "/circle",
        "/circle/more",
        "/" + "a" * 256,
        "/" + "%C3%A4" * 200,
        "/" + "a/" * 3000,
        "/scene.cogs/more",
    ],
)
def test_outside_and_hidden_files_are_not_served(folder, path):
    (folder / "link.txt").symlink_to(folder.parent / "outside.txt")
    (folder / ".git").mkdir()
    (folder / ".git/config").write_text("secret")
    (folder / "to-hidden.txt").symlink_to(".hidden")
    (folder / "to-hidden-folder").symlink_to(".git")
    (folder / "circle").symlink_to("circle")
    status, _, body = asked(app_of(folder), path)
    assert status == 404
    assert b"secret" not in body


def test_validators(folder):
    app = app_of(folder)
    etag = asked(app, "/scene.cogs")[1]["etag"]
    assert etag.startswith('"')
    assert asked(app, "/scene.cogs", if_none_match=f'"x", {etag}')[0] == 304
    assert asked(app, "/scene.cogs", if_match='"x"')[0] == 412
    assert asked(app, "/scene.cogs", if_match=etag, range="bytes=0-1")[0] == 206
    assert asked(app, "/scene.cogs", if_range=etag, range="bytes=0-1")[0] == 206
    assert asked(app, "/scene.cogs", if_range='"x"', range="bytes=0-1")[0] == 200
    (folder / "scene.cogs").write_bytes(DATA[:-1])
    assert asked(app, "/scene.cogs")[1]["etag"] != etag


def test_pages_of_other_origins_may_read(folder):
    app = app_of(folder)
    for path in ("/scene.cogs", "/no"):
        headers = asked(app, path)[1]
        assert headers["access-control-allow-origin"] == "*"
        assert "Content-Range" in headers["access-control-expose-headers"]
    status, headers, _ = asked(app, "/scene.cogs", "OPTIONS")
    assert status == 204
    assert "Range" in headers["access-control-allow-headers"]
    assert asked(app, "/scene.cogs", "POST")[0] == 405


def test_objects_named_by_their_hash_are_immutable(folder):
    app = app_of(folder)
    assert "immutable" in asked(app, "/segments/0f.bin")[1]["cache-control"]
    assert asked(app, "/scene.cogs")[1]["cache-control"] == "no-cache, no-transform"


def test_one_file_and_pages_beside_it(folder):
    path = folder / "scene.cogs"
    app = FileApp(path, ShapedLink(LinkQuality()), {"index.html": b"<p>", "a.js": b"1"})
    assert asked(app, "/")[2] == b"<p>"
    assert asked(app, "/a.js")[1]["content-type"].startswith("text/javascript")
    assert asked(app, "/scene.cogs", range="bytes=1-2")[2] == DATA[1:3]
    assert asked(app, "/page.html")[0] == 404


def test_a_link_to_a_file_is_served_under_its_own_name(folder):
    link = folder.parent / "newest.cogs"
    link.symlink_to(folder / "scene.cogs")
    assert asked(app_of(link), "/newest.cogs")[2] == DATA
    assert asked(app_of(link), "/scene.cogs")[0] == 404


def test_a_websocket_is_refused_as_not_found(folder):
    sent = []

    async def send(message):
        sent.append(message)

    scope = {"type": "websocket", "raw_path": b"/scene.cogs", "headers": []}
    asyncio.run(app_of(folder)(scope, None, send))
    start, body = sent
    assert (start["type"], start["status"]) == ("websocket.http.response.start", 404)
    assert (body["type"], body["body"]) == ("websocket.http.response.body", b"404 Not Found\n")


def test_a_file_that_cannot_be_opened_is_not_a_missing_one(folder, monkeypatch):
    def fails(path):
        raise StorageError("io", f"{path}: too many open files")

    monkeypatch.setattr(file_app, "file_content", fails)
    status, headers, _ = asked(app_of(folder), "/scene.cogs")
    assert (status, headers["retry-after"]) == (503, "1")


def test_a_file_that_changes_breaks_its_answer_off(folder):
    app = app_of(folder)
    got = []

    async def send(message):
        got.append(message.get("body", b""))
        (folder / "new").write_bytes(bytes(len(DATA)))
        (folder / "new").replace(folder / "scene.cogs")

    scope = {"type": "http", "method": "GET", "raw_path": b"/scene.cogs", "headers": []}
    with pytest.raises(ContentChangedError, match="was changed"):
        asyncio.run(app(scope, None, send))
    assert DATA.startswith(b"".join(got))


def test_the_responses_of_a_crowd_have_smaller_blocks(folder):
    app = app_of(folder)
    scope = {"type": "http", "method": "GET", "raw_path": b"/scene.cogs", "headers": []}
    blocks = []

    async def send(message):
        blocks.append(len(message.get("body", b"")))
        # All responses begin before one goes on.
        await asyncio.sleep(0)

    async def crowd(responses):
        blocks.clear()
        await asyncio.gather(*(app(scope, None, send) for _ in range(responses)))
        return max(blocks[3 * responses : 4 * responses])

    assert asyncio.run(crowd(1)) == 65536
    assert asyncio.run(crowd(MAX_LARGE_BLOCKS)) == 65536
    assert asyncio.run(crowd(MAX_LARGE_BLOCKS + 1)) == 32768

    # Responses that broke off count no more.
    async def fail(message):
        if message.get("body"):
            raise ConnectionResetError

    for _ in range(MAX_LARGE_BLOCKS):
        with pytest.raises(ConnectionResetError):
            asyncio.run(app(scope, None, fail))
    assert asyncio.run(crowd(1)) == 65536


def test_a_bad_link_fails_and_breaks(folder):
    status, headers, _ = asked(app_of(folder, fail_rate=1.0), "/scene.cogs")
    assert (status, headers["retry-after"]) == (503, "0")
    with pytest.raises(ConnectionLostError):
        asked(app_of(folder, loss=1.0), "/scene.cogs")
    assert asked(app_of(folder, bits_per_second=1e9), "/scene.cogs")[2] == DATA


def test_the_lifespan_protocol_is_acknowledged(folder):
    kinds = ["lifespan.startup", "lifespan.shutdown"]
    sent = []

    async def receive():
        return {"type": kinds.pop(0)}

    async def send(message):
        sent.append(message["type"])

    asyncio.run(app_of(folder)({"type": "lifespan"}, receive, send))
    assert sent == ["lifespan.startup.complete", "lifespan.shutdown.complete"]
