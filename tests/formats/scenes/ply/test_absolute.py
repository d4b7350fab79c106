"""Centres written as doubles in world coordinates, against plyfile."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import plyfile
import pytest

import cogsplat
from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.splats import SceneInfo
from cogsplat.tools.lab.synthetic.terrace import synth

ORIGIN = (691234.0, 5334567.5, 512.25)


def test_doubles_hold_the_world_coordinates(tmp_path: Path) -> None:
    scene = replace(
        synth(50),
        info=SceneInfo(origin=ORIGIN, kernel_px=0.1),
        extras={"label": np.arange(50, dtype="u1")},
    )
    path = tmp_path / "absolute.ply"
    cogsplat.write(scene, path, absolute=True)
    vertex = plyfile.PlyData.read(str(path))["vertex"]
    for axis, name in enumerate("xyz"):
        assert vertex[name].dtype == np.float64
        expected = scene.means[:, axis].astype(np.float64) + ORIGIN[axis]
        np.testing.assert_array_equal(vertex[name], expected)
    for name, expected in (("opacity", scene.opacities), ("rot_3", scene.quats[:, 3])):
        np.testing.assert_array_equal(vertex[name], expected)
        assert vertex[name].dtype == np.float32
    np.testing.assert_array_equal(vertex["label"], scene.extras["label"])
    assert b"origin" not in path.read_bytes()[:400]


def test_absolute_centres_survive_a_round_trip(tmp_path: Path) -> None:
    scene = replace(synth(50), info=SceneInfo(origin=ORIGIN, kernel_px=0.1))
    first, second = tmp_path / "first.ply", tmp_path / "second.ply"
    cogsplat.write(scene, first, absolute=True)
    with pytest.warns(CogsplatWarning, match="becomes the origin"):
        again = cogsplat.read(first)
    assert again.info.kernel_px == 0.1
    world = again.means.astype(np.float64) + again.info.origin
    # Half a unit of the last place of float32 at a few scene units.
    np.testing.assert_allclose(world, scene.means.astype(np.float64) + ORIGIN, rtol=0, atol=1e-6)
    cogsplat.write(again, second, absolute=True)
    with pytest.warns(CogsplatWarning, match="becomes the origin"):
        np.testing.assert_array_equal(cogsplat.read(second).means, again.means)


def test_other_formats_refuse(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="spz with the option absolute, expected prec"):
        cogsplat.write(synth(5), tmp_path / "out.spz", absolute=True)
    assert list(tmp_path.iterdir()) == []
