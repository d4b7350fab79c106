"""Commands that are killed do what they promise when they are run again: a few kills of each."""

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

KILLS = str(max(3, int(os.environ.get("COGSPLAT_KILLS", "3"))))


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").exists(), reason="needs fork and /proc")
@pytest.mark.parametrize("name", ["tune", "layers", "memory", "batch", "upload"])
def test_a_killed_command_is_run_again_to_the_same_bytes(name: str, tmp_path: Path) -> None:
    if name == "upload" and find_spec("moto") is None:
        pytest.skip("needs moto")
    words = [sys.executable, str(Path(__file__).with_name("kills.py")), name, "--kills", KILLS]
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 faults" in done.stdout
