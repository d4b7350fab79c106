import numpy as np
import pytest

from cogsplat.codec.clustering import entropy_kmeans
from cogsplat.codec.clustering.entropy_kmeans import RatedRows
from cogsplat.codec.clustering.kmeans import TrainingConfig

CENTRES = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], np.float32)
CONFIG = TrainingConfig(iterations=12)


def groups(counts, seed=1, spread=0.1):
    """Return vectors around each centre."""
    rng = np.random.default_rng(seed)
    rows = [c + rng.normal(0, spread, (n, 3)) for c, n in zip(CENTRES, counts, strict=True)]
    return np.concatenate(rows).astype(np.float32)


def train(vectors, weights=None, rows=32, price=0.05, row_bits=50.0, config=CONFIG, start=None):
    weights = np.ones(len(vectors)) if weights is None else weights
    return entropy_kmeans.train(vectors, weights, rows, price, row_bits, config, start)


def test_every_vector_gets_the_row_of_least_cost():
    rng = np.random.default_rng(2)
    vectors = rng.normal(size=(1300, 5)).astype(np.float32)
    weights = rng.lognormal(0, 1, 1300)
    book = RatedRows(rng.normal(size=(40, 5)).astype(np.float32), rng.uniform(1, 9, 40))
    labels, best, second = book.assign(vectors, weights, 0.3)
    distances = np.square(vectors[:, None].astype(np.float64) - book.rows).sum(axis=2)
    costs = weights[:, None] * distances + 0.3 * book.bits
    np.testing.assert_allclose(costs[np.arange(1300), labels], costs.min(axis=1), rtol=1e-4)
    np.testing.assert_allclose(best, costs.min(axis=1), rtol=1e-4)
    np.testing.assert_allclose(second, np.sort(costs, axis=1)[:, 1], rtol=1e-4)


def test_candidates_are_the_rows_of_least_cost():
    rng = np.random.default_rng(4)
    vectors = rng.normal(size=(700, 5)).astype(np.float32)
    weights = rng.lognormal(0, 1, 700)
    book = RatedRows(rng.normal(size=(40, 5)).astype(np.float32), rng.uniform(1, 9, 40))
    distances = np.square(vectors[:, None].astype(np.float64) - book.rows).sum(axis=2)
    costs = weights[:, None] * distances + 0.3 * book.bits
    found = np.sort(book.candidates(vectors, weights, 0.3, 6), axis=1)
    np.testing.assert_array_equal(found, np.sort(np.argsort(costs, axis=1)[:, :6], axis=1))
    assert book.candidates(vectors, weights, 0.3, 50).shape == (700, 40)


def test_vectors_that_cost_less_alone_shape_no_row():
    vectors = groups((400, 300, 200, 100))
    alone = np.where(np.arange(1000) < 900, np.inf, 1e-3)
    book = entropy_kmeans.train(vectors, np.ones(1000), 32, 0.05, 50.0, CONFIG, None, alone)
    np.testing.assert_allclose(book.rows, CENTRES[:3], atol=0.05)
    np.testing.assert_allclose(book.bits, -np.log2([4 / 9, 3 / 9, 2 / 9]), atol=1e-6)
    # Moved vectors stand alone wherever they are.
    vectors[900:] *= 5
    again = entropy_kmeans.train(vectors, np.ones(1000), 32, 0.05, 50.0, CONFIG, None, alone)
    np.testing.assert_allclose(again.rows, book.rows, atol=1e-2)
    none = entropy_kmeans.train(
        vectors, np.ones(1000), 32, 0.05, 50.0, CONFIG, None, np.full(1000, 1e-9)
    )
    assert none.rows.tolist() == [[0, 0, 0]]


def test_rows_are_the_groups_and_often_used_ones_have_few_bits():
    book = train(groups((400, 300, 200, 100)))
    assert len(book.rows) == 4
    np.testing.assert_allclose(book.rows, CENTRES, atol=0.05)
    np.testing.assert_allclose(book.bits, -np.log2([0.4, 0.3, 0.2, 0.1]), atol=1e-6)


def test_a_row_that_saves_less_than_it_takes_is_dropped():
    vectors = groups((400, 300, 200, 1))
    # One vector at distance 9 saves an error of 81.
    for row_bits, rows in ((100 / 0.05, 3), (60 / 0.05, 4), (1e9, 1)):
        assert len(train(vectors, row_bits=row_bits, start=CENTRES).rows) == rows


def test_the_first_row_stays_zero():
    vectors = groups((0, 300, 200, 100))
    book = train(vectors)
    assert not book.rows[0].any()
    assert len(book.rows) == 4


def test_weights_move_rows_and_decide_what_they_save():
    vectors = groups((400, 2, 2, 2))
    weights = np.where(np.arange(len(vectors)) < 400, 1.0, 1e-3)
    assert len(train(vectors, weights, row_bits=10 / 0.05).rows) == 1
    heavy = np.array([[9, 0, 0], [11, 0, 0]] * 50, np.float32)
    weights = np.tile([3.0, 1.0], 50)
    # Two rows save 150 of error, one and the zero row 9,000.
    book = train(heavy, weights, price=0.1, row_bits=3000.0)
    np.testing.assert_allclose(book.rows[1], [9.5, 0, 0], atol=1e-4)


def test_training_starts_from_given_rows():
    vectors = groups((400, 300, 200, 100))
    once = TrainingConfig(iterations=1)
    book = train(vectors, config=once, start=CENTRES)
    np.testing.assert_allclose(book.rows, CENTRES, atol=0.05)
    # No more rows than asked for.
    assert len(train(vectors, rows=2, config=once, start=CENTRES).rows) == 2


@pytest.mark.parametrize("rows", [1, 2, 32])
def test_vectors_of_zeros_need_one_row(rows):
    book = train(np.zeros((7, 3), np.float32), rows=rows)
    assert book.rows.tolist() == [[0, 0, 0]]
    assert book.bits.tolist() == [0]


def test_the_seed_decides_and_inputs_are_not_modified():
    vectors = np.random.default_rng(3).normal(size=(2000, 3)).astype(np.float32)
    before = vectors.copy()
    first, again = train(vectors), train(vectors)
    np.testing.assert_array_equal(first.rows, again.rows)
    other = train(vectors, config=TrainingConfig(iterations=12, seed=2))
    assert first.rows.shape != other.rows.shape or (first.rows != other.rows).any()
    np.testing.assert_array_equal(vectors, before)
