import math
import struct

import numpy as np
import pytest
from heads import decode
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.errors import FormatError
from cogsplat.codec.geometry import morton
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams import scale_differences, sorted_means
from cogsplat.codec.streams.adaptive_step import MAX_EXTRA_BITS, StepModel
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import Attribute, Kind, Stream

f32 = np.float32
code51 = st.integers(0, 2**51 - 1)
checked = settings(derandomize=True, deadline=None, max_examples=100)
# Extra bits equal the long axis' log scale, which differences of whole numbers store exactly.
BY_LONG = StepModel((0.0, 1.0, 0.0, 0.0, 0.0, 0.0))


def sized(halvings):
    """A differences stream of scales that give these extra bits."""
    steps = np.zeros((len(halvings), 3), f32)
    steps[:, 0] = halvings
    level = np.array([16, 1, 1], np.uint32)
    grid = Grid(np.zeros(3, f32), np.array([15, 0, 0], f32), level)
    return scale_differences.write(steps, grid)


def grid_of(step, levels, minimum=(-3.0, 0.5, 100.0)):
    low = np.array(minimum, f32)
    high = (low + (np.array(levels, float) - 1) * step).astype(f32)
    return Grid(low, high, np.array(levels, np.uint32))


def encoded(means, grid, halvings):
    """A sorted stream, its scales, the order and the codes in it."""
    codes = sorted_means.quantise(means, grid, halvings)
    order = sorted_means.morton_order(codes, halvings)
    stream = sorted_means.write(codes[order], grid, halvings[order], BY_LONG)
    return stream, sized(halvings[order]), order, codes[order]


def changed(stream, **changes):
    values = {name: getattr(stream, name) for name in stream.__dataclass_fields__} | changes
    return Stream(**values)


def plain_mean(code, halvings, step, minimum):
    """SPEC 6.5, one float32 operation at a time."""
    fine = f32(step * f32(2.0**-halvings))
    return f32(f32(f32(code) * fine) + minimum)


@checked
@given(
    st.lists(st.integers(0, 10), min_size=1, max_size=60),
    st.sampled_from([2.0**-6, 0.25, 1.0, 0.1]),
    st.integers(0, 2**32 - 1),
)
def test_means_are_within_half_of_their_own_step(halvings, step, seed):
    wide = np.array(halvings, np.uint8)
    grid = grid_of(step, (200, 1000, 77))
    rng = np.random.default_rng(seed)
    low, high = grid.minimum.astype(float), grid.maximum.astype(float)
    means = rng.uniform(low, high, (len(wide), 3)).astype(f32)
    stream, scales, order, _ = encoded(means, grid, wide)
    out = decode(scales, stream).means
    own = step * 2.0 ** -wide[order].astype(float)
    ulp = np.spacing(np.abs(grid.maximum)).astype(float) * 3
    error = np.abs(out.astype(float) - means[order])
    # The float32 step is off by half an ulp of it, a thousand levels away from the minimum.
    drift = 1000 * np.spacing(f32(step)).astype(float)
    assert (error <= own[:, None] / 2 + ulp + drift).all()


@checked
@given(st.lists(st.integers(0, MAX_EXTRA_BITS), min_size=1, max_size=40), st.integers(0, 2**32 - 1))
def test_means_decode_in_the_documented_order(halvings, seed):
    wide = np.array(halvings, np.uint8)
    rng = np.random.default_rng(seed)
    grid = Grid(
        np.array([-7.3, 0.1, -0.0], f32),
        np.array([9.1, 0.7, 0], f32),
        np.array([40_000, 65_536, 1], np.uint32),
    )
    coarse = rng.integers(0, grid.levels, (len(wide), 3))
    low = rng.integers(0, 1 << wide.astype(int)[:, None], (len(wide), 3))
    codes = (coarse << wide.astype(int)[:, None] | low).astype(np.int64)
    order = sorted_means.morton_order(codes, wide)
    stream = sorted_means.write(codes[order], grid, wide[order], BY_LONG)
    out = decode(sized(wide[order]), stream).means
    step = [f32(f32(9.1) - f32(-7.3)) / f32(39_999), f32(f32(0.7) - f32(0.1)) / f32(65_535), f32(0)]
    for place, row in enumerate(order):
        expected = [
            plain_mean(int(codes[row, axis]), int(wide[row]), f32(step[axis]), grid.minimum[axis])
            for axis in range(3)
        ]
        assert out[place].tobytes() == np.array(expected, f32).tobytes()


def plain_key(cell):
    """Morton code of a cell, bit by bit."""
    return sum(
        (int(cell[axis]) >> bit & 1) << (3 * bit + axis) for bit in range(17) for axis in range(3)
    )


def test_rows_follow_the_morton_order_of_their_cells_and_ties_stay():
    rng = np.random.default_rng(1)
    wide = rng.integers(0, 6, 300).astype(np.uint8)
    grid = grid_of(1.0, (6, 5, 4), (0, 0, 0))
    codes = sorted_means.quantise(rng.uniform(0, 4, (300, 3)).astype(f32), grid, wide)
    order = sorted_means.morton_order(codes, wide)
    keys = [plain_key(codes[row] >> wide[row]) for row in range(300)]
    assert order.tolist() == sorted(range(300), key=lambda row: keys[row])


def test_codes_stay_inside_the_grid():
    grid = grid_of(0.5, (4, 4, 4), (0, 0, 0))
    means = np.array([[-9, 0, 99], [1.5, 1.74, 1.76]], f32)
    for halvings in (0, 1, 5):
        wide = np.full(2, halvings, np.uint8)
        codes = sorted_means.quantise(means, grid, wide)
        assert (codes >> halvings).max() <= 3
        assert codes[0].tolist() == [0, 0, (4 << halvings) - 1]


@pytest.mark.parametrize("halvings", [0, 7, 15])
def test_one_splat_and_equal_ones_come_back(halvings):
    for rows in (1, 50):
        means = np.tile(np.array([[1.25, -3, 8]], f32), (rows, 1))
        grid = Grid(means[0], means[0], np.ones(3, np.uint32))
        stream, scales, order, _ = encoded(means, grid, np.full(rows, halvings, np.uint8))
        assert order.tolist() == list(range(rows))
        assert (decode(scales, stream).means == means).all()


def test_the_largest_codes_are_read():
    """32 bits of code and 45 of field; a file may have them though no encoder writes them."""
    levels = sorted_means.MAX_CELLS
    grid = Grid(np.zeros(3, f32), np.full(3, levels - 1, f32), np.full(3, levels, np.uint32))
    cells = np.full((2, 3), levels - 1, np.uint32)
    cells[0] = 0
    classes, deltas = sorted_means.pack_differences(morton.interleave(cells))
    field = np.full(2 * 45 // 8 + 1, 255, np.uint8)
    field[-1] = 3
    params = grid.pack() + BY_LONG.pack()
    stream = Stream(Attribute.MEANS, Kind.SORTED, 2, params, [classes, deltas, field])
    out = decode(sized(np.full(2, 15)), stream).means
    for row, cell in enumerate((0, levels - 1)):
        code = (cell << 15) + (1 << 15) - 1
        assert (out[row] == plain_mean(code, 15, f32(1), f32(0))).all()


# Hostile streams.


def good():
    rng = np.random.default_rng(2)
    wide = np.tile(np.array([0, 1, 3, 9], np.uint8), 5)
    grid = grid_of(0.25, (60, 60, 60), (-5, -5, -5))
    stream, scales, _, codes = encoded(rng.uniform(-5, 5, (20, 3)).astype(f32), grid, wide)
    return stream, scales, codes


def refusal(scales, stream):
    with pytest.raises(FormatError, match="chunk 7") as caught:
        decode(scales, stream)
    return caught.value.code, caught.value.clause


def test_other_parameters_are_refused():
    stream, scales, _ = good()
    decode(scales, stream)
    params = stream.params
    for other in (b"", params[:36], params[:-1], params + b"\0"):
        assert refusal(scales, changed(stream, params=other)) == ("stream-params", "6.2")
    for value in (math.nan, math.inf, 1.1e6):
        other = params[:56] + struct.pack("<f", value)
        assert refusal(scales, changed(stream, params=other)) == ("step-model", "6.10")
    for value, code in ((math.nan, "grid-value"), (2e30, "grid-value"), (-2e30, "grid-value")):
        other = struct.pack("<f", value) + params[4:]
        assert refusal(scales, changed(stream, params=other)) == (code, "6.4")
    for levels in (0, sorted_means.MAX_CELLS + 1, 2**32 - 1):
        other = params[:8] + struct.pack("<I", levels) + params[12:]
        assert refusal(scales, changed(stream, params=other)) == ("grid-levels", "6.4")


def test_cells_that_the_grid_does_not_have_are_refused():
    stream, scales, _ = good()
    grid = grids.unpack(memoryview(stream.params[:36]), 3, "here")
    for axis in range(3):
        levels = grid.levels.copy()
        levels[axis] = 20
        params = Grid(grid.minimum, grid.maximum, levels).pack() + stream.params[36:]
        assert refusal(scales, changed(stream, params=params)) == ("code-range", "6.5")


def test_another_number_or_length_of_planes_is_refused():
    stream, scales, _ = good()
    planes = list(stream.planes)
    for other in (planes[:2], planes[:0], [*planes, planes[2]]):
        assert refusal(scales, changed(stream, planes=other))[0] == "stream-planes"
    for place in range(3):
        longer = np.append(planes[place], np.array([1, 200, 1, 200, 1], np.uint8))
        for plane in (planes[place][:-5], longer):
            other = [*planes[:place], plane, *planes[place + 1 :]]
            assert refusal(scales, changed(stream, planes=other))[0] == "plane-length"
    # Scales that ask for more bits than there are.
    finer = sized(np.full(20, 15))
    assert refusal(finer, stream)[0] in ("plane-length", "zstd-size")


def test_deltas_and_bits_are_checked():
    stream, scales, _ = good()
    classes, deltas, rest = stream.planes
    other = classes.copy()
    other[0] = 52
    assert refusal(scales, changed(stream, planes=[other, deltas, rest]))[0] == "morton-class"
    # Two steps of 2^50.
    wide = np.zeros(20, np.uint8)
    wide[:3] = 51
    full = np.zeros(math.ceil(3 * 50 / 8), np.uint8)
    assert refusal(scales, changed(stream, planes=[wide, full, rest]))[0] == "morton-range"
    assert int(np.maximum(classes.astype(int) - 1, 0).sum()) % 8
    spoilt = deltas.copy()
    spoilt[-1] |= 128
    assert refusal(scales, changed(stream, planes=[classes, spoilt, rest]))[0] == "bits-padding"
    # 5 · (0 + 1 + 3 + 9) halvings of three axes: 195 bits, three of the last byte.
    spoilt = rest.copy()
    spoilt[-1] |= 8
    assert refusal(scales, changed(stream, planes=[classes, deltas, spoilt]))[0] == "bits-padding"


def test_sorted_stands_for_means_alone():
    stream, scales, _ = good()
    for attribute in (Attribute.SH0, Attribute.SCALES):
        parts = (changed(stream, attribute=attribute),)
        if attribute == Attribute.SH0:
            parts = (scales, *parts)
        with pytest.raises(FormatError) as caught:
            decode(*parts)
        assert caught.value.code == "stream-kind"


# Morton differences.


def packed(codes):
    """Classes and bits of ascending codes through one big integer (SPEC 6.5)."""
    classes, stream, length, before = [], 0, 0, 0
    for code in codes:
        delta, before = code - before, code
        classes.append(delta.bit_length())
        rest = max(delta.bit_length() - 1, 0)
        stream |= (delta & ((1 << rest) - 1)) << length
        length += rest
    return classes, stream.to_bytes((length + 7) // 8, "little")


def planes_of(codes):
    classes, bits = packed(codes)
    return np.array(classes, np.uint8), np.frombuffer(bits, np.uint8)


@checked
@given(st.lists(code51, max_size=40))
def test_packing_matches_a_big_integer(codes):
    codes = sorted(codes)
    classes, bits = sorted_means.pack_differences(np.array(codes, np.uint64))
    assert (classes.tolist(), bits.tobytes()) == packed(codes)
    assert classes.dtype == bits.dtype == np.uint8


@checked
@given(st.lists(st.one_of(code51, st.integers(0, 300)), max_size=40))
def test_unpacking_matches_what_was_packed(codes):
    codes = sorted(codes)
    classes, bits = planes_of(codes)
    assert sorted_means.unpack_differences(classes, bits, "here").tolist() == codes


def test_every_width_at_every_bit_offset():
    for offset in range(8):
        for width in range(51):
            # `offset` deltas of one bit each come first, then one of `width` bits, then one more.
            deltas = [3] * offset + [(1 << width) | ((1 << width) - 1) // 3, 2]
            codes = np.cumsum(deltas, dtype=np.uint64)
            if int(codes[-1]) < 2**51:
                classes, bits = planes_of(codes.tolist())
                np.testing.assert_array_equal(
                    sorted_means.unpack_differences(classes, bits, ""), codes
                )


def test_sorted_duplicates_and_nothing_at_all():
    same = np.full(5, 2**51 - 1, np.uint64)
    classes, bits = sorted_means.pack_differences(same)
    assert classes.tolist() == [51, 0, 0, 0, 0]
    assert len(bits) == 7
    np.testing.assert_array_equal(sorted_means.unpack_differences(classes, bits, ""), same)
    for codes in ([], [0], [0, 0, 0]):
        classes, bits = sorted_means.pack_differences(np.array(codes, np.uint64))
        assert classes.tolist() == [0] * len(codes)
        assert bits.size == 0
        assert sorted_means.unpack_differences(classes, bits, "").tolist() == codes


@pytest.mark.parametrize("top", [52, 64, 255])
def test_classes_above_51_are_refused(top):
    with pytest.raises(FormatError, match="head 3: class") as caught:
        sorted_means.difference_widths(np.array([1, top], np.uint8), "head 3")
    assert (caught.value.code, caught.value.clause) == ("morton-class", "6.5")


def test_bits_behind_the_last_difference_are_refused():
    for total in range(1, 17):
        classes = np.full(total, 2, np.uint8)
        bits = np.zeros((total + 7) // 8, np.uint8)
        sorted_means.unpack_differences(classes, bits, "")
        for spare in range(total, 8 * len(bits)):
            broken = bits.copy()
            broken[spare // 8] |= 1 << spare % 8
            with pytest.raises(FormatError) as caught:
                sorted_means.unpack_differences(classes, broken, "")
            assert caught.value.code == "bits-padding"


@pytest.mark.parametrize("count", [2, 3, 20_000])
@pytest.mark.parametrize("fill", [0, 255])
def test_sums_beyond_51_bits_are_refused_even_where_they_wrap(count, fill):
    # Differences of 2^50 to 2^51 - 1: of 20,000 the sum has 65 bits.
    classes = np.full(count, 51, np.uint8)
    bits = np.full(50 * count + 7 >> 3, fill, np.uint8)
    if fill and 50 * count % 8:
        bits[-1] = (1 << 50 * count % 8) - 1
    with pytest.raises(FormatError) as caught:
        sorted_means.unpack_differences(classes, bits, "here")
    assert caught.value.code == "morton-range"


# Grids of cells.


@pytest.mark.parametrize("levels", [(1, 1, 1), (1, 2, 131_072), (131_073, 1, 3), (1 << 24,) * 3])
def test_cells_reach_as_far_as_the_levels_of_their_grid(levels):
    minimum = np.array([-1, 0.25, 7], f32)
    span = (np.array(levels, float) - 1) * 2.0**-10
    grid = Grid(minimum, (minimum + span).astype(f32), np.array(levels, np.uint32))
    cells, bits = sorted_means.cell_grid(grid)
    assert cells.levels.max() <= sorted_means.MAX_CELLS
    assert bits == max(0, (max(levels) - 1).bit_length() - 17)
    assert ((cells.levels.astype(int) << bits) >= levels).all()
    assert ((cells.levels == 1) == (grid.levels == 1)).all()
    fine = cells.step * f32(2.0**-bits)
    np.testing.assert_allclose(fine, grid.step, rtol=1e-6)
