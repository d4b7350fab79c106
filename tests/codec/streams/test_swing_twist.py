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
from cogsplat.codec.streams import scalar, scale_differences, swing_twist
from cogsplat.codec.streams.adaptive_step import StepModel
from cogsplat.codec.streams.records import Attribute, Stream

f32 = np.float32
checked = settings(derandomize=True, deadline=None, max_examples=60)


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


def check_decomposed(quats, scales):
    turns, named = swing_twist.decompose(quats, scales)
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
    check_decomposed(unit_quats(1, 500), rng.normal(-1, 1, (500, 3)).astype(f32))


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
        check_decomposed(np.array(quats, f32), np.tile(np.array(scales, f32), (len(quats), 1)))


def test_no_rows_have_no_turns():
    turns, scales = swing_twist.decompose(np.empty((0, 4), f32), np.empty((0, 3), f32))
    assert (turns.shape, scales.shape) == ((0, 3), (0, 3))
    assert swing_twist.compose(turns.astype(f32)).shape == (0, 4)


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
    out = swing_twist.compose(turns)
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
def test_codes_split_into_symbols_and_low_bits(extra_bits, seed):
    rng = np.random.default_rng(seed)
    wide = np.array(extra_bits, np.uint8)
    codes = np.array([rng.integers(0, (1 << h) + 1) if h else 0 for h in extra_bits], np.uint32)
    planes = swing_twist.split_component(codes, wide)
    # SPEC 6.11: a plane for each number of bits up to 6, empty or not, then the low bits.
    assert len(planes) == swing_twist.COMPONENT_PLANES == 7
    for group, plane in enumerate(planes[:6], start=1):
        rows = [row for row, h in enumerate(extra_bits) if min(h, 6) == group]
        expected = [int(codes[row]) >> max(extra_bits[row] - 6, 0) for row in rows]
        assert plane.tolist() == expected
    number, total = 0, 0
    for code, h in zip(codes.tolist(), extra_bits, strict=True):
        low = max(h - 6, 0)
        number |= (code & ((1 << low) - 1)) << total
        total += low
    assert planes[6].tobytes() == number.to_bytes(-(-total // 8), "little")


def stored_scales(scales):
    """Return the differences stream of some scales, and the decoded scales."""
    steps = scale_differences.differences_of(scales)
    grid = grids.fit(steps, 1e-3)
    return scale_differences.write(steps, grid), scale_differences.scales_of(
        grid.dequantise(grid.quantise(steps))
    )


def expected_quats(values, scales, swing, twist):
    """Quaternions of components, each quantised with the extra bits of its row."""
    out = np.empty((len(values), 3), f32)
    for column, model in enumerate((swing, swing, twist)):
        wide = model.extra_bits(scales)
        out[:, column] = swing_twist.dequantise(swing_twist.quantise(values[:, column], wide), wide)
    return swing_twist.compose(out)


@checked
@given(
    st.lists(st.floats(-4, 4, width=32), min_size=12, max_size=12),
    st.integers(1, 60),
    st.integers(0, 2**32 - 1),
)
def test_streams_decode_to_what_was_quantised(coefficients, rows, seed):
    differences, scales = stored_scales(scales_of(seed, rows))
    values = np.random.default_rng(seed).uniform(-1, 1, (rows, 3))
    swing = StepModel((coefficients[0] + 12, *coefficients[1:6]))
    twist = StepModel((coefficients[6] + 6, *coefficients[7:]))
    stream = swing_twist.write(values, scales, swing, twist)
    assert len(stream.planes) == 21
    out = decode(differences, stream).quats
    assert out.tobytes() == expected_quats(values, scales, swing, twist).tobytes()


@pytest.mark.parametrize("halvings", [1, 3, 6, 7, 11, 15])
def test_rotations_come_back_as_finely_as_they_are_halved(halvings):
    quats, source = gaussians(5, 300)
    values, scales = swing_twist.decompose(quats, source)
    differences, stored = stored_scales(scales)
    stream = swing_twist.write(values, stored, constant(halvings), constant(halvings))
    out = decode(differences, stream).quats
    for row in range(300):
        axes = oracle.rotation_matrix(out[row])
        expected = oracle.rotation_matrix(quats[row])[:, np.argsort(source[row])[[1, 0, 2]]]
        # Axes come back up to their direction. An angle is twice the error of a tangent, in each
        # of three components that are off by half a step of 2^(1 - h) at most.
        angles = np.abs(np.einsum("ij,ij->j", axes, expected))
        limit = 2 * math.sqrt(3) * 2.0**-halvings + 1e-3 * 2.0**-10 + 2e-6
        assert (angles >= math.cos(min(limit, math.pi / 2)) - 1e-6).all()


def test_no_extra_bits_are_no_rotation_and_cost_no_byte():
    differences, scales = stored_scales(scales_of(6, 30))
    values = np.random.default_rng(6).uniform(-1, 1, (30, 3))
    stream = swing_twist.write(values, scales, constant(0), constant(-5))
    assert [len(plane) for plane in stream.planes] == [0] * 21
    assert (decode(differences, stream).quats == [1, 0, 0, 0]).all()


def fine_stream():
    differences, scales = stored_scales(scales_of(7, 40))
    values = np.random.default_rng(7).uniform(-1, 1, (40, 3))
    stream = swing_twist.write(values, scales, constant(9), constant(4))
    # a and b: symbols of six bits, and three low bits each; c: symbols of four bits.
    lengths = [0, 0, 0, 0, 0, 40, 15] * 2 + [0, 0, 0, 40, 0, 0, 0]
    assert [len(plane) for plane in stream.planes] == lengths
    return differences, stream


def test_streams_that_break_the_rules_are_refused():
    differences, good = fine_stream()
    decode(differences, good)

    def broken(**changes):
        return refusal(differences, changed(good, **changes))

    for params in (b"", good.params[:-1], good.params + b"\0"):
        assert broken(params=params) == ("stream-params", "6.2")
    for planes in (good.planes[:-1], [*good.planes, good.planes[-1]], []):
        assert broken(planes=planes)[0] == "stream-planes"
    for place in range(21):
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
            assert broken(params=params) == ("step-model", "6.10")
    # Another step model asks for planes of other lengths.
    assert broken(params=constant(5).pack() * 2)[0] in ("plane-length", "zstd-size")
    assert refusal(differences, good, constant_sh0_rows(41)) == ("stream-rows", "6.2")


def constant_sh0_rows(rows):
    return scalar.write(Attribute.SH0, np.zeros((rows, 3), f32), flat(3))


@pytest.mark.parametrize(
    ("place", "symbol", "low", "fits"),
    [
        (5, 64, 0, True),
        (5, 64, 1, False),
        (5, 65, 0, False),
        (5, 255, 7, False),
        (12, 64, 4, False),
        (17, 16, 0, True),
        (17, 17, 0, False),
    ],
)
def test_codes_beyond_the_levels_of_their_row_are_refused(place, symbol, low, fits):
    differences, good = fine_stream()
    planes = [plane.copy() for plane in good.planes]
    planes[place][0] = symbol
    if place < 14:
        planes[place + 1][0] = planes[place + 1][0] & 0xF8 | low
    if fits:
        assert np.isfinite(decode(differences, changed(good, planes=planes)).quats).all()
    else:
        assert refusal(differences, changed(good, planes=planes)) == ("code-range", "6.11")


def test_padding_behind_the_low_bits_is_refused():
    differences, scales = stored_scales(scales_of(8, 3))
    good = swing_twist.write(np.zeros((3, 3)), scales, constant(9), constant(9))
    for place in (6, 13, 20):
        planes = [plane.copy() for plane in good.planes]
        assert len(planes[place]) == 2
        planes[place][1] |= 2
        assert refusal(differences, changed(good, planes=planes)) == ("bits-padding", "6.15")


def test_one_splat_comes_back():
    for halvings in (0, 1, 6, 15):
        differences, scales = stored_scales(scales_of(9, 1))
        stream = swing_twist.write(
            np.array([[0.3, -0.6, 0.9]]), scales, constant(halvings), constant(halvings)
        )
        model = constant(halvings)
        expected = expected_quats(np.array([[0.3, -0.6, 0.9]]), scales, model, model)
        assert decode(differences, stream).quats.tobytes() == expected.tobytes()


def test_rotations_stand_for_quats_alone():
    _, good = fine_stream()
    for attribute in (Attribute.SCALES, Attribute.MEANS, Attribute.SH0):
        assert refusal(changed(good, attribute=attribute)) == ("stream-kind", "6.2")
