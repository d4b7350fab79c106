import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams.grid import ENTRY_BYTES, MAX_LEVELS, MAX_VALUE, Grid, fit

checked = settings(derandomize=True, deadline=None, max_examples=150)
finite = st.floats(-1e6, 1e6, width=32)


def one(minimum, maximum, levels):
    return Grid(
        np.array([minimum], np.float32),
        np.array([maximum], np.float32),
        np.array([levels], np.uint32),
    )


def decoded(minimum, maximum, levels, code):
    """SPEC 6.4, one float32 operation at a time."""
    low, high = np.float32(minimum), np.float32(maximum)
    step = np.float32(0)
    if levels > 1:
        step = np.float32(np.float32(high - low) / np.float32(np.float32(levels) - np.float32(1)))
    return np.float32(np.float32(np.float32(code) * step) + low)


@checked
@given(finite, finite, st.integers(1, MAX_LEVELS), st.floats(0, 1))
def test_decoding_is_float32_in_the_documented_order(a, b, levels, share):
    low, high = min(a, b), max(a, b)
    code = round(share * (levels - 1))
    actual = one(low, high, levels).dequantise(np.array([[code]], np.uint32))
    assert actual.dtype == np.float32
    assert actual[0, 0].tobytes() == decoded(low, high, levels, code).tobytes()


@checked
@given(st.lists(finite, min_size=1, max_size=30), st.floats(1e-6, 1e6))
def test_decoded_values_are_within_half_a_step(values, step):
    source = np.array(values, np.float32)[:, None]
    grid = fit(source, step)
    actual = grid.dequantise(grid.quantise(source)).astype(np.float64)
    span = float(source.max()) - float(source.min())
    if int(grid.levels[0]) < MAX_LEVELS:
        assert float(grid.step[0]) <= step * (1 + 2.0**-19)
    # The step's own rounding grows with the code, then one product and one sum are rounded.
    rounding = 2.0**-22 * (span + np.abs(source).max())
    half = (step / 2 if int(grid.levels[0]) == 1 else float(grid.step[0])) / 2
    assert np.abs(actual - source).max() <= half * (1 + 2.0**-19) + rounding


@checked
@given(st.lists(finite, min_size=1, max_size=30), st.floats(1e-6, 1e6))
def test_the_nearest_level_is_chosen(values, step):
    source = np.array(values, np.float32)[:, None]
    grid = fit(source, step)
    codes = grid.quantise(source).astype(np.int64)
    levels = int(grid.levels[0])
    low, width = float(grid.minimum[0]), float(grid.step[0])
    chosen = np.abs(low + codes * width - source)
    for other in (-1, 1):
        near = np.clip(codes + other, 0, levels - 1)
        assert (chosen <= np.abs(low + near * width - source) * (1 + 1e-12)).all()


def test_the_ends_are_levels():
    values = np.array([[-1.25, 3.0], [0.5, -7.5], [8.0, 1.0]], np.float32)
    grid = fit(values, np.array([0.3, 0.01]))
    codes = grid.quantise(values)
    np.testing.assert_array_equal(codes.min(axis=0), [0, 0])
    np.testing.assert_array_equal(codes.max(axis=0), grid.levels - 1)
    np.testing.assert_array_equal(grid.minimum, [-1.25, -7.5])
    np.testing.assert_array_equal(grid.maximum, [8.0, 3.0])
    assert grid.levels.tolist() == [32, 1051]


def test_values_outside_are_clamped():
    grid = one(-1.0, 1.0, 5)
    codes = grid.quantise(np.array([[-1e30], [-1.1], [1.1], [1e30]], np.float32))
    assert codes[:, 0].tolist() == [0, 0, 4, 4]


def test_a_span_below_half_a_step_is_a_constant_in_its_middle():
    values = np.array([[1.0], [1.25]], np.float32)
    grid = fit(values, 0.6)
    assert (grid.levels[0], grid.minimum[0], grid.maximum[0]) == (1, 1.125, 1.125)
    assert grid.step[0] == 0
    np.testing.assert_array_equal(grid.dequantise(grid.quantise(values)), [[1.125], [1.125]])
    assert fit(values, 0.5).levels[0] == 2


@pytest.mark.parametrize("value", [0.0, -3.5, 1e-45, 1e-38, 1e30])
def test_a_constant_is_kept_exactly(value):
    values = np.full((4, 1), value, np.float32)
    grid = fit(values, 1e-6)
    assert grid.levels[0] == 1
    np.testing.assert_array_equal(grid.dequantise(grid.quantise(values)), values)


def test_denormal_spans_neither_divide_by_zero_nor_leave_the_range():
    values = np.array([[0.0], [1e-45], [7e-45], [3e-44]], np.float32)
    for step in (1e-60, 1e-45, 1e-44):
        grid = fit(values, step)
        out = grid.dequantise(grid.quantise(values))
        assert float(np.abs(out - values).max()) <= 3e-44


def test_a_step_too_small_for_the_range_is_widened():
    values = np.array([[-(2.0**100)], [2.0**100]], np.float32)
    grid = fit(values, 1e-30)
    assert grid.levels[0] == MAX_LEVELS
    out = grid.dequantise(grid.quantise(values))
    np.testing.assert_allclose(out, values, rtol=2.0**-22)
    assert np.isfinite(out).all()


@pytest.mark.parametrize("step", [0.0, -1.0, float("nan")])
def test_steps_not_above_zero_are_refused(step):
    with pytest.raises(ValueError, match="expected more than 0"):
        fit(np.zeros((1, 1), np.float32), step)


def test_every_code_of_the_largest_grid_is_exact_in_float32():
    edge = np.array([MAX_LEVELS - 1, MAX_LEVELS - 2, MAX_LEVELS // 2 + 1], np.uint32)
    assert edge.astype(np.float32).astype(np.uint32).tolist() == edge.tolist()


@checked
@given(finite, finite, st.integers(1, MAX_LEVELS))
def test_entries_come_back_bit_for_bit(a, b, levels):
    grid = one(min(a, b), max(a, b), levels)
    data = grid.pack()
    assert data == struct.pack("<ffI", min(a, b), max(a, b), levels)
    assert len(data) == ENTRY_BYTES
    back = grids.unpack(memoryview(data), 1, "here")
    assert back.pack() == data


@pytest.mark.parametrize(
    ("entry", "code"),
    [
        ((float("nan"), 1.0, 2), "grid-value"),
        ((0.0, float("nan"), 2), "grid-value"),
        ((float("-inf"), 1.0, 2), "grid-value"),
        ((0.0, float("inf"), 2), "grid-value"),
        ((-1.1 * MAX_VALUE, 0.0, 2), "grid-value"),
        ((0.0, 1.1 * MAX_VALUE, 2), "grid-value"),
        ((1.0, 0.5, 2), "grid-value"),
        ((0.0, 1.0, 0), "grid-levels"),
        ((0.0, 1.0, MAX_LEVELS + 1), "grid-levels"),
        ((0.0, 1.0, 2**32 - 1), "grid-levels"),
    ],
)
def test_entries_that_break_the_rules_are_refused(entry, code):
    good = struct.pack("<ffI", 0, 1, 2)
    for data in (struct.pack("<ffI", *entry) + good, good + struct.pack("<ffI", *entry)):
        with pytest.raises(FormatError, match="chunk 7") as caught:
            grids.unpack(memoryview(data), 2, "chunk 7")
        assert (caught.value.code, caught.value.clause) == (code, "6.4")


def test_a_lower_limit_of_levels_is_kept():
    data = memoryview(struct.pack("<ffI", 0, 1, 100))
    assert grids.unpack(data, 1, "here", 100).levels[0] == 100
    with pytest.raises(FormatError, match="expected 1 to 99"):
        grids.unpack(data, 1, "here", 99)
