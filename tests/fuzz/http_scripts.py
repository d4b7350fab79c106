"""Web servers by script: what is wrong with each response to a reader, as JSON.

A script has ``via`` (``file``, ``folder`` or ``s3``), ``how`` it is read (``decode``, ``stream``,
``chunks``), ``idle`` seconds of its timeout, ``answers`` to the first requests, and ``always`` for
all others. An empty answer is right. Its keys change it: ``status``; ``headers`` by name, null for
none, with ``$first``, ``$last``, ``$end`` and ``$size`` of the request; ``body`` (``range``,
``whole``, ``other``, ``empty``) or ``text``; ``times`` that the body is sent, below 0 without end;
``flip`` of a bit; ``cut`` after bytes; ``chunked``; ``before``, a count of 100 Continue; ``raw`` in
place of the head; ``drip``, bytes per write; ``after`` (``keep``, ``close``, ``reset``, ``stall``).
"""

import asyncio
import json
import random
from collections.abc import Awaitable, Callable
from functools import cache
from typing import Any

from cogs_samples import file_of
from fault_server import Exchange, FaultServer
from seeds import VECTORS

import cogsplat
from cogsplat.codec.splats import Splats
from cogsplat.tools.lab.conformance.reference_folders import folder_of_file

# Of a body without end, bytes at a time; the reader has to leave.
_BLOCK_BYTES = 1 << 16
_MAX_BYTES = 1 << 20
_MAX_HEADERS = 200

Answer = dict[str, Any]


@cache
def files() -> dict[str, bytes]:
    """Return COGS files by transport, and under ``other`` a file that replaces the first midway."""
    small = (VECTORS / "valid" / "vq.cogs").read_bytes()
    # Longer than the first request, so that the reader requests further ranges.
    large = file_of("vq", 2500, 3, 500)
    other = (VECTORS / "valid" / "chunks.cogs").read_bytes()
    return {"file": large, "folder": small, "s3": small, "other": other}


@cache
def decoded_file(name: str) -> Splats:
    """Return the splats of a file of `files`."""
    return cogsplat.decode(files()[name])


@cache
def objects() -> dict[str, bytes]:
    """Return manifest and objects of the folder."""
    return folder_of_file(files()["folder"])


def parsed(data: bytes) -> dict[str, Any]:
    """Return the script that bytes hold; bytes that hold none are what the server sends."""
    try:
        found = json.loads(data)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        return {"always": {"raw": data.decode("latin-1")}}
    return found


def via_of(script: dict[str, Any]) -> str:
    """Return the transport by which a script reads its scene: file, folder or s3."""
    found = script.get("via")
    return found if found in ("folder", "s3") else "file"


def how_of(script: dict[str, Any]) -> str:
    """Return the function that reads the scene of a script: decode, stream or chunks."""
    found = script.get("how")
    return found if found in ("stream", "chunks") else "decode"


def idle_seconds_of(script: dict[str, Any]) -> float:
    """Return the reader's timeout: short, unless the script must not meet it on a busy machine."""
    found = script.get("idle")
    return 1.0 if found == 1 else 0.1


def server_of(script: dict[str, Any]) -> FaultServer:
    """Return the server of a script."""
    via = via_of(script)
    listed = script.get("answers")
    answers = [_fault(via, answer) for answer in listed] if isinstance(listed, list) else []
    return FaultServer(files()[via], answers, _fault(via, script.get("always")))


def _fault(via: str, given: object) -> Callable[[Exchange], Awaitable[None]]:
    answer: Answer = given if isinstance(given, dict) else {}
    if via == "s3" and _number(answer.get("status"), 0, 999, 200) >= 400:
        # The object store library reads the body of an error whole; its own timeout is the only
        # bound. SECURITY says so.
        answer = {**answer, "times": max(0, _number(answer.get("times"), -1, 1000, 1))}

    async def fault(exchange: Exchange) -> None:
        exchange.server.data = _data(via, exchange)
        await _answer(exchange, answer)

    return fault


def _data(via: str, exchange: Exchange) -> bytes:
    """Return the bytes of the file or object that a request names."""
    if via != "folder":
        return files()[via]
    name = exchange.asked.path.partition("?")[0].removeprefix("/scene/")
    return objects().get(name, b"")


def _number(value: object, least: int, most: int, default: int) -> int:
    """Return a number of a script, cut to a range."""
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value:
        return default
    return int(max(least, min(most, value)))


def _body(exchange: Exchange, answer: Answer) -> bytes:
    """Return the body of an answer, once."""
    if isinstance(answer.get("text"), str):
        body = answer["text"].encode("utf-8", "replace")
    else:
        kinds = {
            "whole": exchange.data,
            "other": files()["other"],
            "empty": b"",
        }
        body = kinds.get(str(answer.get("body")), exchange.part)
    if "flip" in answer and body:
        at = _number(answer["flip"], 0, 1 << 60, 0)
        flipped = bytearray(body)
        flipped[at // 8 % len(body)] ^= 1 << at % 8
        body = bytes(flipped)
    return body


def _head(exchange: Exchange, answer: Answer, length: int | None) -> bytes:
    """Return status line and headers of an answer."""
    asked, size = exchange.asked, len(exchange.data)
    missing = asked.first >= size
    status = answer.get("status", 404 if not size else 416 if missing else 206)
    headers = exchange.stated(Content_Length=None if length is None else str(length))
    if missing:
        headers["Content-Range"] = f"bytes */{size}"
    if status == 200:
        headers.pop("Content-Range")
    if answer.get("chunked") is True:
        headers.pop("Content-Length", None)
        headers["Transfer-Encoding"] = "chunked"
    numbers = {
        "$first": asked.first, "$last": min(asked.end, size) - 1,
        "$end": min(asked.end, size), "$size": size,
    }  # fmt: skip
    given = answer.get("headers")
    for name, value in list(given.items())[:_MAX_HEADERS] if isinstance(given, dict) else ():
        headers.pop(name, None)
        if value is not None:
            text = str(value)
            for word, number in numbers.items():
                text = text.replace(word, str(number))
            headers[name] = text
    lines = [f"HTTP/1.1 {status} Said", *(f"{name}: {text}" for name, text in headers.items())]
    return "\r\n".join([*lines, "", ""]).encode("latin-1", "replace")


async def _send(exchange: Exchange, part: bytes, *, chunked: bool = False) -> None:
    """Send bytes, perhaps as a chunk."""
    if chunked and part:
        part = b"%x\r\n%s\r\n" % (len(part), part)
    exchange.writer.write(part)
    await exchange.writer.drain()
    exchange.server.sent += len(part)


async def _answer(exchange: Exchange, answer: Answer) -> None:
    """Answer a request as a script says."""
    body, chunked = _body(exchange, answer), answer.get("chunked") is True
    times = _number(answer.get("times"), -1, 1000, 1)
    cut = _number(answer.get("cut"), 0, _MAX_BYTES, _MAX_BYTES)
    drip = _number(answer.get("drip"), 1, _BLOCK_BYTES, _BLOCK_BYTES)
    after = str(answer.get("after"))
    if times > 1:
        body = (body * times)[:_MAX_BYTES]
    for _ in range(_number(answer.get("before"), 0, 1000, 0)):
        await _send(exchange, b"HTTP/1.1 100 Continue\r\n\r\n")
    if isinstance(answer.get("raw"), str):
        await _send(exchange, answer["raw"].encode("latin-1", "replace"))
        body, times, after = b"", 1, "close" if after == "None" else after
    else:
        await _send(exchange, _head(exchange, answer, len(body) if times >= 0 else None))
    while times < 0:
        await _send(exchange, (body or b"A") * max(1, _BLOCK_BYTES // max(1, len(body))))
    for at in range(0, min(cut, len(body)), drip):
        await _send(exchange, body[at : min(cut, at + drip)], chunked=chunked)
        if drip < 1000:
            await asyncio.sleep(0.01)
    if chunked and cut >= len(body):
        await _send(exchange, b"0\r\n\r\n")
    if after == "stall":
        await asyncio.sleep(60)
    # What was written arrives before the connection ends.
    if after in ("close", "reset"):
        await asyncio.sleep(0.002)
        exchange.keep = False
    if after == "reset":
        exchange.break_off()


_STATUSES = (200, 200, 206, 206, 100, 101, 103, 199, 204, 205, 226, 299, 300, 301, 302, 303, 304,
             307, 308, 400, 401, 403, 404, 408, 410, 412, 416, 425, 429, 451, 500, 502, 503, 504,
             599, 600, 999, 0, -1, "2OO", "206 206")  # fmt: skip

_LOCATIONS = ("/scene.cogs", "/elsewhere", "elsewhere?a=b", "", "http://127.0.0.1:1/", "//",
              "http://h:99999/", "http://h:-1/", "http://xn--a/", "http://a..b/", "http://[::1",
              "ftp://h/", "data:,a", "file:///etc/passwd", "http:///", "http://\x00/", "#", "?",
              "https://127.0.0.1:1/", "\xff\xfe", "a" * 5000, "s3://bucket/a")  # fmt: skip

_DATES = ("Sun, 22 Nov 2026 12:00:30 GMT", "Sun, 22 Nov 2026 12:00:30 +9999",
          "Fri, 31 Dec 9999 23:59:59 -2359", "Mon, 01 Jan 0001 00:00:00 +2359", "", "0", "-1",
          "1", "9" * 30, "nan", "inf", "1e9", "Sun, 99 Foo 99999999999 1:1:1 GMT")  # fmt: skip

_HEADERS: dict[str, tuple[object, ...]] = {
    "Content-Range": (
        None, "", "bytes $first-$last/$size", "bytes $first-$last/*", "bytes 0-$last/$size",
        "bytes $first-$first/$size", "bytes $first-$end/$size", "bytes */$size", "bytes */*",
        "bytes */0", "bytes $last-$first/$size", "bytes -1-5/9", "bytes 0-0/1",
        "bytes $first-$last/1000000000000000000", "bytes $first-$last/1", "bits 0-1/2",
        "bytes $first-$last/$size, bytes 0-1/2", "bytes \u0663-$last/$size",
        "bytes 99999999999999999999-99999999999999999999/99999999999999999999",
    ),
    "Content-Length": (None, "0", "1", "-1", "5, 5", "5, 6", "$size", "abc", "1e3", "9" * 30, ""),
    "Transfer-Encoding": ("chunked", "identity", "gzip", "chunked, chunked", "bogus", ""),
    "Content-Encoding": ("gzip", "br", "identity", "identity, gzip", "deflate", ""),
    "Content-Type": ("multipart/byteranges; boundary=x", "text/html", "", None),
    "ETag": (None, '"two"', 'W/"one"', '"', "one", "\xe9", '"' + "x" * 5000 + '"', ""),
    "Location": _LOCATIONS,
    "Retry-After": _DATES,
    "Date": _DATES,
    "Last-Modified": _DATES,
    "Connection": ("close", "upgrade", "keep-alive, close", ""),
    "Upgrade": ("h2c", "websocket"),
    "Set-Cookie": ("a=b", "a=" + "x" * 30_000, "a=b; Max-Age=-1; Domain=.", "\xff=\xff; =;"),
    "Trailer": ("ETag",),
    "X-Long": ("y" * 50_000, "y" * 200_000),
    "Bad Name": ("x",),
}  # fmt: skip

_RAW = ("", "\r\n\r\n", "garbage\r\n\r\n", "HTTP/1.1 200", "HTTP/1.1 200 OK\r\n",
        "HTTP/2 200\r\n\r\n",
        "HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nffffffffffffffff\r\n",
        "HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n-1\r\nabc", "\0" * 1000,
        "HTTP/1.1 206 A\r\nContent-Range: bytes 0-9/10\r\nContent-Range: bytes 0-9/99\r\n\r\n",
        "HTTP/1.0 200 OK\r\n\r\n", "\x16\x03\x01\x02\x00", "ICY 200 OK\r\n\r\n")  # fmt: skip


def made_script(seed: int) -> bytes:
    """Return a script, the same for the same seed: a few answers with one to three faults each."""
    rng = random.Random(seed)
    script: dict[str, Any] = {"via": rng.choice(("file", "file", "file", "folder", "folder", "s3"))}
    script["how"] = rng.choice(("decode", "stream", "chunks"))
    script["answers"] = [_made_answer(rng) for _ in range(rng.randint(0, 4))]
    if rng.random() < 0.5:
        script["always"] = _made_answer(rng)
    return json.dumps(script).encode()


def _made_answer(rng: random.Random) -> Answer:
    answer: Answer = {}
    for _ in range(rng.choice((0, 1, 1, 1, 2, 3))):
        match rng.choice(("status", *["headers"] * 5, "body", "text", "times", "flip", *["cut"] * 2,
                          "chunked", "before", "raw", "drip", "after")):  # fmt: skip
            case "status":
                answer["status"] = rng.choice(_STATUSES)
                if answer["status"] in (301, 302, 303, 307, 308) and rng.random() < 0.8:
                    answer.setdefault("headers", {})["Location"] = rng.choice(_LOCATIONS)
                if answer["status"] == 200 and rng.random() < 0.8:
                    answer["body"] = "whole"
            case "headers":
                name = rng.choice(sorted(_HEADERS))
                answer.setdefault("headers", {})[name] = rng.choice(_HEADERS[name])
            case "body":
                answer["body"] = rng.choice(("whole", "other", "empty"))
            case "text":
                answer["text"] = rng.choice(("<!DOCTYPE html>", "\x89COGS", "A" * 64, "{}", "é"))
            case "times":
                answer["times"] = rng.choice((-1, 0, 2, 100))
                if rng.random() < 0.5:
                    answer |= {"status": 200, "body": "whole"}
                    if rng.random() < 0.5:
                        answer |= {"times": 1, "drip": 5000}
            case "flip":
                answer["flip"] = rng.randrange(8 << 18)
            case "cut":
                answer["cut"] = rng.choice((0, 1, 63, 64, 65, 1000, rng.randrange(1 << 17)))
                answer["after"] = rng.choice(("close", "close", "reset", "stall", "keep"))
            case "chunked":
                answer["chunked"] = True
            case "before":
                answer["before"] = rng.choice((1, 10, 1000))
            case "raw":
                answer["raw"] = rng.choice(_RAW)
            case "drip":
                answer["drip"] = rng.choice((1, 7, 100, 5000))
            case _:
                answer["after"] = rng.choice(("close", "reset", "stall"))
    return answer
