from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.errors import FormatError
from cogsplat.codec.segments.codebooks import (
    ColourCodebook,
    ShapeCodebook,
    decode_colour_codebook,
    decode_shape_codebook,
)
from cogsplat.codec.segments.heads import decode_head
from cogsplat.codec.segments.tails import decode_tail
from cogsplat.codec.splats import empty, sh_coefficients
from cogsplat.codec.streams import (
    codebook_index,
    kinds,
    quaternion,
    records,
    scalar,
    scale_differences,
    swing_twist,
)
from cogsplat.codec.streams.adaptive_step import StepModel
from cogsplat.codec.streams.grid import fit
from cogsplat.codec.streams.records import COMPONENTS, SH_BANDS, Attribute

ROWS = 40
UNSET = np.float32(-777)


def rng(seed):
    return np.random.default_rng(seed)


def numbers(attribute, rows=ROWS, seed=None, step=0.01, escape=False):
    """A stream and the values it decodes to."""
    size = (rows, COMPONENTS[attribute])
    values = rng(attribute if seed is None else seed).normal(size=size).astype(np.float32)
    grid = fit(values, step)
    stream = scalar.write(attribute, values, grid, escape=escape)
    return stream, grid.dequantise(grid.quantise(values))


def turns(rows=ROWS, seed=5, escape=False):
    quats = rng(seed).normal(size=(rows, 4)).astype(np.float32)
    quats /= np.sqrt(np.square(quats).sum(axis=1, keepdims=True))
    quats[quats[:, 0] < 0] *= -1
    stream = quaternion.write(quats, 1e-3, escape=escape)
    (one,) = records.unpack(memoryview(records.pack([stream])), "alone", rows)
    out = np.empty((rows, 4), np.float32)
    kinds.read(one, out)
    return stream, out


def shape_book(rows=9):
    scales = rng(20).normal(size=(rows, 3)).astype(np.float32)
    return ShapeCodebook(scales, turns(rows, 21)[1])


def colour_book(rows=9, degree=3):
    size = (rows, sh_coefficients(degree) - 1, 3)
    return ColourCodebook(rng(22).normal(size=size).astype(np.float32))


def blank(rows=ROWS, degree=3):
    out = empty(degree, rows)
    for array in (out.means, out.scales, out.quats, out.opacities, out.sh0, out.shN):
        array[:] = UNSET
    return out


def head(parts, out, books=None):
    payload = memoryview(records.pack([stream for stream, _ in parts]))
    decode_head(payload, books or {}, out, "chunk 3, head")


def tail(parts, out, books=None, **options):
    payload = memoryview(records.pack([stream for stream, _ in parts]))
    decode_tail(payload, books or {}, out, "chunk 3, tail", **options)


def plain():
    rest = (Attribute.MEANS, Attribute.OPACITIES, Attribute.SH0)
    return [numbers(Attribute.SCALES), turns(), *map(numbers, rest)]


def indices(attribute, size, escape, book=0, rows=ROWS):
    """Indices of which the last `escape` rows are the chunk's own, in order."""
    values = rng(23).integers(0, max(size, 1), rows).astype(np.uint32)
    values[0] = max(size, 1) - 1
    if escape:
        values[-escape:] = size
    stream = codebook_index.write(attribute, values, book, size)
    if escape:
        values[-escape:] += np.arange(escape, dtype=np.uint32)
    return stream, values


def shaped(escape=0, book=0):
    own = (
        [numbers(Attribute.SCALES, escape, escape=True), turns(escape, escape=True)]
        if escape
        else []
    )
    shape = [indices(Attribute.SHAPE, 9, escape, book), numbers(Attribute.SCALE_FACTOR)]
    rest = (Attribute.MEANS, Attribute.OPACITIES, Attribute.SH0)
    return [*own, *shape, *map(numbers, rest)]


def refusal(call, *args, **options):
    with pytest.raises(FormatError, match=r"chunk 3|codebook") as caught:
        call(*args, **options)
    assert caught.value.clause
    return caught.value.code


# Heads.


def test_a_head_of_numbers_is_written_bit_for_bit():
    out, parts = blank(), plain()
    head(parts, out)
    written = (out.scales, out.quats, out.means, out.opacities[:, None], out.sh0)
    for actual, (_, expected) in zip(written, parts, strict=True):
        assert actual.tobytes() == expected.tobytes()
    assert (out.shN == UNSET).all()


@pytest.mark.parametrize("escape", [0, 1, 7, ROWS])
def test_a_head_of_shapes_takes_them_from_the_codebook_and_its_own(escape):
    out, parts, book = blank(), shaped(escape, book=4), shape_book()
    head(parts, out, {4: book, 0: colour_book()})
    (_, rows), (_, factor), (_, means) = parts[-5:-2]
    scales, quats = book.scales, book.quats
    if escape:
        scales = np.concatenate([scales, parts[0][1]])
        quats = np.concatenate([quats, parts[1][1]])
    assert out.scales.tobytes() == (scales[rows] + factor).tobytes()
    assert out.quats.tobytes() == quats[rows].tobytes()
    assert out.means.tobytes() == means.tobytes()


def test_a_head_writes_its_own_rows_only():
    whole = blank(3 * ROWS)
    head(plain(), whole.take(slice(ROWS, 2 * ROWS)))
    for array in (whole.means, whole.scales, whole.quats, whole.opacities, whole.sh0):
        assert (array[:ROWS] == UNSET).all()
        assert (array[2 * ROWS :] == UNSET).all()
        assert not (array[ROWS : 2 * ROWS] == UNSET).any()


@pytest.mark.parametrize("missing", range(5))
def test_a_head_without_one_of_its_streams_is_refused(missing):
    parts = plain()
    del parts[missing]
    assert refusal(head, parts, blank()) == "stream-missing"


@pytest.mark.parametrize("missing", range(7))
def test_a_head_of_shapes_without_one_of_its_streams_is_refused(missing):
    parts = shaped(3)
    del parts[missing]
    assert refusal(head, parts, blank(), {0: shape_book()}) == "stream-missing"


@pytest.mark.parametrize(
    "extra",
    [Attribute.SH1, Attribute.SH3, Attribute.SCALE_FACTOR],
)
def test_streams_that_have_no_place_in_a_head_are_refused(extra):
    assert refusal(head, [*plain(), numbers(extra)], blank()) == "stream-unexpected"
    escape = numbers(Attribute.MEANS, 3, escape=True)
    assert refusal(head, [*plain(), escape], blank()) == "stream-unexpected"
    both = [*shaped(), numbers(Attribute.SCALES)]
    assert refusal(head, both, blank(), {0: shape_book()}) == "stream-unexpected"
    unused = [*shaped(), numbers(Attribute.SCALES, 2, escape=True)]
    assert refusal(head, unused, blank(), {0: shape_book()}) == "stream-unexpected"


def test_streams_of_another_number_of_rows_are_refused():
    for position in range(5):
        parts = plain()
        name = parts[position][0].attribute
        short = turns(ROWS - 1) if name == Attribute.QUATS else numbers(name, ROWS - 1)
        parts[position] = short
        assert refusal(head, parts, blank()) == "stream-rows"
        assert refusal(head, plain(), blank(ROWS + 1)) == "stream-rows"
        assert refusal(head, plain(), blank(ROWS - 1)) == "stream-rows"
    parts = shaped(3)
    parts[0] = numbers(Attribute.SCALES, 2, escape=True)
    assert refusal(head, parts, blank(), {0: shape_book()}) == "stream-rows"


def test_shapes_need_the_shape_codebook_they_name():
    for books in ({}, {1: shape_book()}, {0: colour_book()}):
        assert refusal(head, shaped(), blank(), books) == "codebook-missing"
    assert refusal(head, shaped(), blank(), {0: shape_book(8)}) == "index-range"
    assert refusal(head, shaped(2), blank(), {0: shape_book(8)}) == "index-range"


def test_indices_where_numbers_belong_are_refused():
    parts = plain()
    parts[4] = indices(Attribute.SH0, 9, 0)
    assert refusal(head, parts, blank()) == "stream-kind"
    parts = shaped()
    parts[0] = numbers(Attribute.SHAPE)
    assert refusal(head, parts, blank(), {0: shape_book()}) == "stream-kind"


def test_streams_of_a_head_may_stand_in_any_order():
    parts = plain()
    for order in ((4, 3, 2, 1, 0), (2, 0, 4, 1, 3)):
        out = blank()
        head([parts[place] for place in order], out)
        written = (out.scales, out.quats, out.means, out.opacities[:, None], out.sh0)
        for actual, (_, expected) in zip(written, parts, strict=True):
            assert actual.tobytes() == expected.tobytes()


@pytest.mark.parametrize("extra", [bytes(1), bytes(40), b"\xff\xff"])
def test_bytes_behind_the_last_plane_of_a_head_are_refused(extra):
    payload = records.pack([stream for stream, _ in plain()]) + extra
    with pytest.raises(FormatError, match="chunk 3") as caught:
        decode_head(memoryview(payload), {}, blank(), "chunk 3, head")
    assert caught.value.code == "stream-record"


# Tails.


def bands(degree, rows=ROWS, escape=False):
    return [numbers(attribute, rows, escape=escape) for attribute in SH_BANDS[:degree]]


def joined(parts, rows=ROWS):
    return np.concatenate([values.reshape(rows, -1, 3) for _, values in parts], axis=1)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("wanted", [0, 1, 2, 3])
def test_a_tail_of_bands_fills_what_is_wanted(degree, wanted):
    out, parts = blank(degree=wanted), bands(degree)
    tail(parts, out.shN)
    expected = np.zeros((ROWS, 15, 3), np.float32)
    if parts:
        expected[:, : sh_coefficients(degree) - 1] = joined(parts)
    assert out.shN.tobytes() == expected[:, : sh_coefficients(wanted) - 1].tobytes()


def test_bands_that_are_absent_are_zeros():
    out, parts = blank(), bands(3)
    tail([parts[0], parts[2]], out.shN)
    assert (out.shN[:, 3:8] == 0).all()
    assert out.shN[:, 8:].tobytes() == joined([parts[2]]).tobytes()


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_bands_above_the_files_degree_are_refused(degree):
    out = blank(degree=degree)
    tail(bands(degree), out.shN, sh_degree=degree)
    code = refusal(tail, bands(3), out.shN, sh_degree=degree)
    assert code == "stream-unexpected"


@pytest.mark.parametrize("escape", [0, 1, 5, ROWS])
@pytest.mark.parametrize("wanted", [0, 1, 2, 3])
def test_a_tail_of_colours_takes_them_from_the_codebook_and_its_own(escape, wanted):
    out, book = blank(degree=wanted), colour_book()
    own = bands(3, escape, escape=True) if escape else []
    choice = indices(Attribute.SHN, 9, escape, book=1)
    tail([*own, choice], out.shN, {0: shape_book(), 1: book})
    rows = book.shN
    if escape:
        rows = np.concatenate([rows, joined(own, escape)])
    assert out.shN.tobytes() == rows[choice[1]][:, : sh_coefficients(wanted) - 1].tobytes()


def test_bands_of_kept_colours_that_are_absent_are_zeros():
    out, book = blank(), colour_book()
    own = bands(3, ROWS, escape=True)
    tail([own[1], indices(Attribute.SHN, 9, ROWS)], out.shN, {0: book})
    assert (out.shN[:, :3] == 0).all()
    assert (out.shN[:, 8:] == 0).all()
    assert out.shN[:, 3:8].tobytes() == joined([own[1]]).tobytes()


def test_colours_need_a_colour_codebook_of_a_sufficient_degree():
    choice = indices(Attribute.SHN, 9, 0)
    for books in ({}, {1: colour_book()}, {0: shape_book()}, {0: colour_book(degree=2)}):
        assert refusal(tail, [choice], blank().shN, books) == "codebook-missing"
    tail([choice], blank(degree=2).shN, {0: colour_book(degree=2)})


def test_streams_that_have_no_place_in_a_tail_are_refused():
    out = blank().shN
    assert refusal(tail, [*bands(3), numbers(Attribute.SH0)], out) == "stream-unexpected"
    both = [indices(Attribute.SHN, 9, 0), *bands(1)]
    assert refusal(tail, both, out, {0: colour_book()}) == "stream-unexpected"
    own = bands(3, 2, escape=True)
    unused = [*own, indices(Attribute.SHN, 9, 0)]
    assert refusal(tail, unused, out, {0: colour_book()}) == "stream-unexpected"
    short = [*bands(3, 2, escape=True), indices(Attribute.SHN, 9, 3)]
    assert refusal(tail, short, out, {0: colour_book()}) == "stream-rows"


# Codebooks.


def test_a_shape_codebook_comes_back():
    parts = [numbers(Attribute.SCALES), turns()]
    book = decode_shape_codebook(
        memoryview(records.pack([stream for stream, _ in parts])), ROWS, "codebook 0"
    )
    assert len(book) == ROWS
    assert book.nbytes == ROWS * 28
    assert book.scales.tobytes() == parts[0][1].tobytes()
    assert book.quats.tobytes() == parts[1][1].tobytes()


@pytest.mark.parametrize("escape", [False, True])
def test_rows_turn_by_steps_that_follow_from_their_own_scales(escape):
    scales = np.sort(rng(30).normal(0, 2, (ROWS, 3)), axis=1)[:, [1, 0, 2]].astype(np.float32)
    differences = scale_differences.differences_of(scales)
    grid = fit(differences, 0.01)
    stored = scale_differences.scales_of(grid.dequantise(grid.quantise(differences)))
    model = StepModel((4.0, 1.0, 0.5, 0.0, 0.5, 0.0))
    angles = rng(31).uniform(-0.7, 0.7, (ROWS, 3))
    extra = swing_twist.extra_bits_of(stored, model, model)
    assert len(set(extra[0].tolist())) > 3
    turned = swing_twist.dequantise(swing_twist.quantise(angles[:, 0], extra[0]), extra[0])
    own = [
        scale_differences.write(differences, grid),
        swing_twist.write(angles, stored, model, model),
    ]
    out, book = blank(), shape_book()
    if escape:
        own = [(replace(stream, flags=records.ESCAPE), None) for stream in own]
        factor = numbers(Attribute.SCALE_FACTOR)
        index = indices(Attribute.SHAPE, 9, ROWS)
        rest = (Attribute.MEANS, Attribute.OPACITIES, Attribute.SH0)
        head([*own, index, factor, *map(numbers, rest)], out, {0: book})
        assert out.scales.tobytes() == (stored + factor[1]).tobytes()
        quats = out.quats
    else:
        book = decode_shape_codebook(memoryview(records.pack(own)), ROWS, "codebook 0")
        assert book.scales.tobytes() == stored.tobytes()
        quats = book.quats
    # a is (x·w - y·z) / (w² + z²).
    w, x, y, z = quats.T.astype(np.float64)
    np.testing.assert_allclose((x * w - y * z) / (w * w + z * z), turned, atol=1e-5)


def test_shape_codebooks_that_break_the_rules_are_refused():
    scales, quats = numbers(Attribute.SCALES)[0], turns()[0]

    def read(*given, rows=ROWS):
        return refusal(decode_shape_codebook, memoryview(records.pack(given)), rows, "codebook 0")

    assert read(scales) == read(quats) == read() == "stream-missing"
    assert read(scales, quats, rows=ROWS - 1) == read(scales, quats, rows=ROWS + 1) == "stream-rows"
    assert read(scales, quats, numbers(Attribute.SH0)[0]) == "stream-unexpected"
    assert read(numbers(Attribute.SCALES, escape=True)[0], quats) == "stream-missing"


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_colour_codebook_comes_back_band_by_band(degree):
    parts = bands(degree)
    payloads = {
        band: memoryview(records.pack([stream])) for band, (stream, _) in enumerate(parts, start=1)
    }
    book = decode_colour_codebook(payloads, ROWS, degree, "codebook 1")
    assert len(book) == ROWS
    assert book.nbytes == book.shN.nbytes
    assert book.shN.tobytes() == joined(parts).tobytes()
    first = decode_colour_codebook({1: payloads[1]}, ROWS, degree, "codebook 1")
    assert first.shN[:, :3].tobytes() == parts[0][1].tobytes()
    assert (first.shN[:, 3:] == 0).all()


def test_colour_codebook_segments_hold_their_own_band_alone():
    one, two = (memoryview(records.pack([stream])) for stream, _ in bands(2))
    both = memoryview(records.pack([stream for stream, _ in bands(2)]))
    for payloads in ({1: two}, {1: both}, {2: one}):
        code = refusal(decode_colour_codebook, payloads, ROWS, 3, "codebook 1")
        assert code == "stream-unexpected"
    assert refusal(decode_colour_codebook, {1: one}, ROWS + 1, 3, "codebook 1") == "stream-rows"
