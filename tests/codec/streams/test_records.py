import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.errors import FormatError, UnsupportedError
from cogsplat.codec.streams import (
    codebook_index,
    float32,
    grid_planes,
    kinds,
    quaternion,
    scalar,
)
from cogsplat.codec.streams import records as streams
from cogsplat.codec.streams.byte_planes import PACKED_FLAG, ZSTD_FLAG
from cogsplat.codec.streams.grid import MAX_LEVELS, Grid, fit
from cogsplat.codec.streams.quaternion import PER_ROW
from cogsplat.codec.streams.records import (
    COMPONENTS,
    ESCAPE,
    INFINITIES,
    Attribute,
    Kind,
    Stream,
)

pytestmark = pytest.mark.usefixtures("arithmetic")

checked = settings(derandomize=True, deadline=None, max_examples=100)


def stored(*given_streams, max_rows=1 << 18):
    payload = streams.pack(given_streams)
    return streams.unpack(memoryview(payload), "head 5", max_rows)


def numbers(stream):
    (one,) = stored(stream)
    out = np.full((one.rows, COMPONENTS[one.attribute]), np.nan, np.float32)
    kinds.read(one, out)
    return out


def rotations(stream):
    (one,) = stored(stream)
    out = np.full((one.rows, 4), np.nan, np.float32)
    kinds.read(one, out)
    return out


def refused(call, code, clause=None, kind=FormatError):
    with pytest.raises(kind, match="head 5") as caught:
        call()
    assert caught.value.code == code
    if clause:
        assert caught.value.clause == clause


def record(attribute=3, kind=1, components=3, flags=0, rows=0, planes=0, params=b""):
    head = struct.pack(
        "<BBBBIHH", attribute, kind, components, flags, rows, planes, len(params)
    )  # SPEC 6.2
    return head + params


def payload(*records, count=None):
    body = b"".join(records)
    return memoryview(struct.pack("<H", len(records) if count is None else count) + body)


def grid_of(levels, low=0.0, high=1.0):
    return Grid(
        np.full(len(levels), low, np.float32),
        np.full(len(levels), high, np.float32),
        np.array(levels, np.uint32),
    )


# Numbers.


@checked
@given(
    st.integers(0, 12),
    st.tuples(*[st.sampled_from([1, 2, 255, 256, 257, 65536, 65537, MAX_LEVELS])] * 3),
    st.integers(0, 2**32 - 1),
)
def test_scalar_streams_hold_the_grids_own_values(rows, levels, seed):
    rng = np.random.default_rng(seed)
    grid = grid_of(levels, -3.0, 7.5)
    codes = rng.integers(0, np.array(levels), (rows, 3)).astype(np.uint32)
    values = grid.dequantise(codes)
    stream = scalar.write(Attribute.SH0, values, grid)
    assert len(stream.planes) == sum(grid_planes.code_bytes(count) for count in levels)
    assert numbers(stream).tobytes() == values.tobytes()


def test_planes_come_by_component_then_lowest_byte_first():
    values = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]], np.float32)
    stream = scalar.write(Attribute.SH0, values, grid_of([0x1234, 1, 3]))
    assert [plane.tolist() for plane in stream.planes] == [[0, 0x33], [0, 0x12], [0, 2]]


def test_a_constant_of_negative_zero_decodes_as_its_level_does():
    grid = grid_of([1, 2, 2], -0.0, -0.0)
    values = np.zeros((2, 3), np.float32)
    out = numbers(scalar.write(Attribute.SH0, values, grid))
    assert out.tobytes() == bytes(24)


@checked
@given(
    st.lists(
        st.one_of(st.floats(-30, 30, width=32), st.sampled_from([math.inf, -math.inf])),
        min_size=1,
        max_size=20,
    ),
    st.sampled_from([1, 2, 254, 255, 256, 65534, 65535, MAX_LEVELS - 2]),
)
def test_infinities_take_two_codes_above_the_levels(values, levels):
    source = np.array(values, np.float32)[:, None]
    grid = grid_of([levels], -30.0, 30.0)
    stream = scalar.write_with_infinities(Attribute.OPACITIES, source, grid)
    assert stream.flags == INFINITIES
    out = numbers(stream)
    infinite = np.isinf(source)
    np.testing.assert_array_equal(out[infinite], source[infinite])
    expected = grid.dequantise(grid.quantise(np.where(infinite, grid.minimum, source)))
    np.testing.assert_array_equal(out[~infinite], expected[~infinite])


def test_float_streams_keep_every_bit():
    rng = np.random.default_rng(3)
    values = rng.normal(size=(9, 3)).astype(np.float32) * np.float32(1e-30)
    values[0] = [-0.0, 1e-45, -1e30]
    out = numbers(float32.write(Attribute.MEANS, values))
    assert out.tobytes() == values.tobytes()
    logits = np.array([[np.inf], [-np.inf], [3.5]], np.float32)
    assert numbers(float32.write(Attribute.OPACITIES, logits)).tobytes() == logits.tobytes()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 2e30, -2e30])
def test_floats_no_scene_can_hold_are_refused(value):
    values = np.zeros((3, 3), np.float32)
    values[1, 2] = value
    refused(lambda: numbers(float32.write(Attribute.SCALES, values)), "float-value", "6.8")


@pytest.mark.parametrize("value", [np.nan, 2e30, -2e30])
def test_opacities_may_be_infinite_but_not_nan_or_huge(value):
    values = np.full((3, 1), value, np.float32)
    refused(lambda: numbers(float32.write(Attribute.OPACITIES, values)), "float-value", "6.8")


def test_codes_above_the_levels_are_refused():
    plane = np.array([0, 4, 5], np.uint8)
    zeros = np.zeros(3, np.uint8)
    params = grid_of([5, 2, 2]).pack()
    stream = Stream(Attribute.SH0, Kind.SCALAR, 3, params, [plane, zeros, zeros])
    refused(lambda: numbers(stream), "code-range", "6.4")
    infinite = Stream(Attribute.OPACITIES, Kind.SCALAR, 3, grid_of([4]).pack(), [plane], INFINITIES)
    assert numbers(infinite)[:, 0].tolist() == [0.0, math.inf, -math.inf]
    beyond = Stream(Attribute.OPACITIES, Kind.SCALAR, 3, grid_of([3]).pack(), [plane], INFINITIES)
    refused(lambda: numbers(beyond), "code-range", "6.4")


@pytest.mark.parametrize("change", [-1, 1])
def test_another_number_of_planes_is_refused(change):
    planes = [np.zeros(2, np.uint8)] * (3 + change)
    stream = Stream(Attribute.SH0, Kind.SCALAR, 2, grid_of([9, 9, 9]).pack(), planes)
    refused(lambda: numbers(stream), "stream-planes", "6.2")
    floats = Stream(Attribute.SH0, Kind.FLOAT, 2, b"", [np.zeros(2, np.uint8)] * (12 + change))
    refused(lambda: numbers(floats), "stream-planes", "6.2")


def test_other_lengths_of_parameters_are_refused():
    for params in (b"", grid_of([1, 1]).pack(), grid_of([1] * 4).pack(), bytes(35), bytes(37)):
        for kind in (Kind.SCALAR, Kind.FLOAT)[: 1 + bool(params)]:
            stream = Stream(Attribute.SH0, kind, 2, params, [])
            refused(lambda stream=stream: numbers(stream), "stream-params", "6.2")


def test_attributes_of_another_kind_are_refused():
    quats = np.array([[1, 0, 0, 0]], np.float32)
    stream = quaternion.write(quats, 0.1)
    other = Stream(Attribute.SH0, stream.kind, stream.rows, stream.params, stream.planes)
    refused(lambda: numbers(other), "stream-kind", "6.2")
    plain = scalar.write(Attribute.SH0, quats[:, :3].copy(), grid_of([2] * 3))
    for attribute in (Attribute.QUATS, Attribute.SHAPE, Attribute.SHN):
        other = Stream(attribute, plain.kind, plain.rows, plain.params, plain.planes)
        refused(lambda other=other: numbers(other), "stream-kind", "6.2")


# Rotations.


def random_quats(seed, rows):
    quats = np.random.default_rng(seed).normal(size=(rows, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    quats[quats[:, 0] < 0] *= -1
    return quats.astype(np.float32)


def angles(a, b):
    """Angle between rotations, accurate for small ones."""
    a, b = a.astype(np.float64), b.astype(np.float64)
    apart = np.minimum(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    return 4 * np.arcsin(np.minimum(apart / 2, 1))


@pytest.mark.parametrize("step", [0.2, 0.02, 1e-3, 1e-5])
@pytest.mark.parametrize("largest", [0, 1, 2, 3, None])
def test_rotations_stay_within_the_angle_their_step_allows(step, largest):
    quats = random_quats(7, 3000)
    if largest is not None:
        quats = quats[np.abs(quats).argmax(axis=1) == largest]
    stream = quaternion.write(quats, step)
    assert stream.params[0] == (PER_ROW if largest is None else largest)
    out = rotations(stream)
    norms = np.sqrt(np.square(out.astype(np.float64)).sum(axis=1))
    np.testing.assert_allclose(norms, 1, atol=2e-7)
    assert (out[:, 0] >= 0).all()
    # Three components are off by half a step, the fourth, at least 1/2, by three times that, and
    # an angle by twice the distance: 2·√(3 + 9)/2 = 3.47 steps, and what curvature adds.
    assert angles(quats, out).max() <= 3.5 * step + 4 * step**2 + 1e-6


def scalar_quat(others, largest):
    """SPEC 6.6, one float32 operation at a time."""
    one = np.float32(1)
    a, b, c = (np.float32(v) for v in others)
    rest = one - np.float32(np.float32(np.float32(a * a) + np.float32(b * b)) + np.float32(c * c))
    four = [a, b, c]
    four.insert(largest, np.sqrt(max(np.float32(rest), np.float32(0))))
    w, x, y, z = four
    total = np.float32(np.float32(w * w) + np.float32(x * x))
    total = np.float32(np.float32(total + np.float32(y * y)) + np.float32(z * z))
    norm = np.sqrt(total)
    four = [np.float32(v / norm) for v in four]
    return [-v for v in four] if four[0] < 0 else four


@pytest.mark.parametrize("per_row", [False, True])
def test_rotations_decode_in_the_documented_order(per_row):
    rng = np.random.default_rng(8)
    rows = 64
    grid = grid_of([257, 31, 4096], -0.71, 0.71)
    codes = rng.integers(0, grid.levels, (rows, 3)).astype(np.uint32)
    which = rng.integers(0, 4, rows).astype(np.uint8) if per_row else np.full(rows, 2, np.uint8)
    planes = [which] if per_row else []
    for component in range(3):
        planes += grid_planes.split_planes(codes[:, component], int(grid.levels[component]))
    params = bytes([PER_ROW if per_row else 2, 0, 0, 0]) + grid.pack()
    out = rotations(Stream(Attribute.QUATS, Kind.QUAT, rows, params, planes))
    others = grid.dequantise(codes)
    for row in range(rows):
        expected = np.array(scalar_quat(others[row], int(which[row])), np.float32)
        assert out[row].tobytes() == expected.tobytes()


def test_rotations_that_leave_the_sphere_still_come_out_unit():
    grid = grid_of([2, 2, 2], -1.0, 1.0)
    codes = np.array([[0, 0, 0], [1, 1, 1], [0, 1, 0]], np.uint32)
    planes = [codes[:, component].astype(np.uint8) for component in range(3)]
    for largest in range(4):
        params = bytes([largest, 0, 0, 0]) + grid.pack()
        out = rotations(Stream(Attribute.QUATS, Kind.QUAT, 3, params, planes))
        np.testing.assert_allclose(np.square(out).sum(axis=1), 1, rtol=1e-6)
        assert (out[:, 0] >= 0).all()


def test_exact_axes_and_ties_come_back():
    half = np.float32(0.5)
    quats = np.array(
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1], [half, -half, half, -half]],
        np.float32,
    )
    out = rotations(quaternion.write(quats, 1e-4))
    assert angles(quats, out).max() <= 4e-4


def test_bad_rotation_parameters_are_refused():
    grid = grid_of([1, 1, 1], 0.0, 0.5).pack()
    for head, code in (
        (bytes([4, 0, 0, 0]), "quat-largest"),
        (bytes([254, 0, 0, 0]), "quat-largest"),
        (bytes([0, 1, 0, 0]), "quat-largest"),
        (bytes([0, 0, 0, 9]), "quat-largest"),
        (b"", "stream-params"),
        (bytes(5), "stream-params"),
    ):
        stream = Stream(Attribute.QUATS, Kind.QUAT, 1, head + grid, [])
        refused(lambda stream=stream: rotations(stream), code)
    for low, high in ((-1.001, 0.0), (0.0, 1.001)):
        params = bytes(4) + grid_of([1, 1, 1], low, high).pack()
        stream = Stream(Attribute.QUATS, Kind.QUAT, 1, params, [])
        refused(lambda stream=stream: rotations(stream), "grid-value", "6.6")
    params = bytes([PER_ROW, 0, 0, 0]) + grid
    stream = Stream(Attribute.QUATS, Kind.QUAT, 2, params, [np.array([3, 4], np.uint8)])
    refused(lambda: rotations(stream), "quat-largest", "6.6")
    for planes in ([], [np.zeros(2, np.uint8)] * 2):
        stream = Stream(Attribute.QUATS, Kind.QUAT, 2, params, planes)
        refused(lambda stream=stream: rotations(stream), "stream-planes", "6.2")


# Indices.


@checked
@given(st.integers(0, 70_000), st.integers(0, 20), st.integers(0, 2**32 - 1))
def test_indices_come_back(size, kept, seed):
    rows = kept + 5 if size + kept else 0
    indices = np.random.default_rng(seed).integers(0, max(size + kept, 1), rows).astype(np.uint32)
    (one,) = stored(codebook_index.write(Attribute.SHAPE, indices, 3, size, kept))
    assert codebook_index.parse(one) == codebook_index.CodebookUse(3, kept)
    np.testing.assert_array_equal(codebook_index.read_indices(one, size), indices)


def test_indices_beyond_codebook_and_kept_rows_are_refused():
    indices = np.array([0, 11, 12], np.uint32)
    (one,) = stored(codebook_index.write(Attribute.SHAPE, indices, 0, 10, 3))
    np.testing.assert_array_equal(codebook_index.read_indices(one, 10), indices)
    refused(lambda: codebook_index.read_indices(one, 9), "index-range", "6.7")
    refused(lambda: codebook_index.read_indices(one, 10_000), "stream-planes", "6.2")
    (nothing,) = stored(codebook_index.write(Attribute.SHAPE, indices[:1], 0, 0, 0))
    refused(lambda: codebook_index.read_indices(nothing, 0), "index-range", "6.7")


def test_more_kept_rows_than_rows_are_refused():
    (one,) = stored(codebook_index.write(Attribute.SHAPE, np.zeros(4, np.uint32), 0, 10, 5))
    refused(lambda: codebook_index.parse(one), "stream-rows", "6.7")
    params = struct.pack("<I", 0)
    (short,) = stored(Stream(Attribute.SHAPE, Kind.VQ, 1, params, []))
    refused(lambda: codebook_index.parse(short), "stream-params", "6.2")


# Payloads.


def some_streams():
    rng = np.random.default_rng(11)
    values = rng.normal(size=(200, 3)).astype(np.float32)
    kept = rng.normal(size=(7, 3)).astype(np.float32)
    logits = np.append(rng.normal(size=199), np.inf).astype(np.float32)[:, None]
    return [
        scalar.write(Attribute.SH0, values, fit(values, 0.01)),
        scalar.write(Attribute.SCALES, kept, fit(kept, 0.1), escape=True),
        scalar.write_with_infinities(Attribute.OPACITIES, logits, fit(logits[:199], 0.1)),
        quaternion.write(random_quats(1, 200), 0.01),
        quaternion.write(random_quats(2, 7), 0.01, escape=True),
    ]


def read_all(data):
    """Values of every stream."""
    values = []
    found = streams.unpack(memoryview(data), "head 5", 200)
    for one in found:
        out = np.zeros((one.rows, COMPONENTS[one.attribute]), np.float32)
        if one.kind == Kind.VQ:
            codebook_index.read_indices(one, 10)
        else:
            kinds.read(one, out)
        values.append(out)
    return values


def test_a_payload_gives_back_its_records():
    given_streams = some_streams()
    data = streams.pack(given_streams)
    found = streams.unpack(memoryview(data), "head 5", 200)
    assert [(s.attribute, s.kind, s.flags, s.rows) for s in found] == [
        (s.attribute, s.kind, s.flags, s.rows) for s in given_streams
    ]
    assert [bytes(s.params) for s in found] == [s.params for s in given_streams]
    assert 2 + sum(s.stored_bytes for s in found) == len(data)
    assert [s.label for s in found] == [
        "sh0 scalar", "scales scalar escape", "opacities scalar", "quats quat", "quats quat escape",
    ]  # fmt: skip
    assert found[1].flags == ESCAPE
    assert streams.pack(given_streams) == data


def test_a_payload_without_streams_is_two_zero_bytes():
    assert streams.pack([]) == bytes(2)
    assert streams.unpack(memoryview(bytes(2)), "head 5", 10) == []


def test_every_cut_and_every_extra_byte_is_refused():
    data = streams.pack(some_streams())
    read_all(data)
    for end in range(len(data)):
        refused(lambda end=end: streams.unpack(memoryview(data[:end]), "head 5", 200),
                "stream-record", "6.1")  # fmt: skip
    for extra in (b"\0", bytes(2), b"\xff" * 8, data):
        refused(lambda extra=extra: read_all(data + extra), "stream-record", "6.1")


def test_digits_are_shared_only_where_they_may_be():
    given_streams = some_streams()
    with_digits, without = (streams.pack(given_streams, digits=digits) for digits in (True, False))
    assert len(with_digits) < len(without)
    for data, packed in ((with_digits, True), (without, False)):
        found = streams.unpack(memoryview(data), "head 5", 200)
        assert any((one.words & PACKED_FLAG).any() for one in found) == packed
    for one, other in zip(read_all(with_digits), read_all(without), strict=True):
        assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize(
    ("broken", "code", "clause"),
    [
        (record(components=4), "stream-record", "6.2"),
        (record(attribute=1, components=1), "stream-record", "6.2"),
        (record(flags=4), "stream-record", "6.2"),
        (record(flags=128), "stream-record", "6.2"),
        (record(flags=INFINITIES), "stream-record", "6.2"),
        (record(attribute=2, kind=5, components=1, flags=INFINITIES), "stream-record", "6.2"),
        (record(rows=11), "stream-rows", "6.2"),
        (record(rows=2**32 - 1), "stream-rows", "6.2"),
        (record() + record(), "stream-duplicate", "6.2"),
        (record() + record(kind=5), "stream-duplicate", "6.2"),
    ],
)
def test_records_that_break_the_rules_are_refused(broken, code, clause):
    data = payload(broken, count=len(broken) // len(record()))
    refused(lambda: streams.unpack(data, "head 5", 10), code, clause)


def test_the_same_attribute_may_come_once_more_as_kept():
    found = streams.unpack(payload(record(), record(flags=ESCAPE)), "head 5", 10)
    assert [s.flags for s in found] == [0, ESCAPE]


def test_what_a_later_version_may_add_is_unsupported_not_invalid():
    for number in (0, 200, 255):
        data = payload(record(attribute=number))
        refused(
            lambda data=data: streams.unpack(data, "head 5", 10),
            "stream-attribute-unknown",
            kind=UnsupportedError,
        )
        data = payload(record(kind=number))
        refused(
            lambda data=data: streams.unpack(data, "head 5", 10),
            "stream-kind-unknown",
            kind=UnsupportedError,
        )


def test_counts_that_do_not_fit_are_refused_before_anything_is_made():
    refused(
        lambda: streams.unpack(payload(record(), count=65), "head 5", 10), "stream-count", "9.1"
    )
    # 65535 planes and parameters in a payload of a few bytes.
    for broken in (record(planes=65535), record(params=b"12")[:-2]):
        refused(
            lambda broken=broken: streams.unpack(payload(broken), "head 5", 10), "stream-record"
        )
    # A plane that claims 2 GiB.
    huge = payload(record(planes=1) + struct.pack("<I", ZSTD_FLAG - 1))
    refused(lambda: streams.unpack(huge, "head 5", 10), "stream-record")


def test_any_flipped_byte_is_refused_or_read_to_the_right_shape():
    data = streams.pack(some_streams())
    rng = np.random.default_rng(12)
    for position in [*range(300), *rng.integers(300, len(data), 200).tolist()]:
        broken = bytearray(data)
        broken[position] ^= int(rng.integers(1, 256))
        try:
            for out in read_all(bytes(broken)):
                assert not np.isnan(out).any()
        except (FormatError, UnsupportedError):
            continue
