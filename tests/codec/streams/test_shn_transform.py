import math
import struct
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.errors import FormatError
from cogsplat.codec.segments.codebooks import ColourCodebook
from cogsplat.codec.segments.tails import decode_tail
from cogsplat.codec.streams import records, scalar, shn_transform
from cogsplat.codec.streams.grid import fit
from cogsplat.codec.streams.records import Attribute, Kind, Stream

f32 = np.float32
STARTS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 18, 26, 255)
BOOK = 5


def book(rows, seed=1, coefficients=15, scale=1.0):
    values = np.random.default_rng(seed).normal(0, scale, (rows, coefficients, 3))
    return ColourCodebook(values.astype(f32))


def read(stream, codebook, coefficients=15):
    out = np.full((stream.rows, coefficients, 3), np.nan, f32)
    payload = memoryview(records.pack([stream]))
    decode_tail(payload, {BOOK: codebook}, out, "chunk 7")
    return out


def changed(stream, **changes):
    values = {name: getattr(stream, name) for name in stream.__dataclass_fields__} | changes
    return Stream(**values)


def sparse(seed, rows, width, share=0.4, largest=3):
    """Signed codes, mostly zeros, fewer the further back."""
    rng = np.random.default_rng(seed)
    codes = rng.integers(-largest, largest + 1, (rows, width))
    codes[rng.random((rows, width)) > share / (1 + 0.2 * np.arange(width))] = 0
    return codes.astype(np.int64)


# SPEC 6.14, value by value.


def groups_of(width):
    return [range(a, min(b, width)) for a, b in pairwise(STARTS) if a < width]


def plain_codes(stream):
    """Zigzag codes of a stream, read from its planes as the clause says: (rows, width)."""
    _, step, shrink, width, reserved = struct.unpack_from("<IffHH", stream.params)
    assert reserved == 0
    sizes = list(stream.params[16:])
    groups = groups_of(width)
    assert len(sizes) == 2 * len(groups)
    planes = [plane.tolist() for plane in stream.planes]
    ends = planes.pop(0)
    order = sorted(range(stream.rows), key=lambda row: -ends[row])
    codes = [[0] * width for _ in range(stream.rows)]
    for group, columns in enumerate(groups):
        for part in range(2):
            number = sizes[2 * group + part]
            taken, planes = planes[:number], planes[number:]
            where = [
                (row, column)
                for column in columns
                for row in order
                if (ends[row] == column + 1 if part else ends[row] > column + 1)
            ]
            assert all(len(plane) == len(where) for plane in taken)
            for place, (row, column) in enumerate(where):
                symbol = sum(plane[place] << (8 * byte) for byte, plane in enumerate(taken))
                codes[row][column] = symbol + part
    assert planes == []
    return codes, f32(step), f32(shrink)


def plain_shn(stream, codebook):
    """Coefficients of a stream, one float32 operation after the other on each."""
    codes, step, shrink = plain_codes(stream)
    flat = codebook.shN.reshape(len(codebook), -1)
    out = np.zeros((stream.rows, flat.shape[1]), f32)
    for row, line in enumerate(codes):
        for column, code in enumerate(line):
            if code == 0:
                continue
            value = f32(f32(f32((code + 1) // 2) - shrink) * step)
            value = value if code % 2 else -value
            product = value * flat[column]
            out[row] += product
    return out.reshape(stream.rows, *codebook.shN.shape[1:])


@settings(derandomize=True, deadline=None, max_examples=25)
@given(
    st.sampled_from([1, 2, 7, 8, 9, 12, 13, 19, 27, 45]),
    st.integers(0, 12),
    st.sampled_from([1, 3, 200, 40_000, (1 << 22)]),
    st.sampled_from([0.0, 0.05, 0.5]),
    st.integers(0, 2**32 - 1),
)
def test_shn_is_summed_in_the_documented_order(width, rows, largest, shrink, seed):
    codes = sparse(seed, rows, width, largest=largest)
    codebook = book(width, seed % 1000, coefficients=8)
    stream = shn_transform.write(codes, BOOK, 0.0123, shrink)
    found, _, _ = plain_codes(stream)
    for row in range(rows):
        signed = [(code + 1) // 2 * (1 if code % 2 else -1) for code in found[row]]
        assert signed == codes[row, : len(signed)].tolist()
        assert not codes[row, len(signed) :].any()
    assert read(stream, codebook, 8).tobytes() == plain_shn(stream, codebook).tobytes()


def test_many_rows_are_summed_as_few_are():
    codebook = book(30, 2, coefficients=3)
    codes = sparse(3, 2600, 30, largest=2)
    codes[100] = 0
    stream = shn_transform.write(codes, BOOK, 0.5, 0.05)
    whole = read(stream, codebook, 3)
    for start in (0, 1000, 2550):
        rows = slice(start, start + 50)
        part = shn_transform.write(codes[rows], BOOK, 0.5, 0.05)
        assert whole[rows].tobytes() == plain_shn(part, codebook).tobytes()


@pytest.mark.parametrize("coefficients", [0, 3, 8])
def test_lower_degrees_are_the_first_coefficients(coefficients):
    codebook = book(20)
    stream = shn_transform.write(sparse(4, 60, 20), BOOK, 0.1, 0.05)
    full = read(stream, codebook)
    part = read(stream, codebook, coefficients)
    assert part.tobytes() == np.ascontiguousarray(full[:, :coefficients]).tobytes()


@pytest.mark.parametrize("rows", [0, 1, 5])
@pytest.mark.parametrize("width", [0, 1, 45])
def test_zeros_cost_the_ends_alone(rows, width):
    stream = shn_transform.write(np.zeros((rows, width), np.int64), BOOK, 1.0, 0.0)
    assert [len(plane) for plane in stream.planes] == [rows]
    assert len(stream.params) == 16
    out = read(stream, book(1))
    assert out.tobytes() == bytes(4 * out.size)


def test_columns_behind_the_last_that_is_used_are_dropped():
    codes = np.zeros((3, 45), np.int64)
    codes[1, 9] = -2
    stream = shn_transform.write(codes, BOOK, 1.0, 0.0)
    assert struct.unpack_from("<H", stream.params, 12) == (10,)
    codebook = book(10)
    out = read(stream, codebook)
    assert out[1].tobytes() == (codebook.shN[9] * f32(-2) + f32(0)).tobytes()
    assert not out[[0, 2]].any()


def test_a_wide_basis_keeps_its_last_group():
    codes = np.zeros((40, 255), np.int64)
    codes[np.arange(40), np.arange(215, 255)] = np.arange(40) - 20
    codes[7, 254] = 9
    codebook = book(255, 6, coefficients=3)
    stream = shn_transform.write(codes, BOOK, 0.25, 0.05)
    assert read(stream, codebook, 3).tobytes() == plain_shn(stream, codebook).tobytes()


def test_the_largest_factors_stay_finite():
    codebook = ColourCodebook(np.full((255, 3, 3), 2.0**32, f32))
    codes = np.full((2, 255), (1 << 23) - 1, np.int64)
    stream = shn_transform.write(codes, BOOK, 2.0**32, 0.0)
    out = read(stream, codebook, 3)
    assert np.isfinite(out).all()
    assert (out > 2.0**90).all()


# Hostile streams.


def good():
    return shn_transform.write(sparse(8, 50, 20, share=0.9, largest=200), BOOK, 0.5, 0.05)


def refusal(stream, codebook=None):
    with pytest.raises(FormatError, match="chunk 7") as caught:
        read(stream, book(20) if codebook is None else codebook)
    return caught.value.code, caught.value.clause


def with_field(stream, place, layout, value):
    data = bytearray(stream.params)
    struct.pack_into(layout, data, place, value)
    return changed(stream, params=bytes(data))


@pytest.mark.parametrize(
    ("place", "layout", "value", "code"),
    [
        (4, "<f", 0.0, "basis-value"),
        (4, "<f", -0.0, "basis-value"),
        (4, "<f", -1.0, "basis-value"),
        (4, "<f", math.nan, "basis-value"),
        (4, "<f", math.inf, "basis-value"),
        (4, "<f", 2.0**32 * 1.0000002, "basis-value"),
        (8, "<f", -0.001, "basis-value"),
        (8, "<f", 0.50001, "basis-value"),
        (8, "<f", math.nan, "basis-value"),
        (14, "<H", 1, "basis-width"),
        (14, "<H", 0x8000, "basis-width"),
        (0, "<I", BOOK + 1, "codebook-missing"),
        (0, "<I", 2**32 - 1, "codebook-missing"),
        # Groups of another width: other parameters.
        (12, "<H", 10, "stream-params"),
        (12, "<H", 0, "stream-params"),
        (12, "<H", 65535, "stream-params"),
        (16, "<B", 4, "stream-planes"),
        (16, "<B", 255, "stream-planes"),
        (16, "<B", 3, "stream-planes"),
        (35, "<B", 3, "stream-planes"),
    ],
)
def test_parameters_out_of_range_are_refused(place, layout, value, code):
    stream = good()
    read(stream, book(20))
    assert refusal(with_field(stream, place, layout, value))[0] == code


def test_sizes_above_three_are_refused_though_the_planes_add_up():
    codes = np.zeros((3, 3), np.int64)
    codes[:, 2] = 1
    stream = shn_transform.write(codes, BOOK, 1.0, 0.0)
    read(stream, book(3))
    sizes = bytes([4, 0, 0, 0, 0, 0])
    planes = [stream.planes[0], *[np.zeros(3, np.uint8)] * 4]
    broken = changed(stream, params=stream.params[:16] + sizes, planes=planes)
    assert refusal(broken, book(3)) == ("stream-planes", "6.14")


def test_parameters_of_another_length_are_refused():
    stream = good()
    for params in (b"", stream.params[:15], stream.params[:-1], stream.params + b"\0"):
        assert refusal(changed(stream, params=params))[0] == "stream-params"


def test_a_basis_without_rows_holds_zeros_alone():
    stream = shn_transform.write(np.zeros((4, 3), np.int64), BOOK, 1.0, 0.0)
    assert not read(stream, book(0)).any()
    assert refusal(good(), book(0)) == ("basis-width", "6.14")


def test_more_width_than_the_basis_has_is_refused():
    assert refusal(good(), book(19)) == ("basis-width", "6.14")
    wide = Stream(
        Attribute.SHN, Kind.BASIS, 2,
        struct.pack("<IffHH", BOOK, 1.0, 0.0, 256, 0) + bytes(24), [np.zeros(2, np.uint8)],
    )  # fmt: skip
    assert refusal(wide, book(300)) == ("basis-width", "6.14")


def test_a_basis_of_huge_values_is_refused_in_the_rows_that_are_used():
    codebook = book(21)
    codebook.shN[20, 3, 1] = 2.0**33
    read(good(), codebook)
    codebook.shN[19, 3, 1] = -(2.0**33)
    assert refusal(good(), codebook) == ("basis-value", "6.14")


def test_ends_beyond_the_width_are_refused():
    stream = good()
    for value in (21, 255):
        ends = stream.planes[0].copy()
        ends[3] = value
        assert refusal(changed(stream, planes=[ends, *stream.planes[1:]])) == ("code-range", "6.14")


def test_other_ends_ask_for_planes_of_other_lengths():
    stream = good()
    ends = stream.planes[0].copy()
    ends[:] = 20
    code, _ = refusal(changed(stream, planes=[ends, *stream.planes[1:]]))
    assert code in ("plane-length", "zstd-size", "plane-digits")


def test_another_number_or_length_of_planes_is_refused():
    stream = good()
    planes = list(stream.planes)
    for other in (planes[:-1], [*planes, planes[-1]], planes[:1], []):
        assert refusal(changed(stream, planes=other)) == ("stream-planes", "6.14")
    for place in range(1, len(planes)):
        longer = np.append(planes[place], np.full(20, 255, np.uint8))
        other = [*planes[:place], longer, *planes[place + 1 :]]
        assert refusal(changed(stream, planes=other))[0] in ("plane-length", "zstd-size")


def test_the_codebook_must_be_of_colours_and_of_the_degree():
    stream = good()
    assert refusal(stream, book(20, coefficients=8)) == ("codebook-missing", "6.7")
    with pytest.raises(FormatError) as caught:
        decode_tail(memoryview(records.pack([stream])), {}, np.empty((50, 15, 3), f32), "chunk 7")
    assert caught.value.code == "codebook-missing"


def test_bands_beside_a_basis_stream_are_refused():
    values = np.zeros((50, 9), f32)
    band = scalar.write(Attribute.SH1, values, fit(values, 1.0))
    out = np.empty((50, 15, 3), f32)
    with pytest.raises(FormatError) as caught:
        decode_tail(memoryview(records.pack([good(), band])), {BOOK: book(20)}, out, "chunk 7")
    assert caught.value.code == "stream-unexpected"


def test_the_worked_example_of_the_clause():
    """The five rows of SPEC 6.14."""
    codes = np.array([[1, -1, 0], [0, 0, 0], [3, 0, 1], [0, 2, 0], [-1, 0, 0]])
    stream = shn_transform.write(codes, BOOK, 1.0, 0.0)
    assert stream.params[16:] == bytes([1, 1, 0, 1, 0, 0])
    planes = [plane.tolist() for plane in stream.planes]
    assert planes == [[2, 0, 3, 2, 1], [5, 1, 0], [1], [1, 2]]
    codebook = book(3)
    assert read(stream, codebook).tobytes() == plain_shn(stream, codebook).tobytes()
