import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.rate import refinement_split
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams import records, refinement_digits, scalar
from cogsplat.codec.streams.records import Attribute, Kind


def normal(rows=4000, columns=3, seed=1):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(rows, columns)).astype(np.float32)


def split(values, step, most=(16, 16, 16), weights=None):
    grid = grids.fit(values, step)
    weights = np.ones(len(values)) if weights is None else weights
    return grid, refinement_split.split(Attribute.SH0, values, grid, weights, most)


def digits_of(stream):
    (stored,) = records.unpack(memoryview(records.pack([stream])), "x", stream.rows)
    return stored


@pytest.mark.parametrize("step", [0.003, 0.02, 0.2])
def test_refined_values_have_the_requested_step_and_the_head_is_coarse(step):
    values = normal()
    grid, parts = split(values, step)
    assert np.abs(parts.fine - values).max() <= 0.5001 * grid.step.max()
    assert parts.digits is not None
    assert parts.digits.kind == Kind.DIGITS
    assert (parts.grid.levels * 2 <= grid.levels + 16).all()
    # The coarse values lie on the head's grid, each at the mean of its fine values.
    assert np.array_equal(parts.grid.dequantise(parts.grid.quantise(parts.coarse)), parts.coarse)
    missed = parts.fine - parts.coarse
    assert np.abs(missed.mean(axis=0)).max() < 0.02 * np.abs(missed).max()


def test_the_radix_is_limited():
    values = normal()
    for most in ((1, 2, 3), (4, 1, 1), (1, 1, 1)):
        _, parts = split(values, 0.01, most)
        if parts.digits is None:
            assert max(most) == 1
            assert parts.fine is parts.coarse
            continue
        radices = parts.digits.params[-3:]
        assert all(r <= m for r, m in zip(radices, most, strict=True))
        assert len(parts.digits.planes) == sum(r > 1 for r in radices)


def test_values_that_are_mostly_zero_are_not_split():
    values = np.where(normal(seed=2) > 2.5, 3.0, 0.0).astype(np.float32)
    _, parts = split(values, 0.5)
    assert parts.digits is None


def test_a_split_costs_few_bytes():
    values = normal(20_000)
    grid, parts = split(values, 0.05, (8, 8, 8))
    whole = records.pack([scalar.write(Attribute.SH0, values, grid)])
    head = records.pack([scalar.write(Attribute.SH0, parts.coarse, parts.grid)])
    below = records.pack([parts.digits])
    assert len(head) + len(below) < 1.04 * len(whole)
    assert len(head) < 0.7 * len(whole)


def test_rows_move_together():
    _, parts = split(normal(), 0.01)
    order = np.random.default_rng(3).permutation(4000)
    moved = parts.take(order)
    assert np.array_equal(moved.coarse, parts.coarse[order])
    assert np.array_equal(moved.fine, parts.fine[order])
    assert parts.digits is not None
    assert moved.digits is not None
    for plane, other in zip(moved.digits.planes, parts.digits.planes, strict=True):
        assert np.array_equal(plane, other[order])


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.integers(1, 40), st.floats(1e-6, 10), st.integers(1, 16), st.integers(0, 1000))
def test_any_values_come_back(rows, step, most, seed):
    values = normal(rows, 3, seed) * np.array([1, 0, 100], np.float32)
    grid, parts = split(values, step, (most,) * 3)
    bound = 0.501 * np.maximum(grid.step, step) + 1e-4
    assert (np.abs(parts.fine - values) <= bound).all()
    assert np.isfinite(parts.coarse).all()
    assert (parts.grid.minimum <= parts.grid.maximum).all()


def test_values_are_not_split_where_their_codes_do_not_come_back():
    # Float32 holds few values in so small a range, and a grid of 2^24 levels many more.
    values = np.repeat(np.float32([39.991257, 39.995628, 40.0]), [8, 4, 18])[:, None]
    for radix in range(2, 17):
        _, parts = split(values, 1e-12, (radix,))
        codes = parts.grid.quantise(parts.coarse).astype(np.int64)
        if parts.digits is not None:
            stored = digits_of(parts.digits)
            grid, (radix,) = refinement_digits.parse(stored, 1)
            codes = codes * radix + stored.plane(0, stored.rows)[:, None]
            assert (codes < grid.levels).all()
        assert np.abs(parts.fine - values).max() < 1e-5
