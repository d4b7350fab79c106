"""layers: a file with levels, what is told of them, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from running import Run, SmallScene

import cogsplat

SHORT = ["--scales", "2,1", "--shares", "40%,100%", "--steps", 3]


@pytest.mark.slow
def test_a_scene_becomes_levels_and_they_are_told(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "a.cogs"
    told = run("layers", small.ply, out, "--cameras", small.cameras, *SHORT, "--eval-every", 4)
    assert told.code == 0, told.err
    assert "held-out views" in told.out
    assert [line.split()[0] for line in told.out.splitlines()[2:4]] == ["1/2", "1/1"]
    with cogsplat.open(out) as file:
        assert [level.scale for level in file.root.levels] == [2.0, 1.0]
        file.verify()
        counts = [len(file.decode(level=level)) for level in range(2)]
    source = len(cogsplat.read(small.ply))
    assert 0.3 * source < counts[0] <= 0.4 * source
    assert counts[0] < counts[1] <= source
    again = run("layers", small.ply, out, "--cameras", small.cameras, *SHORT)
    assert (again.code, "[exists]" in again.err) == (2, True)


@pytest.mark.slow
def test_figures_are_those_of_the_file(run: Run, small: SmallScene, tmp_path: Path) -> None:
    out = tmp_path / "a.cogs"
    told = run("layers", small.ply, out, "--cameras", small.cameras, *SHORT, "--json").json
    levels = told["levels"]
    assert isinstance(levels, list)
    assert told["bytes"] == out.stat().st_size
    # The last level fetches all that has not ended, and the last opacities of each chunk.
    assert levels[0]["bytes_fetched"] < levels[1]["bytes_fetched"] <= out.stat().st_size
    assert levels[0]["opacity_bytes"] == 0 < levels[1]["opacity_bytes"]
    for level in levels:
        decoded = cogsplat.decode(out, level=level["level"])
        assert level["splats"] == len(decoded)
        assert level["worst_psnr_db"] <= level["psnr_db"]
        assert 0 < level["ssim"] <= 1
    between = cogsplat.decode(out, level=0.5)
    assert np.isfinite(between.opacities).any()


@pytest.mark.parametrize(
    "words",
    [
        ["--scales", "1,2"],
        ["--scales", "2,one"],
        ["--scales", "2,1", "--shares", "100%"],
        ["--shares", "8%,25%,60%,120%"],
        ["--scales", "64,1", "--shares", "8%,100%"],
        ["--images", "photos"],
    ],
)
def test_what_means_nothing_is_misuse(
    run: Run, small: SmallScene, tmp_path: Path, words: list[str]
) -> None:
    cameras = [] if "--images" in words else ["--cameras", small.cameras]
    (tmp_path / "photos").mkdir()
    words = [str(tmp_path / word) if word == "photos" else word for word in words]
    told = run("layers", small.ply, tmp_path / "a.cogs", *cameras, *words)
    assert told.code == 2
    assert not (tmp_path / "a.cogs").exists()
