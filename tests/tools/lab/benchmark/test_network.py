import json
import subprocess
import sys

import pytest
from click.testing import CliRunner

from cogsplat.tools.lab.benchmark.network import main


def told(*words):
    done = CliRunner().invoke(main, [*map(str, words), "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return json.loads(done.output)


def measure_alone(*words):
    """Run the benchmark in a process of its own: memory is that of its reads, not of kernels."""
    command = [sys.executable, "-m", "cogsplat.tools.lab.benchmark.network", *map(str, words)]
    done = subprocess.run([*command, "--json"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
def test_a_large_file_is_opened_by_its_root_and_chunks_take_two_requests():
    found = measure_alone("large", "--chunks", 2000, "--tries", 2)
    assert found["chunks"] == 2000
    assert found["pages"] > 1
    assert (found["opening_requests"], found["opening_bytes"]) == (1, 65536)
    assert found["chunk_requests"] <= 3
    assert found["memory_bytes"] < 100 << 20


@pytest.mark.slow
def test_of_a_large_folder_the_manifest_is_opened_and_a_chunk_takes_its_page_and_objects():
    found = measure_alone("large", "--chunks", 2000, "--tries", 2, "--folder")
    assert found["pages"] > 1
    # The whole manifest comes with the first request: its pages are objects.
    assert found["opening_requests"] == 1
    assert found["opening_bytes"] < 65536
    # A page and its places, the object of the chunk, that of the codebooks.
    assert found["chunk_requests"] <= 3
    assert found["memory_bytes"] < 100 << 20


@pytest.mark.slow
def test_over_a_link_no_byte_comes_twice(small):
    found = told("link", small.cogs, "--bits", 50e6, "--latency", 1)
    assert found["received_bytes"] == found["file_bytes"] == small.cogs.stat().st_size
    assert (
        0 < found["opened_seconds"] <= found["first_chunk_seconds"] <= found["last_chunk_seconds"]
    )
    assert found["fetched_seconds"] >= found["link_seconds"]
    assert found["decoded_seconds"] >= found["link_seconds"]


@pytest.mark.slow
def test_readers_get_right_bytes(small):
    found = told("readers", small.cogs, "--readers", 5, "--seconds", 1)
    assert found["answers"] > 5
    assert (found["wrong"], found["errors"]) == (0, 0)
    assert found["memory_peak_bytes"] >= found["memory_last_bytes"] > 0
