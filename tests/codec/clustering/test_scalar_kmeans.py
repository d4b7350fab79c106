from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.cluster import KMeans

from cogsplat.codec.clustering.scalar_kmeans import nearest_scalars, train_scalars


def error(values: np.ndarray, codebook: np.ndarray) -> float:
    wide = values.astype(np.float64)
    return float(np.square(wide - codebook[nearest_scalars(values, codebook)]).mean())


def best_error(values: np.ndarray, levels: int) -> float:
    """Try every way to cut sorted values into runs."""
    ordered = np.sort(values.astype(np.float64))
    best = np.inf
    for cuts in itertools.combinations(range(1, len(ordered)), levels - 1):
        runs = np.split(ordered, cuts)
        best = min(best, sum(float(np.square(run - run.mean()).sum()) for run in runs))
    return best / len(ordered)


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.floats(-100, 100, width=32), min_size=5, max_size=12, unique=True),
    st.integers(1, 4),
)
def test_small_sets_are_cut_optimally(numbers: list[float], levels: int) -> None:
    values = np.array(numbers, np.float32)
    codebook = train_scalars(values, levels)
    assert len(codebook) <= levels
    assert error(values, codebook) <= best_error(values, levels) * 1.05 + 1e-6


@pytest.mark.parametrize("kind", ["normal", "heavy", "clusters", "uniform"])
def test_no_worse_than_k_means(kind: str) -> None:
    rng = np.random.default_rng(5)
    values = {
        "normal": rng.standard_normal(4000),
        "heavy": rng.standard_t(2, 4000),
        "clusters": rng.normal(rng.integers(0, 50, 4000) ** 2, 0.01),
        "uniform": rng.random(4000),
    }[kind].astype(np.float32)
    codebook = train_scalars(values, 64)
    assert len(codebook) == 64
    assert (np.diff(codebook) > 0).all()
    model = KMeans(64, n_init=3, random_state=1).fit(values[:, None].astype(np.float64))
    assert error(values, codebook) <= model.inertia_ / len(values) * 1.01


def test_few_values_are_kept() -> None:
    values = np.array([3, 1, 1, 2, 3, 3], np.float32)
    np.testing.assert_array_equal(train_scalars(values, 3), [1, 2, 3])
    np.testing.assert_array_equal(train_scalars(values, 256), [1, 2, 3])
    np.testing.assert_allclose(train_scalars(values, 1), [13 / 6], rtol=1e-6)
    assert train_scalars(np.empty(0, np.float32), 4).shape == (0,)


def test_far_from_zero_and_huge() -> None:
    rng = np.random.default_rng(5)
    values = (1e6 + rng.random(3000)).astype(np.float32)
    assert error(values, train_scalars(values, 8)) < 0.01
    codebook = train_scalars(np.array([-3e38, *range(20), 3e38], np.float32), 5)
    assert np.isfinite(codebook).all()


def test_order_does_not_matter() -> None:
    values = np.random.default_rng(5).standard_normal(5000).astype(np.float32)
    np.testing.assert_array_equal(train_scalars(values, 32), train_scalars(values[::-1], 32))


def test_nearest_in_any_shape() -> None:
    codebook = np.array([-1, 0, 10], np.float32)
    values = np.array([[-5, -0.6, -0.4], [4.9, 5.1, 99]], np.float32)
    np.testing.assert_array_equal(nearest_scalars(values, codebook), [[0, 0, 1], [1, 2, 2]])
    np.testing.assert_array_equal(nearest_scalars(values, codebook[:1]), np.zeros((2, 3)))
