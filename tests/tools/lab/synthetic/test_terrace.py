"""The synthetic scene: whole, repeatable, in range, and lit as it says."""

import numpy as np
import pytest

from cogsplat.codec.geometry import sh
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.splats import Splats
from cogsplat.tools.lab.synthetic.terrace import LABELS, synth, synth_cameras, synth_labels

ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")


@pytest.fixture(scope="module")
def scene() -> Splats:
    return synth(20_000)


def seen_from(splats: Splats, position: np.ndarray) -> np.ndarray:
    away = splats.means - position
    directions = away / np.linalg.norm(away, axis=1, keepdims=True)
    colours = sh.basis(directions, splats.sh_degree)[:, :, None] * np.concatenate(
        [splats.sh0[:, None], splats.shN], axis=1
    )
    return colours.sum(axis=1) + 0.5


def test_same_seed_gives_same_bytes_and_another_seed_does_not() -> None:
    first, again, other = synth(3_000, seed=3), synth(3_000, seed=3), synth(3_000, seed=4)
    for name in ARRAYS:
        assert getattr(first, name).tobytes() == getattr(again, name).tobytes(), name
        assert getattr(first, name).tobytes() != getattr(other, name).tobytes(), name


@pytest.mark.parametrize("splats", [1, 2, 7, 60, 1_001])
def test_any_number_of_splats_is_exact_and_drawable(splats: int) -> None:
    scene = synth(splats)
    assert len(scene) == splats
    assert not scene.invalid_rows().any()
    assert len(synth_labels(splats)) == splats


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_lower_degrees_are_the_same_scene_cut(degree: int) -> None:
    scene, whole = synth(500, sh_degree=degree), synth(500)
    assert scene.sh_degree == degree
    np.testing.assert_array_equal(scene.shN, whole.with_sh_degree(degree).shN)
    np.testing.assert_array_equal(scene.means, whole.means)


@pytest.mark.parametrize(("splats", "degree"), [(0, 3), (-5, 3), (100, 4), (100, -1)])
def test_misuse_is_a_value_error(splats: int, degree: int) -> None:
    with pytest.raises(ValueError, match="expected"):
        synth(splats, sh_degree=degree)


def test_statistics_are_those_of_trained_scenes(scene: Splats) -> None:
    norms = np.linalg.norm(scene.quats, axis=1)
    assert norms.min() > 0.49
    assert norms.max() < 2.01
    assert norms.std() > 0.1
    opacities_unit = 1.0 / (1.0 + np.exp(-scene.opacities))
    assert np.median(opacities_unit) > 0.8
    assert (opacities_unit < 0.3).mean() > 0.05
    axes = np.sort(scene.scales, axis=1)
    assert np.median(axes[:, 2] - axes[:, 0]) > 1.5, "splats are flat"
    assert axes[:, 2].std() > 0.6, "sizes are spread widely"
    assert 0.03 < scene.shN.std() < 0.12
    thin = np.bincount(scene.scales.argmin(axis=1), minlength=3)
    assert thin.min() > 0.3 * len(scene) / 3, "any axis may be the thin one"


def test_colours_stay_displayable_from_every_camera(scene: Splats) -> None:
    opaque = scene.opacities > 0.0
    for camera in synth_cameras(views=8):
        colours = seen_from(scene, camera.position)[opaque]
        assert np.percentile(colours, 0.5) > -0.05
        assert np.percentile(colours, 99.5) < 1.05


def test_labels_cover_the_scene_and_objects_stand_apart(scene: Splats) -> None:
    labels = synth_labels(len(scene))
    assert labels.dtype == np.uint16
    assert sorted(set(labels.tolist())) == list(range(len(LABELS)))
    boxes = [
        (scene.means[labels == i].min(axis=0), scene.means[labels == i].max(axis=0))
        for i in range(1, len(LABELS) - 1)
    ]
    for i, (low, high) in enumerate(boxes):
        for other_low, other_high in boxes[:i]:
            assert ((low > other_high) | (other_low > high)).any()


def test_highlight_lies_where_the_sun_is_mirrored(scene: Splats) -> None:
    """On the red ball, the brightest splat moves with the eye as a mirror's would."""
    labels = synth_labels(len(scene))
    ball = scene.take((labels == LABELS.index("marbles")) & (scene.opacities > 2.0))
    # Of the balls the red one's DC is far above its green.
    ball = ball.take(ball.sh0[:, 0] - ball.sh0[:, 1] > 0.6)
    tops = []
    for camera in (synth_cameras()[9], synth_cameras()[13]):
        green = seen_from(ball, camera.position)[:, 1]
        tops.append(ball.means[np.argsort(green)[-20:]].mean(axis=0))
    assert np.linalg.norm(tops[0] - tops[1]) > 0.05


def test_no_holes_in_any_view(scene: Splats) -> None:
    white = synth(20_000, sh_degree=0)
    white = Splats(
        means=white.means,
        scales=white.scales,
        quats=white.quats,
        opacities=white.opacities,
        sh0=np.full_like(white.sh0, 0.5 / sh.C0),
        shN=white.shN,
    )
    for camera in synth_cameras(views=4, width=160, height=120):
        coverage = render(white, camera)
        assert coverage.min() > 0.7
        assert np.percentile(coverage, 0.1) > 0.9


def test_cameras_surround_the_scene_and_hold_out_covers_every_group() -> None:
    cameras = synth_cameras()
    assert len(cameras) == 48
    assert len({camera.name for camera in cameras}) == 48
    positions = np.array([camera.position for camera in cameras])
    for camera in cameras:
        middle = camera.rotation @ np.array([0.0, -0.5, 0.0]) + camera.translation
        assert middle[2] > 0.5, "looks at the scene"
    held_out = positions[::8]
    radii = np.hypot(held_out[:, 0], held_out[:, 2])
    assert (held_out[:, 1] < 0).all(), "above the ground, +y is down"
    assert len(np.unique(radii.round(1))) >= 3


def test_camera_counts_and_sizes_are_what_is_asked() -> None:
    cameras = synth_cameras(views=5, width=64, height=48)
    assert [(camera.width, camera.height) for camera in cameras] == [(64, 48)] * 5
