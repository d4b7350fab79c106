import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp

from cogsplat.codec.geometry import covariance, rotations

checked = settings(derandomize=True, deadline=None, max_examples=100)
log_scale = st.floats(-20, 10, width=32)


def random_shapes(seed, rows=500, spread=1.5):
    rng = np.random.default_rng(seed)
    quats = rotations.unit(rng.normal(size=(rows, 4)).astype(np.float32))
    return quats, rng.normal(-4, spread, (rows, 3)).astype(np.float32)


def covariances(quats, scales):
    turned = Rotation.from_quat(quats[:, [1, 2, 3, 0]].astype(np.float64)).as_matrix()
    return np.einsum("nij,nj,nkj->nik", turned, np.exp(2 * scales.astype(np.float64)), turned)


def normalised(quats, scales):
    wide = covariances(quats, scales)
    return wide / np.trace(wide, axis1=1, axis2=2)[:, None, None]


def unfolded(rows):
    """Matrix of a vector: the diagonal, then the upper entries times √2."""
    root = math.sqrt(2)
    out = np.empty((len(rows), 3, 3))
    for column, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
        out[:, i, j] = out[:, j, i] = rows[:, column] / (1 if i == j else root)
    return out


@checked
@given(st.tuples(log_scale, log_scale, log_scale))
def test_the_scale_factor_is_the_logarithm_of_the_norm(row):
    scales = np.array([row], np.float32)
    expected = 0.5 * logsumexp(2 * scales.astype(np.float64), axis=1)
    np.testing.assert_allclose(covariance.scale_factor(scales), expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("offset", [-1e5, -200.0, 200.0, 1e5])
def test_the_scale_factor_neither_overflows_nor_vanishes(offset):
    scales = np.array([[0, 0, 0], [1, -3, 2]], np.float32) + np.float32(offset)
    expected = offset + 0.5 * logsumexp([[0, 0, 0], [2, -6, 4]], axis=1)
    np.testing.assert_allclose(covariance.scale_factor(scales), expected, rtol=1e-6)


def test_vectors_are_covariances_of_trace_one():
    quats, scales = random_shapes(1)
    rows = covariance.shape_vectors(quats, scales)
    assert rows.dtype == np.float32
    np.testing.assert_allclose(rows[:, :3].sum(axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(unfolded(rows), normalised(quats, scales), atol=1e-6)


def test_distances_of_vectors_are_those_of_matrices():
    a, b = (covariance.shape_vectors(*random_shapes(seed)).astype(np.float64) for seed in (2, 3))
    matrices = np.linalg.norm(unfolded(a) - unfolded(b), axis=(1, 2))
    np.testing.assert_allclose(np.linalg.norm(a - b, axis=1), matrices, rtol=1e-6)


def test_size_does_not_matter_and_no_size_breaks_it():
    quats, scales = random_shapes(4)
    rows = covariance.shape_vectors(quats, scales)
    for offset in (-100, 100):
        np.testing.assert_allclose(
            covariance.shape_vectors(quats, scales + np.float32(offset)), rows, atol=1e-4
        )
    extreme = np.array([[1e5, -1e5, 0], [-1e29, 1e29, 0], [-3e4, -3e4, -3e4]], np.float32)
    out = covariance.shape_vectors(quats[:3], extreme)
    assert np.isfinite(out).all()
    # Logs this large are float32 themselves: 3e4 is known to 0.002.
    np.testing.assert_allclose(out[:, :3].sum(axis=1), 1, atol=4e-3)


def test_equivalent_quaternions_give_one_vector():
    quats, scales = random_shapes(5)
    named, permuted = rotations.largest_w(quats, scales)
    np.testing.assert_allclose(
        covariance.shape_vectors(named, permuted),
        covariance.shape_vectors(quats, scales),
        atol=1e-6,
    )


def check_decomposed(rows, atol):
    quats, scales = covariance.quats_and_scales(rows)
    assert quats.dtype == scales.dtype == np.float32
    assert np.isfinite(quats).all()
    assert np.isfinite(scales).all()
    np.testing.assert_allclose(np.square(quats.astype(np.float64)).sum(axis=1), 1, atol=5e-7)
    assert (quats[:, 0] >= np.abs(quats[:, 1:]).max(axis=1, initial=0) - 1e-6).all()
    np.testing.assert_allclose(np.exp(2 * scales.astype(np.float64)).sum(axis=1), 1, atol=1e-5)
    assert (scales >= math.log(covariance.MIN_RELATIVE_SCALE) - 1e-4).all()
    np.testing.assert_allclose(covariance.shape_vectors(quats, scales), rows, atol=atol)
    return quats, scales


def test_vectors_come_back_from_scales_and_rotations():
    quats, scales = random_shapes(6, spread=0.8)
    rows = covariance.shape_vectors(quats, scales)
    _, out = check_decomposed(rows, 2e-6)
    relative = scales - covariance.scale_factor(scales)[:, None]
    plain = relative.min(axis=1) > -4
    assert plain.sum() > 300
    np.testing.assert_allclose(
        np.sort(out, axis=1)[plain], np.sort(relative, axis=1)[plain], atol=2e-3
    )


@pytest.mark.parametrize(
    "scales",
    [
        (0, -30, -30),  # needles
        (0, 0, -30),  # discs
        (0, 0, 0),  # balls
        (0, -1e5, -2e5),
        (0, -9, -9.3),
        (0, -1e-7, 1e-7),
    ],
)
def test_degenerate_shapes_come_back(scales):
    quats, _ = random_shapes(7, 200)
    rows = covariance.shape_vectors(quats, np.tile(np.array([scales], np.float32), (200, 1)))
    check_decomposed(rows, 2e-6)
    aligned = np.array([[1, 0, 0, 0]], np.float32)
    check_decomposed(covariance.shape_vectors(aligned, np.array([scales], np.float32)), 2e-6)


def test_principal_axes_turn_variances_into_the_covariance():
    quats, scales = random_shapes(11, 200)
    wide = covariances(quats, scales)
    variances, found = covariance.principal_axes(wide)
    assert (np.diff(variances, axis=1) >= 0).all()
    turned = Rotation.from_quat(found[:, [1, 2, 3, 0]]).as_matrix()
    back = np.einsum("nij,nj,nkj->nik", turned, variances, turned)
    largest = np.abs(wide).max(axis=(1, 2))[:, None, None]
    assert (np.abs(back - wide) <= 1e-12 * largest).all()


def test_indefinite_matrices_still_give_shapes():
    # Rounded means of many vectors: slightly negative eigenvalues, a trace off one, zeros.
    rows = np.array(
        [[1, 0, 0, 0, 0, 0.01], [0.5, 0.5, -1e-4, 0, 0, 0], [0.3, 0.3, 0.3, 0, 0, 0], [0] * 6],
        np.float32,
    )
    quats, scales = covariance.quats_and_scales(rows)
    assert np.isfinite(quats).all()
    np.testing.assert_allclose(np.exp(2 * scales.astype(np.float64)).sum(axis=1), 1, atol=1e-5)
    none = covariance.quats_and_scales(rows[:0])
    assert (none[0].shape, none[1].shape) == ((0, 4), (0, 3))
