"""`serve` and `view` answer in a crowd: `crowd.py` with small numbers."""

import asyncio
import importlib.util
import os
from pathlib import Path

import pytest

if os.name != "posix":
    pytest.skip("limits of open files", allow_module_level=True)

SPEC = importlib.util.spec_from_file_location("crowd", Path(__file__).with_name("crowd.py"))
assert SPEC is not None
assert SPEC.loader is not None
crowd = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(crowd)

DESCRIPTORS = 160

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc"),
]


@pytest.mark.parametrize("kind", ["serve", "view"])
def test_good_peers_among_bad_ones_are_answered(kind, tmp_path):
    with crowd.server_process(kind, tmp_path, DESCRIPTORS) as served:
        asyncio.run(crowd.crowd(served, held=50, per_minute=600, seconds=6))
        # Each is closed by the peer: descriptors of closed connections are free at once.
        asyncio.run(crowd.burst(served, 2 * DESCRIPTORS))
        asyncio.run(crowd.aborted(served, 10))
        asyncio.run(crowd.pipeline(served, 20_000, 2))
    figures = served.figures
    assert figures.wrong == []
    assert figures.lines == []
    assert figures.held == dict.fromkeys(crowd.KINDS, 10)
    assert figures.answers > 2 * DESCRIPTORS
    assert figures.most_descriptors < DESCRIPTORS
    assert figures.most_rss < 150e6


@pytest.mark.parametrize("kind", ["serve", "view"])
def test_more_peers_than_descriptors(kind, tmp_path):
    with crowd.server_process(kind, tmp_path, DESCRIPTORS) as served:
        asyncio.run(
            crowd.crowd(served, held=DESCRIPTORS, per_minute=60, seconds=10, kinds=("unread",))
        )
    figures = served.figures
    assert figures.wrong == []
    assert figures.lines == []
    assert figures.answers > 0
    assert figures.most_descriptors < DESCRIPTORS
