"""Initial splats: sizes, colours and opacity of 3DGS."""

import numpy as np
import pytest

from cogsplat.codec.fit.initial_splats import splats_from_points
from cogsplat.codec.render.rasteriser import render
from cogsplat.tools.lab.synthetic.terrace import synth_cameras


def test_sizes_are_mean_distances_to_three_neighbours():
    rng = np.random.default_rng(3)
    positions = rng.normal(size=(40, 3))
    splats = splats_from_points(positions, np.zeros((40, 3), np.uint8))
    distances = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    expected = np.sort(distances, axis=1)[:, 1:4].mean(axis=1)
    np.testing.assert_allclose(np.exp(splats.scales), np.tile(expected[:, None], 3), rtol=1e-5)
    np.testing.assert_array_equal(splats.means, positions.astype(np.float32))
    np.testing.assert_array_equal(splats.quats, np.tile([1.0, 0, 0, 0], (40, 1)))


def test_a_splat_shows_the_colour_of_its_point():
    colour = np.array([[200, 40, 90]], np.uint8)
    splats = splats_from_points(np.zeros((1, 3)), colour)
    assert splats.shN.shape == (1, 15, 3)
    assert not splats.shN.any()
    picture = render(splats, synth_cameras(1, 64, 48)[0])
    # The splat fills the picture with an opacity of 0.1.
    np.testing.assert_allclose(picture.max(axis=(0, 1)), 0.1 * colour[0] / 255, rtol=1e-2)


def test_coincident_and_few_points_have_a_size():
    twice = splats_from_points(np.ones((5, 3)), np.zeros((5, 3), np.uint8), sh_degree=0)
    assert twice.shN.shape == (5, 0, 3)
    assert not twice.invalid_rows().any()
    pair = splats_from_points(np.array([[0.0, 0, 0], [0, 2, 0]]), np.zeros((2, 3), np.uint8))
    np.testing.assert_allclose(np.exp(pair.scales), 2.0, rtol=1e-6)
    with pytest.raises(ValueError, match="no points"):
        splats_from_points(np.zeros((0, 3)), np.zeros((0, 3), np.uint8))


def test_positions_beyond_float32_give_invalid_rows():
    far = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1e300, 0, 0]])
    splats = splats_from_points(far, np.zeros((5, 3), np.uint8))
    assert splats.invalid_rows().tolist() == [False, False, False, False, True]
