import numpy as np
import pytest
from oracle import real_sh

from cogsplat.codec.geometry import sh


def _directions(n, seed=0):
    vectors = np.random.default_rng(seed).normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_all_16_bases_equal_the_legendre_formula_sign_included():
    directions = _directions(200)
    np.testing.assert_allclose(sh.basis(directions, 3), real_sh(directions, 3), atol=1e-12)


def test_bases_are_orthonormal_on_the_sphere():
    # Gauss-Legendre by trapezoid integrates polynomials of degree 6 exactly.
    z, weights = np.polynomial.legendre.leggauss(8)
    azimuth = np.arange(16) * 2 * np.pi / 16
    ring = np.sqrt(1 - z**2)
    directions = np.stack(
        [
            np.outer(ring, np.cos(azimuth)),
            np.outer(ring, np.sin(azimuth)),
            np.outer(z, np.ones(16)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    area = np.repeat(weights, 16) * 2 * np.pi / 16
    values = sh.basis(directions, 3)
    np.testing.assert_allclose(values.T @ (area[:, None] * values), np.eye(16), atol=1e-12)


@pytest.mark.parametrize("degree", range(4))
def test_lower_degrees_are_the_first_columns(degree):
    directions = _directions(5)
    full = sh.basis(directions, 3)
    np.testing.assert_array_equal(sh.basis(directions, degree), full[:, : (degree + 1) ** 2])


@pytest.mark.parametrize("degree", [-1, 4])
def test_unknown_degree_is_refused(degree):
    with pytest.raises(ValueError, match="SH degree"):
        sh.basis(_directions(1), degree)


def test_band_one_has_the_signs_of_3dgs():
    x, y, z = (sh.basis(np.eye(3)[[axis]], 1)[0, 1:] for axis in range(3))
    assert x.tolist() == [0.0, 0.0, -sh.C1]
    assert y.tolist() == [-sh.C1, 0.0, 0.0]
    assert z.tolist() == [0.0, sh.C1, 0.0]


@pytest.mark.parametrize("degree", range(4))
def test_colours_are_the_sum_plus_a_half(degree):
    rng = np.random.default_rng(degree)
    directions = _directions(30, seed=1)
    sh0 = rng.normal(size=(30, 3)).astype(np.float32)
    higher = rng.normal(size=(30, (degree + 1) ** 2 - 1, 3)).astype(np.float32)
    coefficients = np.concatenate([sh0[:, None], higher], axis=1)
    expected = np.einsum("nk,nkc->nc", real_sh(directions, degree), coefficients) + 0.5
    actual = sh.colours(sh0, higher, directions)
    assert actual.dtype == np.float32
    assert (expected < 0).any(), "the clamp was not tried"
    np.testing.assert_allclose(actual, np.maximum(expected, 0), atol=1e-6)


def test_zero_coefficients_are_mid_grey():
    colours = sh.colours(np.zeros((1, 3)), np.zeros((1, 0, 3)), np.array([[0.0, 0.0, 1.0]]))
    assert colours.tolist() == [[0.5, 0.5, 0.5]]
