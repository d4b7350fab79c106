import math
import struct

import numpy as np
import oracle
import pytest
from heads import decode, flat
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams import grid_planes, scalar, scale_differences, swing_twist
from cogsplat.codec.streams.adaptive_step import StepModel
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import Attribute, Kind, Stream

pytestmark = pytest.mark.usefixtures("arithmetic")

f32 = np.float32
checked = settings(derandomize=True, deadline=None, max_examples=40)


def scales_of(seed, rows):
    """Log scales: middle, thin, long."""
    scales = np.random.default_rng(seed).normal(-4, 1.2, (rows, 3))
    return np.sort(scales, axis=1)[:, [1, 0, 2]].astype(f32)


def gaussians(seed, rows):
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(rows, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return quats.astype(f32), rng.normal(-3, 1, (rows, 3)).astype(f32)


def constant(halvings):
    return StepModel((float(halvings), 0.0, 0.0, 0.0, 0.0, 0.0))


def refusal(*given_streams):
    with pytest.raises(FormatError, match="chunk 7") as caught:
        decode(*given_streams)
    return caught.value.code, caught.value.clause


def changed(stream, **changes):
    values = {name: getattr(stream, name) for name in stream.__dataclass_fields__} | changes
    return Stream(**values)


# Ladders.


@pytest.mark.parametrize("step", [1.0, 0.1, 1e-4])
def test_ladders_hold_scales_within_their_steps(step):
    scales = scales_of(1, 400)
    steps = scale_differences.differences_of(scales)
    assert (steps[:, 1:] >= 0).all()
    grid = grids.fit(steps, step)
    out = decode(scale_differences.write(steps, grid)).scales
    # Errors of half a step each: the long axis has one, the middle two, the thin three.
    error = np.abs(out.astype(np.float64) - scales)
    assert (error <= np.array([2, 3, 1]) * step * 0.5001 + 4e-6).all()
    assert (out[:, 1] <= out[:, 0] + 1e-6).all()
    assert (out[:, 0] <= out[:, 2] + 1e-6).all()


def test_ladders_are_climbed_in_the_documented_order():
    rng = np.random.default_rng(2)
    grid = Grid(
        np.array([-9, -0.5, 0], f32),
        np.array([2.3, 7, 0.7], f32),
        np.array([300, 5, 70_000], np.uint32),
    )
    codes = rng.integers(0, grid.levels, (64, 3)).astype(np.uint32)
    planes = []
    for component in range(3):
        planes += grid_planes.split_planes(codes[:, component], int(grid.levels[component]))
    out = decode(Stream(Attribute.SCALES, Kind.DIFFERENCES, 64, grid.pack(), planes)).scales
    for row in range(64):
        l, u, v = (  # noqa: E741 - as the clause names them
            f32(f32(f32(code) * f32(f32(high - low) / f32(levels - 1))) + low)
            for code, low, high, levels in zip(
                codes[row], grid.minimum, grid.maximum, grid.levels.astype(f32), strict=True
            )
        )
        middle = f32(l - u)
        assert out[row].tobytes() == np.array([middle, f32(middle - v), l], f32).tobytes()


def test_a_ladder_of_one_shape_costs_no_plane():
    steps = scale_differences.differences_of(np.tile(np.array([[-4, -6, -3.5]], f32), (9, 1)))
    stream = scale_differences.write(steps, grids.fit(steps, 0.1))
    assert list(stream.planes) == []
    np.testing.assert_allclose(decode(stream).scales, [[-4, -6, -3.5]] * 9, atol=1e-6)


def test_ladders_that_break_the_rules_are_refused():
    steps = scale_differences.differences_of(scales_of(3, 20))
    good = scale_differences.write(steps, grids.fit(steps, 0.1))
    decode(good)
    for params in (b"", good.params[:-1], good.params + b"\0", good.params[:24]):
        assert refusal(changed(good, params=params)) == ("stream-params", "6.2")
    for planes in (good.planes[:-1], [*good.planes, good.planes[0]]):
        assert refusal(changed(good, planes=planes)) == ("stream-planes", "6.2")
    short = [plane[:-1] for plane in good.planes]
    assert refusal(changed(good, planes=short)) == ("plane-length", "6.3")
    levels = grids.unpack(memoryview(good.params), 3, "here").levels
    for component in range(3):
        planes = [plane.copy() for plane in good.planes]
        planes[component][4] = levels[component]
        assert refusal(changed(good, planes=planes)) == ("code-range", "6.4")
    for value, code in ((math.nan, "grid-value"), (2e30, "grid-value")):
        params = struct.pack("<f", value) + good.params[4:]
        assert refusal(changed(good, params=params)) == (code, "6.4")
    for levels in (0, grids.MAX_LEVELS + 1):
        params = good.params[:8] + struct.pack("<I", levels) + good.params[12:]
        assert refusal(changed(good, params=params)) == ("grid-levels", "6.4")


def test_ladders_and_turns_stand_for_their_attributes_alone():
    steps = scale_differences.differences_of(scales_of(4, 5))
    ladder = scale_differences.write(steps, grids.fit(steps, 0.1))
    for attribute in (Attribute.MEANS, Attribute.SH0):
        assert refusal(changed(ladder, attribute=attribute)) == ("stream-kind", "6.2")
    turns, _ = swing_twist.turns(np.zeros((5, 3)), scales_of(4, 5), constant(3), constant(3))
    for attribute in (Attribute.SCALES, Attribute.MEANS, Attribute.SH0):
        assert refusal(changed(turns, attribute=attribute)) == ("stream-kind", "6.2")


# Turns.


def stored_scales(scales):
    """A ladder that a decoder reads these scales from exactly, and them as it does."""
    steps = scale_differences.differences_of(scales)
    grid = grids.fit(steps, 1e-3)
    return scale_differences.write(steps, grid), scale_differences.accumulate(
        grid.dequantise(grid.quantise(steps))
    )


@checked
@given(
    st.lists(st.floats(-4, 4, width=32), min_size=12, max_size=12),
    st.integers(1, 60),
    st.integers(0, 2**32 - 1),
)
def test_turns_decode_to_what_the_encoder_was_told(coefficients, rows, seed):
    ladder, scales = stored_scales(scales_of(seed, rows))
    values = np.random.default_rng(seed).uniform(-1, 1, (rows, 3))
    tilt = StepModel((coefficients[0] + 12, *coefficients[1:6]))
    spin = StepModel((coefficients[6] + 6, *coefficients[7:]))
    stream, decoded = swing_twist.turns(values, scales, tilt, spin)
    out = decode(ladder, stream).quats
    assert out.tobytes() == swing_twist.quats_of(decoded).tobytes()
    wide = np.stack(
        [tilt.extra_bits(scales), tilt.extra_bits(scales), spin.extra_bits(scales)], axis=1
    )
    bound = np.where(wide > 0, 2.0 ** -wide.astype(float) + 2.0**-24, np.abs(values))
    assert (np.abs(decoded - values) <= bound).all()


@pytest.mark.parametrize("halvings", [1, 3, 6, 7, 11, 15])
def test_rotations_come_back_as_finely_as_they_are_halved(halvings):
    quats, source = gaussians(5, 300)
    values, scales = swing_twist.canonical(quats, source)
    ladder, stored = stored_scales(scales)
    stream, _ = swing_twist.turns(values, stored, constant(halvings), constant(halvings))
    out = decode(ladder, stream).quats
    for row in range(300):
        axes = oracle.rotation_matrix(out[row])
        expected = oracle.rotation_matrix(quats[row])[:, np.argsort(source[row])[[1, 0, 2]]]
        # Axes come back up to their direction. An angle is twice the error of a tangent, in each
        # of three components that are off by half a step of 2^(1 - h) at most.
        angles = np.abs(np.einsum("ij,ij->j", axes, expected))
        limit = 2 * math.sqrt(3) * 2.0**-halvings + 1e-3 * 2.0**-10 + 2e-6
        assert (angles >= math.cos(min(limit, math.pi / 2)) - 1e-6).all()


def test_turns_of_no_halvings_are_no_rotation_and_cost_no_byte():
    ladder, scales = stored_scales(scales_of(6, 30))
    values = np.random.default_rng(6).uniform(-1, 1, (30, 3))
    stream, _ = swing_twist.turns(values, scales, constant(0), constant(-5))
    assert [len(plane) for plane in stream.planes] == [0, 0, 0]
    assert (decode(ladder, stream).quats == [1, 0, 0, 0]).all()


def fine_turns():
    ladder, scales = stored_scales(scales_of(7, 40))
    values = np.random.default_rng(7).uniform(-1, 1, (40, 3))
    stream, _ = swing_twist.turns(values, scales, constant(9), constant(4))
    # a: symbols, bits; b: symbols, bits; c: symbols, no bits.
    assert [len(plane) for plane in stream.planes] == [40, 15, 40, 15, 40, 0]
    return ladder, stream


def test_turns_that_break_the_rules_are_refused():
    ladder, good = fine_turns()
    decode(ladder, good)

    def broken(**changes):
        return refusal(ladder, changed(good, **changes))

    for params in (b"", good.params[:-1], good.params + b"\0"):
        assert broken(params=params) == ("stream-params", "6.2")
    for planes in (good.planes[:-1], [*good.planes, good.planes[-1]], []):
        assert broken(planes=planes)[0] == "stream-planes"
    for place in range(6):
        # By more than digits that share a byte leave open.
        for plane in (
            good.planes[place][:-4],
            np.append(good.planes[place], np.zeros(4, np.uint8)),
        ):
            if len(plane) == len(good.planes[place]):
                continue
            planes = [*good.planes[:place], plane, *good.planes[place + 1 :]]
            assert broken(planes=planes)[0] == "plane-length"
    for place in (0, 24):
        for value in (math.nan, math.inf, -2e6):
            params = good.params[:place] + struct.pack("<f", value) + good.params[place + 4 :]
            assert broken(params=params) == ("resolution-value", "6.10")
    # Another resolution asks for other planes.
    assert broken(params=constant(5).pack() * 2)[0] in ("stream-planes", "plane-length")
    assert refusal(ladder, good, constant_ladder_rows(41)) == ("stream-rows", "6.2")


def constant_ladder_rows(rows):
    return scalar.write(Attribute.SH0, np.zeros((rows, 3), f32), flat(3))


@pytest.mark.parametrize(
    ("place", "symbol", "low", "fits"),
    [
        (0, 64, 0, True),
        (0, 64, 1, False),
        (0, 65, 0, False),
        (0, 255, 7, False),
        (2, 64, 4, False),
        (4, 16, 0, True),
        (4, 17, 0, False),
    ],
)
def test_codes_beyond_the_levels_of_their_row_are_refused(place, symbol, low, fits):
    ladder, good = fine_turns()
    planes = [plane.copy() for plane in good.planes]
    planes[place][0] = symbol
    if place < 4:
        planes[place + 1][0] = planes[place + 1][0] & 0xF8 | low
    if fits:
        assert np.isfinite(decode(ladder, changed(good, planes=planes)).quats).all()
    else:
        assert refusal(ladder, changed(good, planes=planes)) == ("code-range", "6.11")


def test_padding_behind_the_plain_bits_is_refused():
    ladder, scales = stored_scales(scales_of(8, 3))
    good, _ = swing_twist.turns(np.zeros((3, 3)), scales, constant(9), constant(9))
    for place in (1, 3, 5):
        planes = [plane.copy() for plane in good.planes]
        assert len(planes[place]) == 2
        planes[place][1] |= 2
        assert refusal(ladder, changed(good, planes=planes)) == ("bits-padding", "6.5")


def test_turns_of_one_splat_come_back():
    for halvings in (0, 1, 6, 15):
        ladder, scales = stored_scales(scales_of(9, 1))
        stream, decoded = swing_twist.turns(
            np.array([[0.3, -0.6, 0.9]]), scales, constant(halvings), constant(halvings)
        )
        assert decode(ladder, stream).quats.tobytes() == swing_twist.quats_of(decoded).tobytes()
