"""The city of any size: repeatable, in small parts, and solid from streets, roofs and afar."""

from collections import Counter

import numpy as np
import pytest

from cogsplat.codec.geometry.rotations import matrices, unit
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.splats import Splats, concatenate
from cogsplat.tools.lab.synthetic.city import city_parts
from cogsplat.tools.lab.synthetic.city_paths import city_cameras, city_walk
from cogsplat.tools.lab.synthetic.city_plan import SPLATS_PER_BLOCK, plan_city

ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")


def whole(splats: int, seed: int = 7, sh_degree: int = 1) -> Splats:
    return concatenate(list(city_parts(splats, seed, sh_degree)))


def test_same_seed_gives_same_bytes_and_another_seed_does_not() -> None:
    first, again, other = (whole(4000, seed) for seed in (5, 5, 6))
    for name in ARRAYS:
        assert getattr(first, name).tobytes() == getattr(again, name).tobytes(), name
        assert getattr(first, name).tobytes() != getattr(other, name).tobytes(), name


@pytest.mark.parametrize("splats", [1, 2, 50, 1001, 300_000])
def test_any_number_of_splats_is_exact_and_drawable(splats: int) -> None:
    scene = whole(splats)
    assert len(scene) == splats
    assert not scene.invalid_rows().any()


def test_lower_degrees_are_the_same_scene_cut() -> None:
    full, cut = whole(3000, sh_degree=3), whole(3000, sh_degree=1)
    np.testing.assert_array_equal(cut.shN, full.with_sh_degree(1).shN)
    for name in ("means", "quats", "scales", "opacities", "sh0"):
        np.testing.assert_allclose(getattr(cut, name), getattr(full, name), atol=1e-6)


@pytest.mark.parametrize(("splats", "degree"), [(0, 3), (9, 4), (9, -1)])
def test_misuse_is_a_value_error(splats: int, degree: int) -> None:
    with pytest.raises(ValueError, match="expected"):
        next(city_parts(splats, sh_degree=degree))


def test_parts_stay_small_however_large_the_city_is() -> None:
    parts = city_parts(10**8, sh_degree=0)
    assert max(len(next(parts)) for _ in range(3)) < 3 * SPLATS_PER_BLOCK
    city = plan_city(12 * SPLATS_PER_BLOCK, 7)
    assert city.columns * city.rows == 12


def test_thin_axes_of_road_splats_are_upright() -> None:
    scene = whole(60_000)
    # +y is down; a road lies at 0.
    road = np.flatnonzero((np.abs(scene.means[:, 1]) < 1e-4) & (scene.opacities > 2.0))
    assert len(road) > 1000
    thin = scene.scales[road].argmin(axis=1)
    axes = matrices(unit(scene.quats[road]))
    # Some splats along an edge are narrower than thick.
    assert (np.abs(axes[np.arange(len(road)), 1, thin]) > 0.999).mean() > 0.98


def test_no_view_looks_through_the_city() -> None:
    splats = 150_000
    scene = whole(splats, sh_degree=0)
    cameras = city_cameras(splats)
    assert Counter(camera.name.split("_")[0] for camera in cameras) == {
        "street": 29,
        "roof": 12,
        "far": 7,
    }
    for camera in [*cameras[::9], *city_walk(splats)[::60]]:
        assert (render(scene, camera).max(axis=2) > 0.02).mean() > 0.97, camera.name


def test_steps_of_the_way_are_short() -> None:
    way = city_walk(2_000_000)
    places = np.array([camera.position for camera in way])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    kinds = np.array([camera.name.split("_")[0] for camera in way])
    for kind, longest in (("street", 0.71), ("roof", 2.01), ("far", 5.01)):
        assert steps[kinds[1:] == kind].max() <= longest, kind
    assert len({camera.name for camera in way}) == len(way)
