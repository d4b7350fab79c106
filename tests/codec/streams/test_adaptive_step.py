import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams import adaptive_step
from cogsplat.codec.streams.adaptive_step import (
    MAX_COEFFICIENT,
    MAX_EXTRA_BITS,
    MODEL_BYTES,
    StepModel,
)

f32 = np.float32


def plain_halvings(coefficients, scales):
    """SPEC 6.10, one float32 operation at a time."""
    m, t, l = (f32(value) for value in scales)  # noqa: E741 - as the clause names them
    p, q = f32(l - m), f32(m - t)
    features = [l, min(p, f32(1.5)), min(p, f32(5)), min(q, f32(0.5)), min(q, f32(3))]
    total = f32(coefficients[0])
    for coefficient, feature in zip(coefficients[1:], features, strict=True):
        total = f32(total + f32(f32(coefficient) * feature))
    return min(max(math.floor(total), 0), MAX_EXTRA_BITS)


def shapes(rng, rows, spread=1.5):
    """Log scales: middle, thin, long."""
    scales = np.sort(rng.normal(-4, spread, (rows, 3)), axis=1)[:, [1, 0, 2]]
    return scales.astype(f32)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(
    st.lists(st.floats(-8, 8, width=32), min_size=6, max_size=6),
    st.integers(0, 2**32 - 1),
)
def test_halvings_follow_the_clause_bit_for_bit(coefficients, seed):
    rng = np.random.default_rng(seed)
    # Sorted or not: a hostile file's scales are in any order.
    scales = rng.normal(0, 2, (40, 3)).astype(f32)
    found = StepModel(tuple(coefficients)).extra_bits(scales)
    assert found.dtype == np.uint8
    assert found.tolist() == [plain_halvings(coefficients, row) for row in scales]


def test_halvings_turn_at_whole_sums():
    scales = np.zeros((1, 3), f32)
    for whole in range(-2, MAX_EXTRA_BITS + 3):
        for step, expected in ((-1, whole - 1), (0, whole), (1, whole)):
            value = f32(whole)
            if step:
                value = np.nextafter(value, f32(step * np.inf), dtype=f32)
            (found,) = StepModel((float(value), 0, 0, 0, 0, 0)).extra_bits(scales)
            assert found == min(max(expected, 0), MAX_EXTRA_BITS)


@pytest.mark.parametrize("sign", [-1, 1])
def test_the_largest_coefficients_and_scales_stay_finite(sign):
    ends = f32([-3 * 2.0**100, -(2.0**100), 0, 2.0**100])
    scales = np.stack(np.meshgrid(ends, ends, ends), axis=-1).reshape(-1, 3)
    coefficients = (sign * MAX_COEFFICIENT,) * 6
    found = StepModel(coefficients).extra_bits(scales)
    assert found.tolist() == [plain_halvings(coefficients, row) for row in scales]


def test_a_resolution_comes_back_and_no_rows_have_no_halvings():
    given_one = StepModel(tuple(float(f32(value)) for value in (0.1, -2, 3e5, -1e6, 1e-30, -0.0)))
    packed = given_one.pack()
    assert len(packed) == MODEL_BYTES == 24
    assert packed == struct.pack("<6f", *given_one.coefficients)
    assert adaptive_step.unpack(memoryview(packed), "here") == given_one
    assert given_one.extra_bits(np.zeros((0, 3), f32)).shape == (0,)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1.01e6, -1.01e6, 3e38])
@pytest.mark.parametrize("place", range(6))
def test_coefficients_out_of_range_are_refused(value, place):
    coefficients = [1.0] * 6
    coefficients[place] = value
    with pytest.raises(FormatError, match="chunk 2") as caught:
        adaptive_step.unpack(memoryview(struct.pack("<6f", *coefficients)), "chunk 2")
    assert (caught.value.code, caught.value.clause) == ("step-model", "6.10")


def spent(found, scales, sensitivity, base):
    steps = base * 2.0 ** -found.extra_bits(scales).astype(float)
    return float((sensitivity * steps**2).mean())


def test_a_fit_spends_the_slope_on_average():
    rng = np.random.default_rng(3)
    scales = shapes(rng, 4000, spread=0.8)
    for power, base in ((2, 2.0), (1, 0.5), (0, 1.0)):
        sizes = scales[:, 2].astype(float)
        sensitivity = np.exp(-power * sizes) * rng.lognormal(0, 0.5, 4000)
        slope = float(np.median(sensitivity)) * base**2 / 2.0**14
        found = adaptive_step.fit(scales, sensitivity, slope, base)
        assert spent(found, scales, sensitivity, base) == pytest.approx(slope, rel=0.15)


def test_a_fit_makes_sensitive_shapes_finer():
    rng = np.random.default_rng(4)
    scales = shapes(rng, 3000)
    flatness = (scales[:, 2] - scales[:, 1]).astype(float)
    sensitivity = 1e-2 * np.exp(1.2 * np.minimum(flatness, 4))
    found = adaptive_step.fit(scales, sensitivity, 1e-5, 2.0)
    halvings = found.extra_bits(scales).astype(float)
    wanted = 0.5 * np.log2(sensitivity * 4 / 1e-5)
    assert np.corrcoef(halvings, wanted)[0, 1] > 0.9
    # And spends less than one step for all that costs as much.
    equal = 2.0 * 2.0 ** -halvings.mean()
    assert spent(found, scales, sensitivity, 2.0) < (sensitivity * equal**2).mean()


@pytest.mark.parametrize("rows", [1, 2, 100])
@pytest.mark.parametrize("sensitivity", [1e-300, 1e-30, 1e-3, 1.0, 1e30, 1e200])
def test_equal_rows_get_the_halvings_they_ask_for(rows, sensitivity):
    scales = np.tile(np.array([[-4.5, -6, -3.25]], f32), (rows, 1))
    found = adaptive_step.fit(scales, np.full(rows, sensitivity), 1e-9, 2.0)
    assert adaptive_step.unpack(memoryview(found.pack()), "here") == found
    wanted = min(max(0.5 * math.log2(sensitivity * 4 / 1e-9), 0), MAX_EXTRA_BITS)
    assert np.abs(found.extra_bits(scales) - wanted).max() <= 1


@pytest.mark.parametrize("scale", [-40.0, 0.0, 40.0])
def test_round_and_extreme_shapes_have_a_fit(scale):
    scales = np.full((50, 3), scale, f32)
    scales[::7, 1] = -40
    found = adaptive_step.fit(scales, np.geomspace(1e-9, 1e3, 50), 1e-7, 2.0)
    assert np.isfinite(found.coefficients).all()
    assert adaptive_step.unpack(memoryview(found.pack()), "here") == found
