from itertools import product

import numpy as np
import pytest

from cogsplat.codec.rate.sparse_codes import choose_codes
from cogsplat.codec.streams import records, shn_transform

SHRINK = 0.05


def positions_of(rows=400, width=12, seed=1):
    rng = np.random.default_rng(seed)
    return rng.laplace(size=(rows, width)) * np.geomspace(3, 0.3, width)


def error(positions, codes):
    decoded = np.sign(codes) * np.maximum(np.abs(codes) - SHRINK, 0)
    return np.square(positions - decoded).sum(axis=1)


def size(codes):
    return len(records.pack([shn_transform.write(codes, 0, 1.0, SHRINK)]))


def chosen(positions, costs=None, price=0.2):
    costs = np.ones(len(positions)) if costs is None else costs
    rounded = np.rint(positions).astype(np.int64)
    return choose_codes(positions, costs, price, SHRINK, rounded)


def test_codes_miss_less_than_larger_steps_of_as_many_bytes():
    positions = positions_of(rows=4000)
    codes, coarse = chosen(positions, price=0.3), np.rint(positions / 1.1).astype(np.int64)
    assert size(codes) < 1.001 * size(coarse) < size(np.rint(positions).astype(np.int64))
    assert error(positions, codes).sum() < 0.97 * 1.1**2 * error(positions / 1.1, coarse).sum()


def test_bits_that_cost_nothing_leave_the_nearest_codes():
    positions = positions_of()
    codes = chosen(positions, price=0.0)
    every = [chosen(positions, price=0.0) + move for move in (-1, 1)]
    assert all((error(positions, codes) <= error(positions, other)).all() for other in every)


def test_splats_that_show_less_get_fewer_codes():
    positions = np.tile(positions_of(200), (2, 1))
    codes = chosen(positions, np.repeat([4.0, 0.2], 200))
    assert (codes[:200] != 0).sum() > 1.2 * (codes[200:] != 0).sum()
    assert (np.abs(codes[:200]) >= np.abs(codes[200:])).mean() > 0.98


def test_no_other_codes_cost_less():
    """Of all candidates of a splat, bits by the frequencies of rounded codes."""
    positions = positions_of(rows=60, width=3)
    rounded = np.rint(positions).astype(np.int64)
    price = 0.3

    def symbols(column):
        return [2 * k - 1 if k > 0 else -2 * k for k in column]

    def bits(counts, value):
        return np.log2(sum(counts.values()) + 0.5) - np.log2(max(counts.get(value, 0), 0.5))

    def count(values):
        return {v: values.count(v) for v in values}

    def end(row):
        return max((place + 1 for place, code in enumerate(row) if code), default=0)

    rows = rounded.tolist()
    ends = count([end(row) for row in rows])
    inner = [count(symbols([row[j] for row in rows if end(row) > j + 1])) for j in range(3)]
    last = [count(symbols([row[j] for row in rows if end(row) == j + 1])) for j in range(3)]

    def cost(position, row):
        total = error(position[None], np.array([row]))[0] + 0.5 * price * bits(ends, end(row))
        for j, symbol in enumerate(symbols(row[: end(row)])):
            of = last if j + 1 == end(row) else inner
            total += 0.5 * price * bits(of[j], symbol)
        return total

    for position, row in zip(positions, chosen(positions, price=price).tolist(), strict=True):
        options = []
        for value in position:
            near, sign = int(np.rint(abs(value))), -1 if value < 0 else 1
            options.append({0, sign * near, sign * max(near - 1, 0)})
        least = min(cost(position, list(other)) for other in product(*options))
        assert cost(position, row) == pytest.approx(least)


def test_large_codes_and_no_codes():
    large = np.array([[3e6, -2e6], [0.1, 5e5], [0.0, 0.0]])
    assert (np.abs(chosen(large) - large) <= 1.5).all()
    assert chosen(np.zeros((0, 3))).shape == (0, 3)
    assert chosen(np.zeros((4, 3))).tolist() == [[0, 0, 0]] * 4
