"""Every known fault of a network, what a reader makes of it, and the table in the docs."""

import re
import threading
import warnings
from pathlib import Path

import pytest
from cogs_samples import assert_same, file_of
from fault_cases import CASES, Case, html, name_of
from fault_server import (
    Exchange,
    FaultServer,
    no_ranges,
    right,
    serving,
    slow,
    status,
)

import cogsplat
from cogsplat.codec.errors import Cancelled, CogsplatError, CogsplatWarning
from cogsplat.formats.cogs.open_file import open_source
from cogsplat.formats.network.network_options import NetworkOptions

DOCS = Path(__file__).resolve().parents[3] / "docs/reference/network-faults.md"

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
    text = DOCS.read_text(encoding="utf-8")
    rows = re.findall(r"^\| (F\d\d)" + 4 * r" \| (.+?)" + r" \|", text, re.M)
    tested = [
        (case.number, case.what, case.outcome, case.outcome_in_node, case.outcome_in_chromium)
        for case in CASES
    ]
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
        source = open_source(server.url())
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
