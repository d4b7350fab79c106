import numpy as np
import pytest

from cogsplat.codec.order import octree


def split(means, rows, low, high, depth):
    """Assign rows to leaves by halving the box recursively, octant by octant."""
    if depth == 0:
        return [rows]
    middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    found = []
    for octant in range(8):
        upper = [bool(octant >> axis & 1) for axis in range(3)]
        inside = [
            row
            for row in rows
            if all((means[row][axis] >= middle[axis]) == upper[axis] for axis in range(3))
        ]
        low_, high_ = (
            [(m if up else a) for a, m, up in zip(low, middle, upper, strict=True)],
            [(b if up else m) for b, m, up in zip(high, middle, upper, strict=True)],
        )
        if inside:
            found += split(means, inside, low_, high_, depth - 1)
    return found


def naive_leaves(means, depth):
    points = means.astype(np.float64)
    return split(points, list(range(len(points))), points.min(0), points.max(0), depth)


def scene(n=400, seed=1):
    rng = np.random.default_rng(seed)
    means = (rng.normal(size=(n, 3)) * [3.0, 1.0, 0.3]).astype(np.float32)
    return means, rng.integers(0, 30, n) / 8.0


@pytest.mark.parametrize("depth", [0, 1, 3, 6])
def test_leaves_are_those_of_a_recursive_octree(depth):
    means, _ = scene()
    numbers = octree.leaves(means, depth)
    expected = naive_leaves(means, depth)
    assert len(expected) == len(set(numbers.tolist()))
    for rows in expected:
        assert len(set(numbers[rows].tolist())) == 1


@pytest.mark.parametrize("depth", [0, 2, 4])
def test_round_robin_takes_the_best_of_every_leaf_then_the_next(depth):
    means, values = scene()
    leaves = [sorted(rows, key=lambda r: (-values[r], r)) for rows in naive_leaves(means, depth)]
    numbers = octree.leaves(means, depth)
    leaves.sort(key=lambda rows: (-values[rows].sum(), numbers[rows[0]]))
    expected = []
    while any(leaves):
        expected += [rows.pop(0) for rows in leaves if rows]
    assert octree.round_robin(numbers, values).tolist() == expected


@pytest.mark.parametrize("depth", [0, 2, 4])
def test_quota_gives_every_leaf_its_share(depth):
    means, values = scene()
    keys = {}
    for rows in naive_leaves(means, depth):
        for rank, row in enumerate(sorted(rows, key=lambda r: (-values[r], r))):
            keys[row] = ((rank + 0.5) / len(rows), -values[row], row)
    numbers = octree.leaves(means, depth)
    assert octree.quota(numbers, values).tolist() == sorted(keys, key=keys.__getitem__)


def test_depth_0_is_the_order_by_contribution():
    means, values = scene()
    expected = np.argsort(-values, kind="stable")
    numbers = octree.leaves(means, 0)
    np.testing.assert_array_equal(octree.round_robin(numbers, values), expected)
    np.testing.assert_array_equal(octree.quota(numbers, values), expected)


def test_flat_scenes_single_splats_and_lost_means_have_leaves():
    flat = np.array([[0, 1, 2], [4, 1, 2], [1, 1, 2]], np.float32)
    numbers = octree.leaves(flat, octree.MAX_DEPTH)
    assert numbers[0] == 0
    assert len(set(numbers.tolist())) == 3
    assert octree.leaves(flat[:1], 5).tolist() == [0]
    assert octree.leaves(flat[:0], 5).tolist() == []
    flat[1, 0] = np.nan
    assert octree.leaves(flat, 3)[1] == 0
    with pytest.raises(ValueError, match="expected 0 to"):
        octree.leaves(flat, 21)


def split_by_capacity(points, rows, low, high, capacity):
    """Assign rows to leaves by halving boxes with more than `capacity` points."""
    if len(rows) <= capacity:
        return [rows] if rows else []
    middle = (low + high) / 2
    found = []
    for octant in range(8):
        upper = np.array([bool(octant >> axis & 1) for axis in range(3)])
        inside = [row for row in rows if ((points[row] >= middle) == upper).all()]
        found += split_by_capacity(
            points, inside, np.where(upper, middle, low), np.where(upper, high, middle), capacity
        )
    return found


@pytest.mark.parametrize("capacity", [1, 7, 50, 1000])
def test_adaptive_leaves_are_those_of_a_recursive_octree(capacity):
    means, _ = scene()
    points = means.astype(np.float64)
    numbers = octree.adaptive_leaves(means, capacity)
    expected = split_by_capacity(
        points, list(range(len(points))), points.min(0), points.max(0), capacity
    )
    assert len(expected) == len(set(numbers.tolist()))
    for rows in expected:
        assert len(set(numbers[rows].tolist())) == 1


def test_equal_means_share_an_adaptive_leaf():
    means = np.array([[1, 2, 3]] * 5 + [[4, 4, 4]], np.float32)
    numbers = octree.adaptive_leaves(means, 2)
    assert len(set(numbers[:5].tolist())) == 1
    assert numbers[5] != numbers[0]
    with pytest.raises(ValueError, match="capacity 0"):
        octree.adaptive_leaves(means, 0)
