from __future__ import annotations

import numpy as np
import pytest

from cogsplat.codec.clustering import kmeans
from cogsplat.codec.clustering.hierarchical_kmeans import train_palette


def grouped(count: int, dimensions: int) -> np.ndarray:
    """Return vectors around centres of falling weight, distributed like SH coefficients."""
    rng = np.random.default_rng(count)
    centres = rng.standard_normal((200, dimensions))
    near = centres[(rng.random(count) ** 2 * 200).astype(int)]
    return (near + rng.standard_normal((count, dimensions)) * 0.3).astype(np.float32)


def mean_error(vectors: np.ndarray, palette: np.ndarray, labels: np.ndarray) -> float:
    return float(np.square(vectors - palette[labels]).sum(axis=1).mean())


@pytest.mark.parametrize("rows", [20, 700])
def test_close_to_plain_k_means(rows: int) -> None:
    vectors = grouped(6000, 9)
    palette, labels = train_palette(vectors, rows)
    assert len(palette) <= rows
    plain = kmeans.train(vectors, np.ones(len(vectors)), rows)
    _, errors = kmeans.nearest(vectors, plain)
    assert mean_error(vectors, palette, labels) < 1.12 * errors.mean()


def test_labels_name_the_nearest_row_nearly_always() -> None:
    vectors = grouped(6000, 9)
    palette, labels = train_palette(vectors, 1500)
    nearest, errors = kmeans.nearest(vectors, palette)
    assert np.mean(labels == nearest) > 0.9
    assert mean_error(vectors, palette, labels) < 1.05 * errors.mean()


def test_rows_are_used_and_ordered_by_first_use() -> None:
    palette, labels = train_palette(grouped(5000, 9), 1024)
    used, first = np.unique(labels, return_index=True)
    np.testing.assert_array_equal(used, np.arange(len(palette)))
    assert (np.diff(first) > 0).all()
    assert len(palette) > 1000


def test_the_same_for_any_number_of_threads() -> None:
    vectors = grouped(5000, 24)
    results = [train_palette(vectors, 800, threads) for threads in (1, 2, 5)]
    for palette, labels in results[1:]:
        np.testing.assert_array_equal(palette, results[0][0])
        np.testing.assert_array_equal(labels, results[0][1])


def test_few_vectors() -> None:
    vectors = grouped(30, 9)
    for rows in (30, 64, 4096):
        palette, labels = train_palette(vectors, rows)
        np.testing.assert_array_equal(palette[labels], vectors)
    palette, labels = train_palette(vectors, 1)
    np.testing.assert_allclose(palette, vectors.mean(axis=0, keepdims=True), rtol=1e-4, atol=1e-5)
    palette, labels = train_palette(vectors[:0], 8)
    assert palette.shape == (0, 9)
    assert labels.shape == (0,)


@pytest.mark.parametrize("rows", [2, 600, 2000])
def test_many_equal_vectors(rows: int) -> None:
    vectors = np.zeros((5000, 9), np.float32)
    palette, labels = train_palette(vectors, rows)
    assert len(palette) == 1
    vectors[7], vectors[4000] = 1, 2
    palette, labels = train_palette(vectors, max(rows, 3))
    np.testing.assert_array_equal(palette[labels], vectors)


def test_nearly_equal_vectors_with_outliers() -> None:
    vectors = np.random.default_rng(1).normal(0, 1e-6, (5000, 9)).astype(np.float32)
    vectors[::100] = np.arange(450).reshape(50, 9)
    palette, labels = train_palette(vectors, 1000)
    assert mean_error(vectors, palette, labels) < 1e-6
