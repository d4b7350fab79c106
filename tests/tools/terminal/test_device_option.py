"""--device: refused before any work where there is none, and taken to where views are drawn."""

from pathlib import Path

import pytest
from running import Run, SmallScene

from cogsplat.codec.errors import MissingExtraError
from cogsplat.codec.render import cuda_views
from cogsplat.tools.terminal import options

COMMANDS = {"encode": "a.cogs", "lab score": "a.npy", "render": "a.png", "tune": "a.cogs"}


def refused(reason: str):
    def refuse() -> None:
        raise MissingExtraError(reason, "no device in this test")

    return refuse


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("late", [False, True])
def test_device_option(
    run: Run,
    small: SmallScene,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    command: str,
    late: bool,
) -> None:
    monkeypatch.setattr(options, "cuda_device", (lambda: None) if late else refused("at-once"))
    monkeypatch.setattr(cuda_views, "cuda_device", refused("when-drawn"))
    out = tmp_path / COMMANDS[command]
    told = run(command, small.ply, out, "--cameras", small.cameras, "--device", "cuda", "--quiet")
    assert told.code == 4
    assert ("[when-drawn]" if late else "[at-once]") in told.err
    assert not out.exists()


def test_a_scheduler_and_a_device_are_refused(
    run: Run, small: SmallScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(options, "cuda_device", lambda: None)
    told = run(
        "encode", small.ply, tmp_path / "a.cogs", "--device", "cuda", "--scheduler", "local"
    )  # fmt: skip
    assert told.code == 2
    assert "--device cuda and --scheduler" in told.err
