"""Commands that are killed do what they promise when they are run again: a few kills of each."""

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

KILLS = str(max(3, int(os.environ.get("COGSPLAT_KILLS", "3"))))


pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc").exists(), reason="needs fork and /proc"),
]


def kill(name: str, folder: Path) -> None:
    """Kill a command a few times; each run after a kill must keep its promise."""
    words = [sys.executable, str(Path(__file__).with_name("kills.py")), name, "--kills", KILLS]
    done = subprocess.run(words, capture_output=True, text=True, cwd=folder, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 faults" in done.stdout


@pytest.mark.parametrize("name", ["tune", "layers", "memory", "batch"])
def test_a_killed_command_is_run_again_to_the_same_bytes(name: str, tmp_path: Path) -> None:
    kill(name, tmp_path)


# Apart, because it alone has to be run again where an object store is installed.
@pytest.mark.skipif(find_spec("moto") is None, reason="needs moto")
def test_a_killed_upload_is_run_again_to_the_same_objects(tmp_path: Path) -> None:
    kill("upload", tmp_path)
