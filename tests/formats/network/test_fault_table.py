"""Every known fault of a network, what a reader makes of it, and the table in the docs."""

import re
import threading
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from cogs_samples import assert_same, file_of
from fault_server import (
    Exchange,
    Fault,
    FaultServer,
    broken_after,
    no_ranges,
    reset,
    right,
    serving,
    slow,
    stalled_after,
    stating,
    status,
)

import cogsplat
from cogsplat.codec.errors import Cancelled, CogsplatError, CogsplatWarning
from cogsplat.formats.cogs.opening import source_of_place
from cogsplat.formats.network.options import NetworkOptions

DOCS = Path(__file__).resolve().parents[3] / "docs/network.md"

QUICK = NetworkOptions(pause_seconds=0.01, idle_seconds=0.25, connect_seconds=5)


@pytest.fixture(scope="module")
def data() -> bytes:
    made = file_of("vq", 6000, 3, 500)
    assert len(made) > 3 * 65536
    return made


@pytest.fixture(scope="module")
def other() -> bytes:
    """A later version of the file."""
    return file_of("vq", 5000, 3, 500)


def decoded(server: FaultServer, network: NetworkOptions = QUICK) -> cogsplat.Splats:
    return cogsplat.decode(server.url(), network=network)


def outcome_of(server: FaultServer, expected: bytes) -> str:
    """Return what comes of decoding: ``works``, or the error's reason code."""
    try:
        found = decoded(server)
    except CogsplatError as error:
        # An explained error: it names the file and says what was found.
        explained = error.message.startswith(server.url()) and len(error.message) > 60
        return f"`{error.code}`" if explained else error.message
    assert_same(found, cogsplat.decode(expected))
    return "works"


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

    `faults` happen to the first requests, `always` to all others.
    """

    number: str
    what: str
    outcome: str
    faults: Callable[[bytes], list[Fault]] = lambda later: []
    always: Fault = right
    ends_as_other: bool = False


CASES = [
    Case("F01", "the server ignores ranges and sends the whole file", "works", always=no_ranges),
    Case(
        "F02",
        "an answer of another range",
        "`answer-range`",
        always=stating(Content_Range="bytes 7-65542/999999"),
    ),
    Case("F03", "an answer that ends early, once", "works", lambda _: [broken_after(40_000)]),
    Case("F03", "answers that end early, always", "works", always=broken_after(90_000)),
    Case("F03", "answers that end without a byte, always", "`connection-broken`", always=reset),
    Case("F03", "answers that state fewer bytes than were asked for", "works", always=shorter),
    Case("F04", "an answer longer than it states", "works", always=longer),
    Case(
        "F04",
        "an answer that states more than was asked for",
        "`answer-range`",
        always=stating(Content_Range="bytes 0-999998/999999"),
    ),
    Case("F05", "an answer of several parts", "`answer-range`", always=MULTIPART),
    Case(
        "F06",
        "the file is replaced while it is read: another ETag",
        "works",
        lambda later: [right, replaced_by(later, '"two"')],
        ends_as_other=True,
    ),
    Case("F06", "another file with every request", "`source-changed`", always=changing),
    Case(
        "F07",
        "the file is replaced, its ETag is not",
        "works",
        lambda later: [right, replaced_by(later, '"one"')],
        ends_as_other=True,
    ),
    Case("F07", "segments are damaged, always", "`segment-crc`", always=damaged),
    Case("F08", "another ETag with every answer, the same bytes", "works", always=another_etag),
    Case("F08", "weak ETags", "works", always=stating(ETag='W/"weak"')),
    Case(
        "F09",
        "status 416: the file became shorter",
        "works",
        lambda _: [right, status(416, Content_Range="bytes */9")],
    ),
    Case("F10", "status 412", "works", lambda _: [right, status(412)]),
    Case("F11", "status 404 in the middle", "`not-found`", lambda _: [right], status(404)),
    Case("F12", "access expired (403), nobody signs anew", "`permission`", always=status(403)),
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
    ),
    Case(
        "F14",
        "status 500, 502 and 504, then an answer",
        "works",
        lambda _: [status(500), status(502), status(504)],
    ),
    Case("F14", "status 500, always", "`http-status`", always=status(500)),
    Case("F16", "a stall in the middle of an answer", "works", lambda _: [stalled_after(30_000)]),
    Case("F16", "no byte comes, ever", "`network-timeout`", always=stalled_after(0)),
    Case("F17", "a slow link", "works", always=slow(4e6, 4096)),
    Case("F18", "a redirect", "works", always=redirected),
    Case("F18", "redirects in a circle", "`redirect-loop`", always=circular),
    Case("F19", "a proxy that compresses", "`answer-encoding`", always=GZIP),
    Case("F20", "a page with status 200 in place of the file", "`not-cogs`", always=html),
    Case("F23", "a reset in the middle, once", "works", lambda _: [right, broken_after(1000)]),
    Case("F24", "a cache that gives damaged bytes", "works", always=stale),
    Case("F25", "offline for three attempts", "works", lambda _: [right, reset, reset, reset]),
]


def name_of(case: Case) -> str:
    return f"{case.number}-{case.what}"


@pytest.mark.parametrize("case", CASES, ids=name_of)
def test_a_fault_ends_as_the_table_says(case: Case, data: bytes, other: bytes) -> None:
    expected = other if case.ends_as_other else data
    with (
        serving(FaultServer(data, case.faults(other), case.always)) as server,
        warnings.catch_warnings(record=True) as told,
    ):
        warnings.simplefilter("always", CogsplatWarning)
        assert outcome_of(server, expected) == case.outcome
    if case.always is no_ranges:
        assert "whole file" in str(told[0].message)
    else:
        assert [str(warning.message) for warning in told if case.always is not html] == []
    # None of them asks without end.
    assert len(server.asked) < 40


def test_the_table_of_the_docs_is_that_of_the_tests() -> None:
    rows = re.findall(r"^\| (F\d\d) \| (.+?) \| (.+?) \|", DOCS.read_text(encoding="utf-8"), re.M)
    tested = [(case.number, case.what, case.outcome) for case in CASES]
    assert [row for row in rows if row in tested] == tested


# What the table says of faults that are not of a server's answers.


def test_a_host_that_is_not_there_is_unreachable() -> None:
    """F15."""
    with serving(FaultServer(b"")) as server:
        url = server.url()
    network = NetworkOptions(retries=1, pause_seconds=0.01)
    for address in (url, "http://no-such-host.invalid/scene.cogs"):
        with pytest.raises(cogsplat.StorageError, match="cannot be reached") as caught:
            cogsplat.open(address, network=network)
        assert caught.value.code == "host-unreachable"


def test_expired_access_is_signed_anew(data: bytes) -> None:
    """F12."""

    async def guarded(exchange: Exchange) -> None:
        await (right if "key=2" in exchange.asked.path else status(403))(exchange)

    with serving(FaultServer(data, always=guarded)) as server:
        signed = []

        def sign() -> str:
            signed.append(1)
            return server.url("scene.cogs?key=2")

        network = NetworkOptions(sign=sign, pause_seconds=0.01)
        found = cogsplat.decode(server.url("scene.cogs?key=1"), network=network)
    assert_same(found, cogsplat.decode(data))
    assert signed == [1]


def test_a_slow_link_shows_chunks_before_the_file_is_there_and_can_be_left(data: bytes) -> None:
    """F17 and F22."""
    with (
        serving(FaultServer(data, always=slow(400_000, 2048))) as server,
        cogsplat.open(server.url(), network=QUICK) as file,
    ):
        with file.stream() as updates:
            first = next(updates)
            assert first.chunk == 0
            assert file.traffic is not None
            assert file.traffic.received_bytes < len(data)
        with file.stream() as updates:
            next(updates)
            timer = threading.Timer(0.05, updates.cancel)
            timer.start()
            with pytest.raises(Cancelled):
                list(updates)
            timer.join()


def test_closing_ends_the_connections(data: bytes) -> None:
    """F22."""
    with serving(FaultServer(data, [right], always=slow(20_000))) as server:
        file = cogsplat.open(server.url())
        updates = file.stream()
        next(updates)
        source = source_of_place(server.url())
        file.close()
        source.close()
        for _ in range(200):
            if not server.open_connections:
                break
            threading.Event().wait(0.01)
        assert server.open_connections == 0
    assert not [thread for thread in threading.enumerate() if "fetches" in thread.name]


def test_headers_are_not_sent_where_a_redirect_leads_elsewhere(data: bytes) -> None:
    """F18."""
    with serving(FaultServer(data)) as target:
        away = status(302, Location=target.url())
        with serving(FaultServer(b"", always=away)) as server:
            network = NetworkOptions(headers={"Authorization": "Bearer secret"})
            with cogsplat.open(server.url(), network=network) as file:
                assert len(file.decode()) == 6000
        assert server.asked[0].headers["authorization"] == "Bearer secret"
        # Where it led is kept: one redirect for all requests.
        assert len(server.asked) == 1
        assert all("authorization" not in asked.headers for asked in target.asked)
