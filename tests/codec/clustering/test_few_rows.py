import numpy as np
import pytest
from scipy.spatial import cKDTree

from cogsplat.codec.clustering.few_rows import nearest, train


def clusters(seed=1):
    """Three tight clusters, one of them at zero."""
    rng = np.random.default_rng(seed)
    centres = np.array([[0.0, 0.0], [5.0, 1.0], [-2.0, 4.0]])
    return centres, rng.permutation(np.repeat(centres, 200, axis=0)) + rng.normal(0, 0.05, (600, 2))


def test_rows_are_the_means_of_clusters():
    centres, vectors = clusters()
    book = train(vectors, 3)
    _, order = cKDTree(book).query(centres)
    assert sorted(order) == [0, 1, 2]
    np.testing.assert_allclose(book[order], centres, atol=0.02)
    labels = nearest(vectors, book)
    for row in range(3):
        np.testing.assert_allclose(book[row], vectors[labels == row].mean(axis=0))


def test_the_nearest_row_equals_that_of_a_tree():
    rng = np.random.default_rng(2)
    vectors, book = rng.normal(size=(500, 3)), rng.normal(size=(8, 3))
    np.testing.assert_array_equal(nearest(vectors, book), cKDTree(book).query(vectors)[1])
    assert nearest(np.zeros((2, 1)), np.array([[1.0], [-1.0]])).tolist() == [0, 0]


@pytest.mark.parametrize("rows", [1, 2, 8])
def test_an_outlier_gets_no_row(rows):
    _, vectors = clusters()
    vectors[17] = 1e6
    book = train(vectors, rows)
    assert book.shape == (rows, 2)
    assert rows == 1 or (np.abs(book) < 1e5).sum() >= 2


def test_rows_without_vectors_keep_their_start():
    book = train(np.array([[1.0, 2.0]]), 4)
    assert book.shape == (4, 2)
    assert np.isfinite(book).all()
    assert book[nearest(np.array([[1.0, 2.0]]), book)[0]].tolist() == [1.0, 2.0]
