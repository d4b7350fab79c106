"""`lab synth --city`: the files that it writes, and options that it refuses."""

from pathlib import Path

import numpy as np
import pytest
from running import Run

from cogsplat.codec.splats import concatenate
from cogsplat.formats.cameras.inria import read_cameras_json
from cogsplat.formats.scenes.ply.ply_scene import read_ply
from cogsplat.tools.lab.synthetic.city import city_parts


def test_it_writes_scene_cameras_and_way(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "city.ply"
    told = run("lab synth", out, "--city", "--splats", 900, "--sh", 1, "--json").json
    assert (told["city"], told["splats"], told["views"], told["rooms"]) == (True, 900, 48, 0)
    made = concatenate(list(city_parts(900, sh_degree=1)))
    np.testing.assert_array_equal(read_ply(out).means, made.means)
    assert len(read_cameras_json(tmp_path / "city.cameras.json")) == 48
    assert len(read_cameras_json(tmp_path / "city.walk.json")) == told["walk_poses"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["c.ply", "--city", "--rooms", 2], "--city with --rooms"),
        (["c.ply", "--city", "--objects"], "--objects and --masks with --city"),
        (["c.spz", "--city"], "expected a name in .ply"),
        (["c.ply", "--splats", 30_000_000], "without --city"),
    ],
)
def test_it_refuses_what_a_city_has_not(
    run: Run, tmp_path: Path, arguments: list[object], message: str
) -> None:
    told = run("lab synth", tmp_path / str(arguments[0]), *arguments[1:])
    assert told.code == 2
    assert message in told.err
    assert not list(tmp_path.iterdir())
