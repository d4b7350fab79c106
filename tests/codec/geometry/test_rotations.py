import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cogsplat.codec.geometry import rotations
from cogsplat.codec.splats import empty

checked = settings(derandomize=True, deadline=None, max_examples=100)
component = st.floats(-1, 1, width=32)
# The corner of the cubic group's fundamental zone is 62.8° away from its centre.
LEAST_W = (1 + math.sqrt(2)) / (2 * math.sqrt(2))


def random_quats(seed, rows=2000):
    quats = np.random.default_rng(seed).normal(size=(rows, 4)).astype(np.float32)
    return rotations.unit(quats)


def theirs(quats):
    return Rotation.from_quat(quats[:, [1, 2, 3, 0]].astype(np.float64))


def covariances(quats, scales):
    turned = theirs(quats).as_matrix()
    return np.einsum("nij,nj,nkj->nik", turned, np.exp(2 * scales.astype(np.float64)), turned)


@checked
@given(st.tuples(*[component] * 4).filter(any), st.integers(-30, 30))
def test_unit_is_the_same_rotation_with_norm_one_and_w_not_negative(row, exponent):
    quats = np.array([row], np.float32) * np.float32(2.0**exponent)
    if not quats.any():
        return
    out = rotations.unit(quats)
    assert out.dtype == np.float32
    wide = quats[0].astype(np.float64)
    expected = wide / np.abs(wide).max()
    expected /= np.linalg.norm(expected)
    expected *= -1 if expected[0] < 0 else 1
    np.testing.assert_allclose(out[0], expected, atol=1e-7)


@pytest.mark.parametrize("size", [1e-45, 1e-38, 1.0, 1e19, 3e38])
def test_unit_takes_any_norm(size):
    quats = np.array([[-size, 0, 0, 0], [0, size, 0, 0], [size, size, -size, size]], np.float32)
    out = rotations.unit(quats)
    np.testing.assert_allclose(out, [[1, 0, 0, 0], [0, 1, 0, 0], [0.5, 0.5, -0.5, 0.5]], atol=1e-7)


def test_matrices_match_scipy():
    quats = random_quats(1)
    np.testing.assert_allclose(rotations.matrices(quats), theirs(quats).as_matrix(), atol=3e-7)
    assert rotations.matrices(quats[:0]).shape == (0, 3, 3)


def test_matrices_come_back_as_their_quaternions():
    quats = random_quats(2).astype(np.float64)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    out = rotations.from_matrices(rotations.matrices(quats))
    np.testing.assert_allclose(out, quats, atol=1e-12)


def test_half_turns_and_small_turns_come_back():
    rng = np.random.default_rng(3)
    axes = np.concatenate([np.eye(3), -np.eye(3), rng.normal(size=(200, 3))])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    for angle in (0.0, 1e-9, 1e-4, math.pi - 1e-9, math.pi):
        turns = Rotation.from_rotvec(axes * angle)
        out = rotations.from_matrices(turns.as_matrix())
        np.testing.assert_allclose(np.square(out).sum(axis=1), 1, atol=1e-12)
        assert (out[:, 0] >= 0).all()
        apart = (Rotation.from_quat(out[:, [1, 2, 3, 0]]) * turns.inv()).magnitude()
        assert apart.max() < 1e-7


def test_products_match_scipy_and_broadcast():
    a, b = random_quats(4).astype(np.float64), random_quats(5).astype(np.float64)
    out = rotations.multiply(a, b)
    expected = (theirs(a) * theirs(b)).as_quat()[:, [3, 0, 1, 2]]
    signs = np.sign((out * expected).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(out, signs * expected, atol=1e-6)
    table = rotations.multiply(a[:5, None], b[None, :7])
    np.testing.assert_array_equal(table[3, 6], rotations.multiply(a[3], b[6]))


def test_permuting_axes_preserves_the_gaussian_and_bounds_the_quaternion():
    rng = np.random.default_rng(6)
    quats = random_quats(7, 20_000)
    scales = rng.normal(-4, 2, (20_000, 3)).astype(np.float32)
    named, permuted = rotations.largest_w(quats, scales)
    assert named.dtype == permuted.dtype == np.float32
    assert permuted.flags.c_contiguous
    assert float(named[:, 0].min()) >= LEAST_W - 1e-6
    # Along an axis at most 45° are left: sin 22.5°.
    assert float(np.abs(named[:, 1:]).max()) <= math.sin(math.pi / 8) + 1e-6
    np.testing.assert_allclose(np.square(named.astype(np.float64)).sum(axis=1), 1, atol=3e-7)
    np.testing.assert_array_equal(np.sort(permuted, axis=1), np.sort(scales, axis=1))
    before, after = covariances(quats, scales), covariances(named, permuted)
    size = np.abs(before).max(axis=(1, 2))
    assert (np.abs(before - after).max(axis=(1, 2)) / size).max() < 1e-6


def test_w_is_the_largest_of_all_24_equivalents():
    quats = random_quats(8, 300).astype(np.float64)
    named, _ = rotations.largest_w(quats.astype(np.float32), np.zeros((300, 3), np.float32))
    best = np.zeros(300)
    count = 0
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            axes = np.eye(3)[list(order)] * np.array(signs)
            if np.linalg.det(axes) > 0:
                turn = np.abs((theirs(quats) * Rotation.from_matrix(axes)).as_quat()[:, 3])
                best = np.maximum(best, turn)
                count += 1
    assert count == 24
    np.testing.assert_allclose(named[:, 0], best, atol=1e-6)


def test_the_24_equivalent_quaternions_all_become_the_same():
    quat, scales = random_quats(9, 1), np.array([[1.0, 2.0, 3.0]], np.float32)
    expected_quat, expected_scales = rotations.largest_w(quat, scales)
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            axes = np.eye(3)[list(order)].T * np.array(signs)
            if np.linalg.det(axes) < 0:
                continue
            turned = (theirs(quat) * Rotation.from_matrix(axes)).as_quat()[:, [3, 0, 1, 2]]
            name = rotations.unit(turned.astype(np.float32))
            out_quat, out_scales = rotations.largest_w(name, scales[:, list(order)])
            np.testing.assert_allclose(out_quat, expected_quat, atol=1e-6)
            np.testing.assert_array_equal(out_scales, expected_scales)


def test_aligned_gaussians_become_unrotated():
    half = math.sqrt(0.5)
    quats = np.array(
        [[0, 1, 0, 0], [half, half, 0, 0], [half, 0, 0, -half], [0.5, -0.5, 0.5, 0.5]], np.float32
    )
    scales = np.tile(np.array([[1, 2, 3]], np.float32), (4, 1))
    named, permuted = rotations.largest_w(quats, scales)
    np.testing.assert_allclose(named, np.tile([[1, 0, 0, 0]], (4, 1)), atol=1e-7)
    np.testing.assert_allclose(covariances(named, permuted), covariances(quats, scales), atol=1e-4)
    assert permuted[1].tolist() == [1, 3, 2]
    none = rotations.largest_w(quats[:0], scales[:0])
    assert (none[0].shape, none[1].shape) == ((0, 4), (0, 3))


def test_only_extreme_quaternions_of_splats_are_normalised(monkeypatch):
    monkeypatch.setattr(rotations, "_BLOCK", 10)
    splats = replace(empty(0, 35), quats=3 * random_quats(8, 35))
    assert rotations.normalise_extremes(splats) is splats
    quats = splats.quats.copy()
    for row, factor in ((0, 2.0**-120), (17, 2.0**110), (34, 2.0**-40)):
        quats[row] *= factor
    found = rotations.normalise_extremes(replace(splats, quats=quats)).quats
    expected = splats.quats.copy()
    expected[[0, 17, 34]] = rotations.unit(expected[[0, 17, 34]])
    np.testing.assert_array_equal(found, expected)
