"""Probe requests, and the recorded responses."""

import asyncio

import pytest
from fault_server import Exchange, Fault, FaultServer, no_ranges, reset, serving, stating, status

from cogsplat.codec.errors import StorageError
from cogsplat.tools.hosting import probe
from cogsplat.tools.hosting.probe import FIRST_BYTES, Prober, Response, content_range, total_of

DATA = bytes(range(256)) * 400


def test_probe_requests_are_those_of_readers_and_browsers() -> None:
    with serving(FaultServer(DATA)) as server, Prober() as prober:
        found = prober.probe(server.url())
    assert found.first.body == DATA[:FIRST_BYTES]
    assert total_of(found.first) == len(DATA)
    assert found.last is not None
    assert found.last.body == DATA[-16:]
    assert found.beyond is not None
    assert found.beyond.status == 416
    assert found.first.etag == '"one"'
    spans = [asked.headers.get("range") for asked in server.asked]
    assert spans[:2] == [f"bytes=0-{FIRST_BYTES - 1}"] * 2
    assert spans[2] is None
    # As browsers do with ranges, and as they do without.
    coded = [asked.headers["accept-encoding"] for asked in server.asked[:3]]
    assert [("gzip" in text) for text in coded] == [False, True, True]
    assert all("origin" in asked.headers for asked in server.asked)


def test_no_more_than_the_requested_bytes_are_read() -> None:
    data = DATA * 100
    with serving(FaultServer(data, always=no_ranges)) as server, Prober() as prober:
        found = prober.probe(server.url())
    assert (found.first.status, len(found.first.body)) == (200, FIRST_BYTES)
    assert found.last is None
    assert server.sent < 5 * len(data)


def test_unresponsive_servers_are_errors() -> None:
    with serving(FaultServer(DATA, always=reset)) as server, Prober() as prober:
        with pytest.raises(StorageError) as broken:
            prober.probe(server.url())
        assert broken.value.code == "connection-broken"
        url = server.url()
    with Prober() as prober:
        with pytest.raises(StorageError) as nobody:
            prober.probe(url)
        assert nobody.value.code == "host-unreachable"

    async def around(exchange: Exchange) -> None:
        await status(302, Location="/again")(exchange)

    with serving(FaultServer(DATA, always=around)) as server, Prober() as prober:
        with pytest.raises(StorageError) as loop:
            prober.probe(server.url())
        assert loop.value.code == "redirect-loop"


@pytest.mark.parametrize("text", ["", "bytes */10", "bytes 1-2", "bytes a-b/c", "bytes 1-2/*"])
def test_a_malformed_content_range_is_none(text: str) -> None:
    assert content_range(Response("", 206, "", {"content-range": text}, b"", 0.0)) is None


async def continuing(exchange: Exchange) -> None:
    """Send informational responses without end."""
    while True:
        exchange.writer.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        await exchange.writer.drain()
        await asyncio.sleep(0.02)


async def dripping(exchange: Exchange) -> None:
    """Send a byte of the body at a time."""
    exchange.head(206, exchange.stated())
    for at in range(10_000):
        exchange.writer.write(exchange.part[at : at + 1])
        await exchange.writer.drain()
        await asyncio.sleep(0.05)


@pytest.mark.parametrize("fault", [continuing, dripping])
def test_servers_without_end_are_left(fault: Fault, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probe, "_LONGEST_SECONDS", 0.5)
    with serving(FaultServer(DATA, always=fault)) as server, Prober() as prober:
        with pytest.raises(StorageError, match="incomplete after") as caught:
            prober.probe(server.url())
        assert caught.value.code == "network-timeout"


@pytest.mark.parametrize(
    "location", ["http://h:99999/", "http://xn--a/", "http://[::1", "http://a..b/"]
)
def test_redirects_that_lead_nowhere_are_errors(location: str) -> None:
    with serving(FaultServer(DATA, always=status(302, Location=location))) as server:
        for url in (server.url(), location):
            with Prober() as prober, pytest.raises(StorageError) as caught:
                prober.probe(url)
            assert caught.value.code in ("connection-broken", "host-unreachable")


def test_cookies_are_not_kept() -> None:
    baking = stating(Set_Cookie="a=" + "x" * 1000)
    with serving(FaultServer(DATA, always=baking)) as server, Prober() as prober:
        prober.probe(server.url())
    assert all("cookie" not in asked.headers for asked in server.asked)
