import numpy as np
import pytest

from cogsplat.codec.encode.profiles.chunk_streams import chunk_means
from cogsplat.codec.geometry import morton
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams import kinds, records
from cogsplat.codec.streams.records import Kind
from cogsplat.codec.streams.stream_inputs import Inputs


def read(stream, columns):
    (one,) = records.unpack(memoryview(records.pack([stream])), "chunk", 1 << 18)
    out = np.empty((one.rows, columns), np.float32)
    scales = np.zeros((one.rows, 3), np.float32)
    kinds.read(one, out, Inputs(scales=scales))
    return out


def cloud(seed, n=2000):
    return np.random.default_rng(seed).normal(size=(n, 3)).astype(np.float32) * np.float32(3)


@pytest.mark.parametrize("sort", [True, False])
@pytest.mark.parametrize("step", [1e-4, 0.03, 2.0, 1e3])
def test_means_come_back_in_the_order_that_is_returned(sort, step):
    means = cloud(1)
    rows, stream, decoded = chunk_means(means, step, sort)
    assert stream.kind == (Kind.SORTED if sort else Kind.SCALAR)
    assert sorted(rows.tolist()) == list(range(len(means)))
    if not sort:
        assert rows.tolist() == list(range(len(means)))
    assert read(stream, 3).tobytes() == decoded.tobytes()
    assert np.abs(decoded - means[rows]).max() <= step / 2 * (1 + 1e-5) + 1e-5


def test_both_ways_store_the_same_values():
    means = cloud(2)
    rows, stream, _decoded = chunk_means(means, 0.01, True)
    _, plain, _ = chunk_means(means, 0.01, False)
    assert read(stream, 3).tobytes() == read(plain, 3)[rows].tobytes()


def test_rows_are_in_morton_order_and_ties_in_the_given_one():
    means = np.repeat(cloud(3, 50), 4, axis=0)
    rows, _, _ = chunk_means(means, 0.01, True)
    grid = grids.fit(means, 0.01)
    keys = morton.interleave(grid.quantise(means))[rows]
    assert (np.diff(keys.astype(np.int64)) >= 0).all()
    for start in range(0, 200, 4):
        assert (np.diff(rows[start : start + 4]) == 1).all()


def test_sorting_pays():
    means = cloud(4, 4000)
    plain, ordered = (len(records.pack([chunk_means(means, 1e-3, s)[1]])) for s in (False, True))
    assert ordered < 0.85 * plain


@pytest.mark.parametrize("sort", [True, False])
def test_one_splat_and_equal_splats(sort):
    for n in (1, 7):
        means = np.full((n, 3), 1e7, np.float32)
        rows, stream, _decoded = chunk_means(means, 1e-9, sort)
        assert rows.tolist() == list(range(n))
        np.testing.assert_array_equal(read(stream, 3), means)


@pytest.mark.parametrize("sort", [True, False])
def test_steps_too_small_for_the_range_stop_at_what_an_axis_holds(sort):
    means = cloud(5)
    means[0] = [1e30, -1e30, 0]
    rows, stream, _decoded = chunk_means(means, 1e-30, sort)
    out = read(stream, 3)
    span = np.ptp(means.astype(np.float64), axis=0)
    error = np.abs(out.astype(np.float64) - means[rows]).max(axis=0)
    assert (error <= span / 2**22).all()
