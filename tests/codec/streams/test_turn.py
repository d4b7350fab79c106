import math

import numpy as np
import oracle
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.streams import swing_twist

pytestmark = pytest.mark.usefixtures("arithmetic")

f32 = np.float32
checked = settings(derandomize=True, deadline=None, max_examples=100)


def unit_quats(seed, rows):
    quats = np.random.default_rng(seed).normal(size=(rows, 4))
    return (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(f32)


def covariance(quat, scales):
    spread = oracle.rotation_matrix(quat) * np.exp(scales.astype(np.float64))
    return spread @ spread.T


def composed(turns):
    """(1, a, b, 0) · (1, 0, 0, c) in double, normalised."""
    a, b, c = turns.astype(np.float64).T
    one = np.ones_like(a)
    quats = np.stack([one, a + b * c, b - a * c, c], axis=1)
    return quats / np.linalg.norm(quats, axis=1, keepdims=True)


def check_canonical(quats, scales):
    turns, named = swing_twist.canonical(quats, scales)
    a, b, c = turns.T
    assert np.isfinite(turns).all()
    assert (a * a + b * b).max(initial=0) <= 1 + 1e-6
    assert np.abs(c).max(initial=0) <= 1 + 1e-6
    ascending = np.sort(scales, axis=1)
    assert named.tobytes() == np.ascontiguousarray(ascending[:, [1, 0, 2]]).tobytes()
    back = composed(turns)
    for row in range(len(quats)):
        expected = covariance(quats[row], scales[row])
        found = covariance(back[row], named[row])
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-6 * np.trace(expected))
    return turns


def test_every_gaussian_has_a_name_that_is_the_same_ellipsoid():
    rng = np.random.default_rng(1)
    check_canonical(unit_quats(1, 500), rng.normal(-1, 1, (500, 3)).astype(f32))


def test_half_turns_and_axes_have_a_name():
    root = math.sqrt(0.5)
    quats = [np.eye(4)[axis] * sign for axis in range(4) for sign in (1, -1)]
    for first in range(4):
        for second in range(first):
            for sign in (1, -1):
                quat = np.zeros(4)
                quat[first], quat[second] = root, sign * root
                quats.append(quat)
    quats += [
        np.array([0.5, x, y, z]) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)
    ]
    for scales in ([0, -1, -2], [-2, 0, -1], [-1, -2, 0], [0, 0, -1], [-1, 0, 0], [0, 0, 0]):
        check_canonical(np.array(quats, f32), np.tile(np.array(scales, f32), (len(quats), 1)))


def test_no_rows_have_no_turns():
    turns, scales = swing_twist.canonical(np.empty((0, 4), f32), np.empty((0, 3), f32))
    assert (turns.shape, scales.shape) == ((0, 3), (0, 3))
    assert swing_twist.quats_of(turns.astype(f32)).shape == (0, 4)


def plain_quat(a, b, c):
    """SPEC 6.11, one float32 operation at a time."""
    w, x, y, z = f32(1), f32(a + f32(b * c)), f32(b - f32(a * c)), c
    total = f32(f32(f32(f32(w * w) + f32(x * x)) + f32(y * y)) + f32(z * z))
    norm = f32(np.sqrt(total))
    return [f32(value / norm) for value in (w, x, y, z)]


@checked
@given(st.lists(st.tuples(*[st.floats(-1, 1, width=32)] * 3), max_size=30))
def test_turns_become_quats_in_the_documented_order(values):
    turns = np.array(values, f32).reshape(-1, 3)
    out = swing_twist.quats_of(turns)
    expected = np.array([plain_quat(*row) for row in turns], f32).reshape(-1, 4)
    assert out.tobytes() == expected.tobytes()
    assert (out[:, 0] > 0).all()
    np.testing.assert_allclose(out, composed(turns), atol=3e-7)


@pytest.mark.parametrize("halvings", range(16))
def test_codes_are_within_half_a_step(halvings):
    values = np.append(np.random.default_rng(halvings).uniform(-1, 1, 500), [-1, 0, 1])
    wide = np.full(len(values), halvings, np.uint8)
    codes = swing_twist.quantise(values, wide)
    assert codes.max() <= 1 << halvings
    out = swing_twist.dequantise(codes, wide)
    if halvings == 0:
        assert not codes.any()
        assert not out.any()
        return
    step = 2.0 ** (1 - halvings)
    assert np.abs(out - values).max() <= step / 2 + 2.0**-24
    assert out[-3:].tolist() == [-1, 0, 1]
    expected = [f32(f32(f32(code) * f32(step)) - f32(1)) for code in codes]
    assert out.tobytes() == np.array(expected, f32).tobytes()


def test_values_a_little_beyond_their_ends_are_clamped():
    wide = np.array([1, 4, 9, 15, 1, 4, 9, 15], np.uint8)
    values = np.array([-1.2] * 4 + [1.2] * 4)
    out = swing_twist.dequantise(swing_twist.quantise(values, wide), wide)
    assert out.tolist() == [-1] * 4 + [1] * 4


@checked
@given(st.lists(st.integers(0, 15), max_size=40), st.integers(0, 2**32 - 1))
def test_codes_split_into_symbols_and_plain_bits(halvings, seed):
    rng = np.random.default_rng(seed)
    wide = np.array(halvings, np.uint8)
    codes = np.array([rng.integers(0, (1 << h) + 1) if h else 0 for h in halvings], np.uint32)
    planes, rest = swing_twist.split(codes, wide)
    # SPEC 6.11: a plane for each min(h, 6) that occurs, the lowest first, then the low bits.
    present = sorted({min(h, 6) for h in halvings} - {0})
    assert len(planes) == len(present) == len(swing_twist.groups(wide))
    for group, plane in zip(present, planes, strict=True):
        rows = [row for row, h in enumerate(halvings) if min(h, 6) == group]
        expected = [int(codes[row]) >> max(halvings[row] - 6, 0) for row in rows]
        assert plane.tolist() == expected
        assert plane.max() <= 1 << group
    number, total = 0, 0
    for code, h in zip(codes.tolist(), halvings, strict=True):
        spare = max(h - 6, 0)
        number |= (code & ((1 << spare) - 1)) << total
        total += spare
    assert rest.tobytes() == number.to_bytes(-(-total // 8), "little")
    assert swing_twist.rest_bytes(wide) == len(rest)
    assert swing_twist.join(planes, rest, wide, "here").tolist() == codes.tolist()
