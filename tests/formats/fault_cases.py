"""Every known fault of a network as a fault server does it, and what comes of it in each client."""

from collections.abc import Callable
from dataclasses import dataclass

from fault_server import (
    Exchange,
    Fault,
    broken_after,
    no_ranges,
    reset,
    right,
    slow,
    stalled_after,
    stating,
    status,
)


async def stale(exchange: Exchange) -> None:
    """Answer as a cache that holds damaged bytes, unless it is gone around."""
    fresh = exchange.asked.headers.get("cache-control") == "no-cache"
    at = min(len(exchange.part) - 1, 1000)
    damaged = exchange.part[:at] + bytes([exchange.part[at] ^ 1]) + exchange.part[at + 1 :]
    await exchange.send(206, exchange.stated(), exchange.part if fresh else damaged)


async def damaged(exchange: Exchange) -> None:
    """Answer with a wrong byte wherever segments are, whatever is asked for."""
    part = bytearray(exchange.part)
    for at in range(max(0, 65536 - exchange.asked.first), len(part), 100):
        part[at] ^= 1
    await exchange.send(206, exchange.stated(), bytes(part))


async def longer(exchange: Exchange) -> None:
    """Send more bytes than the headers state, to the end of the connection."""
    headers = exchange.stated(Content_Length=None, Connection="close")
    await exchange.send(206, headers, exchange.part + b"more")
    exchange.keep = False


async def shorter(exchange: Exchange) -> None:
    """Send, and state, fewer bytes than were asked for."""
    asked, size = exchange.asked, len(exchange.data)
    end = min(asked.end, size, asked.first + 50_000)
    span = f"bytes {asked.first}-{end - 1}/{size}"
    part = exchange.data[asked.first : end]
    await exchange.send(
        206, exchange.stated(Content_Range=span, Content_Length=str(len(part))), part
    )


def replaced_by(later: bytes, etag: str | None) -> Fault:
    """Put another file in the place of the first, and answer."""

    async def fault(exchange: Exchange) -> None:
        exchange.server.data, exchange.server.etag = later, etag
        await right(exchange)

    return fault


async def another_etag(exchange: Exchange) -> None:
    """State a strong ETag that no answer before had."""
    exchange.server.etag = f'"{len(exchange.server.asked)}"'
    await right(exchange)


async def html(exchange: Exchange) -> None:
    """Answer as the page of a captive portal."""
    page = b"<!DOCTYPE html><title>Please log in</title>"
    await exchange.send(200, {"Content-Type": "text/html", "Content-Length": str(len(page))}, page)


async def redirected(exchange: Exchange) -> None:
    """Lead to another path, from which the file is answered."""
    if exchange.asked.path == "/scene.cogs":
        await status(307, Location="/elsewhere.cogs")(exchange)
    else:
        await right(exchange)


async def circular(exchange: Exchange) -> None:
    """Lead back to the same path."""
    await status(301, Location=exchange.asked.path)(exchange)


async def changing(exchange: Exchange) -> None:
    """Be another file with every request."""
    server = exchange.server
    server.data = server.data[:-1] if len(server.asked) % 2 else server.data + b"\0"
    await right(exchange)


GZIP = stating(Content_Encoding="gzip")
MULTIPART = stating(Content_Type="multipart/byteranges; boundary=x")


@dataclass(frozen=True)
class Case:
    """One fault: its number in the study, what it is, what happens to requests, what comes of it.

    `faults` happen to the first requests, `always` to all others. `outcome` is that of Python;
    `node` and `chromium` say where the loader of tools/web ends otherwise, an error without a
    reason code by words of its message in quotes.
    """

    number: str
    what: str
    outcome: str
    faults: Callable[[bytes], list[Fault]] = lambda later: []
    always: Fault = right
    ends_as_other: bool = False
    node: str | None = None
    chromium: str | None = None

    @property
    def outcome_in_node(self) -> str:
        return self.node or self.outcome

    @property
    def outcome_in_chromium(self) -> str:
        return self.chromium or self.outcome_in_node


CASES = [
    Case("F01", "the server ignores ranges and sends the whole file", "works", always=no_ranges),
    Case(
        "F02",
        "an answer of another range",
        "`answer-range`",
        always=stating(Content_Range="bytes 7-65542/999999"),
        node='"an answer of bytes 7-65542/999999"',
    ),
    Case("F03", "an answer that ends early, once", "works", lambda _: [broken_after(40_000)]),
    Case("F03", "answers that end early, always", "works", always=broken_after(90_000)),
    Case(
        "F03",
        "answers that end without a byte, always",
        "`connection-broken`",
        always=reset,
        node='"cannot be reached"',
    ),
    Case("F03", "answers that state fewer bytes than were asked for", "works", always=shorter),
    Case("F04", "an answer longer than it states", "works", always=longer),
    Case(
        "F04",
        "an answer that states more than was asked for",
        "`answer-range`",
        always=stating(Content_Range="bytes 0-999998/999999"),
        node='"an answer of bytes 0-999998/999999"',
    ),
    Case(
        "F05",
        "an answer of several parts",
        "`answer-range`",
        always=MULTIPART,
        node='"an answer of several parts"',
    ),
    Case(
        "F06",
        "the file is replaced while it is read: another ETag",
        "works",
        lambda later: [right, replaced_by(later, '"two"')],
        ends_as_other=True,
    ),
    Case(
        "F06",
        "another file with every request",
        "`source-changed`",
        always=changing,
        node="`file-truncated`",
    ),
    Case(
        "F07",
        "the file is replaced, its ETag is not",
        "works",
        lambda later: [right, replaced_by(later, '"one"')],
        ends_as_other=True,
    ),
    Case("F07", "segments are damaged, always", "`segment-crc`", always=damaged),
    Case(
        "F08",
        "another ETag with every answer, the same bytes",
        "works",
        always=another_etag,
        node="`source-changed`",
    ),
    Case("F08", "weak ETags", "works", always=stating(ETag='W/"weak"')),
    Case(
        "F09",
        "status 416: the file became shorter",
        "works",
        lambda _: [right, status(416, Content_Range="bytes */9")],
    ),
    Case("F10", "status 412", "works", lambda _: [right, status(412)]),
    Case(
        "F11",
        "status 404 in the middle",
        "`not-found`",
        lambda _: [right],
        status(404),
        node='"status 404"',
    ),
    Case(
        "F12",
        "access expired (403), nobody signs anew",
        "`permission`",
        always=status(403),
        node='"status 403"',
    ),
    Case(
        "F13",
        "status 429, then 503, with Retry-After",
        "works",
        lambda _: [status(429, Retry_After="0"), status(503, Retry_After="0")],
    ),
    Case(
        "F13",
        "status 503 with a Retry-After of an hour",
        "`http-status`",
        always=status(503, Retry_After="3600"),
        node='"status 503"',
    ),
    Case(
        "F14",
        "status 500, 502 and 504, then an answer",
        "works",
        lambda _: [status(500), status(502), status(504)],
    ),
    Case("F14", "status 500, always", "`http-status`", always=status(500), node='"status 500"'),
    Case("F16", "a stall in the middle of an answer", "works", lambda _: [stalled_after(30_000)]),
    Case(
        "F16",
        "no byte comes, ever",
        "`network-timeout`",
        always=stalled_after(0),
        node='"no byte for"',
    ),
    Case("F17", "a slow link", "works", always=slow(4e6, 4096)),
    Case("F18", "a redirect", "works", always=redirected),
    Case(
        "F18",
        "redirects in a circle",
        "`redirect-loop`",
        always=circular,
        node='"cannot be reached"',
    ),
    Case(
        "F19",
        "a proxy that compresses",
        "`answer-encoding`",
        always=GZIP,
        node='"Content-Encoding gzip"',
        chromium='"cannot be reached"',
    ),
    Case("F20", "a page with status 200 in place of the file", "`not-cogs`", always=html),
    Case("F23", "a reset in the middle, once", "works", lambda _: [right, broken_after(1000)]),
    Case("F24", "a cache that gives damaged bytes", "works", always=stale),
    Case("F25", "offline for three attempts", "works", lambda _: [right, reset, reset, reset]),
]


def name_of(case: Case) -> str:
    return f"{case.number}-{case.what}"
