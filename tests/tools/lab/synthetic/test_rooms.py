"""The house of many rooms: repeatable, closed all around, and mostly hidden from each view."""

import numpy as np
import pytest

from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.tools.lab.synthetic.rooms import rooms_cameras, rooms_walk, synth_rooms

ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")


def test_same_seed_gives_same_bytes_and_another_seed_does_not() -> None:
    first, again, other = (synth_rooms(3, 2000, seed=seed) for seed in (5, 5, 6))
    for name in ARRAYS:
        assert getattr(first, name).tobytes() == getattr(again, name).tobytes(), name
        assert getattr(first, name).tobytes() != getattr(other, name).tobytes(), name


@pytest.mark.parametrize("splats", [1, 2, 50, 1001])
def test_any_number_of_splats_is_exact_and_drawable(splats: int) -> None:
    scene = synth_rooms(2, splats)
    assert len(scene) == splats
    assert not scene.invalid_rows().any()


def test_lower_degrees_are_the_same_scene_cut() -> None:
    whole, cut = synth_rooms(1, 400), synth_rooms(1, 400, sh_degree=1)
    np.testing.assert_array_equal(cut.shN, whole.with_sh_degree(1).shN)
    np.testing.assert_array_equal(cut.means, whole.means)


@pytest.mark.parametrize(
    ("rooms", "splats", "degree"), [(0, 9, 3), (401, 9, 3), (2, 0, 3), (2, 9, 4)]
)
def test_misuse_is_a_value_error(rooms: int, splats: int, degree: int) -> None:
    with pytest.raises(ValueError, match="expected"):
        synth_rooms(rooms, splats, sh_degree=degree)


def test_a_visitor_is_inside_and_sees_no_way_out() -> None:
    scene = synth_rooms(4, 60_000, sh_degree=0)
    low, high = scene.means.min(axis=0), scene.means.max(axis=0)
    walked = rooms_walk(4)
    assert len({camera.name for camera in walked}) == len(walked)
    for camera in [*walked[::12], *rooms_cameras(4)[::7]]:
        assert ((camera.position > low) & (camera.position < high)).all()
        assert (render(scene, camera).max(axis=2) > 0.02).mean() > 0.97, camera.name


def test_each_view_shows_a_small_part_of_a_large_house() -> None:
    scene = synth_rooms(9, 27_000, sh_degree=0)
    shares = []
    for camera in rooms_cameras(9, views=1):
        shown = score(scene, [camera], ScoreConfig(jitter=False)).contribution
        shares.append(float((shown > 0.5).mean()))
    assert np.median(shares) < 0.25
    assert min(shares) > 0.0
