"""Weights of one view against brute force."""

import math

import numpy as np
import oracle
import pytest

from cogsplat.codec.render.blend_weights import MAX_WEIGHTS, PEAK, SQUARE, WEIGHT, add_weights
from cogsplat.codec.render.projection import project
from cogsplat.codec.render.tiles import tile_lists


def _sums(splats, camera, top_k=0, threads=1, pairs_at_once=1 << 20):
    footprints = project(splats, camera)
    sums = np.zeros((len(footprints), 3))
    for lists in tile_lists(footprints, camera.width, camera.height, pairs_at_once):
        add_weights(lists, footprints, camera, top_k, threads, sums)
    return footprints.index, sums


@pytest.mark.parametrize("top_k", [0, 1, 4])
def test_sums_are_those_of_brute_force(top_k):
    splats, camera = oracle.scene(3, n=150), oracle.camera(width=45, height=37)
    index, sums = _sums(splats, camera, top_k)
    seen = oracle.view(splats, camera)
    expected = np.zeros((len(splats), 3))
    expected[:, WEIGHT] = oracle.top_weights(seen, top_k).sum(axis=0)
    expected[:, SQUARE] = np.square(seen.weights).sum(axis=0)
    expected[:, PEAK] = seen.weights.max(axis=0)
    found = np.zeros_like(expected)
    found[index] = sums
    off = np.abs(found - expected) / expected.max(axis=0)
    assert off.max() < 2e-3
    # In float32 some weights lie on the other side of the cut at alpha 1/255.
    assert np.mean(off > 1e-5) < 0.05


def test_neither_threads_nor_bands_change_the_sums():
    splats, camera = oracle.scene(4, n=300), oracle.camera(width=70, height=50)
    _, expected = _sums(splats, camera, 3)
    for threads in (2, 5):
        np.testing.assert_array_equal(_sums(splats, camera, 3, threads)[1], expected)
    np.testing.assert_array_equal(_sums(splats, camera, 3, pairs_at_once=40)[1], expected)


def test_no_pixel_blends_more_than_the_bound():
    alpha = 1 / 255
    assert math.ceil(math.log(1e-4) / math.log(1 - alpha)) < MAX_WEIGHTS


def test_a_huge_top_k_counts_every_weight():
    splats, camera = oracle.scene(7), oracle.camera()
    np.testing.assert_array_equal(_sums(splats, camera, 10**12)[1], _sums(splats, camera, 0)[1])


@pytest.mark.parametrize("top_k", [0, 3])
def test_pairs_that_change_no_pixel_are_told_apart(top_k):
    """Without them every weight is the same, with and without a splat that ends pixels."""
    splats, camera = oracle.scene(3, n=150), oracle.camera(width=45, height=37)
    splats.opacities[::3] = 9.0
    splats.scales[:] += 1.5
    footprints = project(splats, camera)
    whole, few = np.zeros((2, len(footprints), 3))
    for lists in tile_lists(footprints, camera.width, camera.height):
        acts = add_weights(lists, footprints, camera, top_k, 1, whole)
        shown = lists.of_pairs(acts)
        assert add_weights(shown, footprints, camera, top_k, 1, few).all()
        assert 0 < acts.sum() < len(acts)
    np.testing.assert_array_equal(few, whole)
