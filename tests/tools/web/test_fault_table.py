"""What the loader of tools/web makes of every known fault of a network, in Node and in Chromium.

Cases and outcomes are those of the table in docs/reference/network-faults.md.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from cogs_samples import ARRAYS, file_of
from fault_cases import CASES, Case, name_of
from fault_server import FaultServer, serving
from running import installed

import cogsplat

if TYPE_CHECKING:
    from playwright.sync_api import Browser

# Many starts of connections, and a browser.
pytestmark = pytest.mark.slow

HERE = Path(__file__).resolve().parent
# After which an outcome counts as a hang; the longest case waits five times for a second.
PATIENCE_SECONDS = 60
# `fetch` follows twenty redirects in each of five attempts.
MOST_REQUESTS = 120

Said = Mapping[str, str]


@pytest.fixture(scope="module")
def data() -> bytes:
    return file_of("vq", 6000, 3, 500)


@pytest.fixture(scope="module")
def other() -> bytes:
    """A later version of the file."""
    return file_of("vq", 5000, 3, 500)


@pytest.fixture(scope="module")
def in_node(web_package: Path) -> Iterator[Callable[[str], Said]]:
    """Ask one process of Node what comes of a URL."""
    module = web_package / "dist" / "cogsplat.js"
    command = [installed("node"), str(HERE / "fetch_scenes.mjs"), str(module)]
    with subprocess.Popen(
        [*command, str(PATIENCE_SECONDS)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        asked, said = process.stdin, process.stdout

        def ask(url: str) -> Said:
            asked.write(url + "\n")
            asked.flush()
            answer: Said = json.loads(said.readline())
            return answer

        yield ask
        asked.close()
        assert process.wait(timeout=PATIENCE_SECONDS) == 0


def digest(splats: cogsplat.Splats) -> str:
    arrays = (getattr(splats, name) for name in ARRAYS)
    return hashlib.sha256(b"".join(array.astype("<f4").tobytes() for array in arrays)).hexdigest()


def outcome_of(said: Said, expected: bytes) -> str:
    """Return an outcome as the table has it, or all that was said where it is none of those."""
    if "sha256" in said:
        return "works" if said["sha256"] == digest(cogsplat.decode(expected)) else "wrong data"
    if said["error"] == "CogsplatError":
        return f"`{said['code']}`"
    return f"{said['error']}: {said.get('message')}"


def assert_outcome(case: Case, found: str, expected: str) -> None:
    if expected.startswith('"'):
        # An error of the way, not of the file: it has no reason code but says what came.
        assert found.startswith("SourceError: "), found
        assert expected.strip('"') in found
    else:
        assert found == expected


@pytest.mark.parametrize("case", CASES, ids=name_of)
def test_a_fault_ends_in_node_as_the_table_says(
    case: Case, data: bytes, other: bytes, in_node: Callable[[str], Said]
) -> None:
    with serving(FaultServer(data, case.faults(other), case.always)) as server:
        found = outcome_of(in_node(server.url()), other if case.ends_as_other else data)
    assert_outcome(case, found, case.outcome_in_node)
    assert len(server.asked) < MOST_REQUESTS


@pytest.mark.parametrize("case", CASES, ids=name_of)
def test_a_fault_ends_in_chromium_as_the_table_says(
    case: Case, data: bytes, other: bytes, browser: Browser, web_package: Path
) -> None:
    pages = {
        "/page.html": ("text/html", b'<!doctype html><link rel="icon" href="data:,">'),
        "/cogsplat.js": ("text/javascript", (web_package / "dist" / "cogsplat.js").read_bytes()),
        "/fetch_scene.mjs": ("text/javascript", (HERE / "fetch_scene.mjs").read_bytes()),
    }
    made = FaultServer(data, case.faults(other), case.always, pages=pages)
    with serving(made) as server:
        page = browser.new_page()
        page.goto(server.url("page.html"))
        said = page.evaluate(
            """async ([url, seconds]) => {
              const { outcomeOf } = await import("/fetch_scene.mjs");
              return outcomeOf(await import("/cogsplat.js"), url, seconds);
            }""",
            [server.url(), PATIENCE_SECONDS],
        )
        page.close()
    found = outcome_of(said, other if case.ends_as_other else data)
    assert_outcome(case, found, case.outcome_in_chromium)
    assert len(server.asked) < MOST_REQUESTS
