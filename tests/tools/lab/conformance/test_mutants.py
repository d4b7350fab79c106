"""Small mistakes in a decoder, each of which at least one conformance file must show."""

import msgpack
import pytest
from mutants import Mutant, apply, outcome, told, vectors_of

from cogsplat.codec.segments import prefix_compensation
from cogsplat.codec.streams import zstd_frames
from cogsplat.formats.cogs import (
    canonical_msgpack,
    decoded_rows,
    layout,
    reader,
    segment_rows,
    verification,
)
from cogsplat.tools.lab.conformance import (
    reference_compensation,
    reference_decoder,
    reference_file,
    reference_streams,
)

REFERENCE = [
    Mutant(
        "scales are blended in float64",
        reference_compensation.shifts,
        "_f32(lower[0] + _f32(_f32(upper[0] - lower[0]) * part))",
        "_f32(lower[0] + (upper[0] - lower[0]) * part)",
        ("8.5",),
    ),
    Mutant(
        "opacities are blended in float64",
        reference_compensation.shifts,
        "_f32(lower[1] + _f32(_f32(upper[1] - lower[1]) * part))",
        "_f32(lower[1] + (upper[1] - lower[1]) * part)",
        ("8.5",),
    ),
    Mutant(
        "the part of a blend is float64",
        reference_compensation.shifts,
        "part = _f32(sum(chunk_splats[below:chunks]) / sum(chunk_splats[below:end]))",
        "part = sum(chunk_splats[below:chunks]) / sum(chunk_splats[below:end])",
        ("8.5",),
    ),
    Mutant(
        "chunks count for the part of a blend, not their splats",
        reference_compensation.shifts,
        "part = _f32(sum(chunk_splats[below:chunks]) / sum(chunk_splats[below:end]))",
        "part = _f32((chunks - below) / (end - below))",
        ("8.5",),
    ),
    Mutant(
        "a shift of 0 is not added",
        reference_compensation.add_shift,
        "return [_f32(value + shift) for value in values]",
        "return [_f32(value + shift) if shift else value for value in values]",
        ("8.5",),
    ),
    Mutant(
        "0 is added to the whole scene",
        reference_compensation.shifts,
        "return None",
        "return [(0.0, 0.0)] * len(where)",
        ("8.5",),
    ),
    Mutant(
        "pages are taken to stand one behind the other",
        reference_file.File._add,
        "position = self._add(msgpack.unpackb(self.data[position:end]), end, (*path, row))",
        "self._add(msgpack.unpackb(self.data[position:end]), end, (*path, row)); position = end",
        ("5.6",),
    ),
    Mutant(
        "behind the last layer all splats count, not those of descendants",
        reference_compensation.set_shifts,
        "part = _f32((held - before) / (splats(every) - before))",
        "part = _f32(sum(sizes[last:prefix]) / sum(sizes[last:]))",
        ("8.5",),
    ),
    Mutant(
        "a tail is complete without its codebooks",
        reference_decoder._prefixes,
        "parts = [segment, *(s for b in needed for s in file.book_segments(b))]",
        "parts = [segment]",
        ("8.2",),
    ),
    Mutant(
        "codes above 2^24 are not rounded to float32",
        reference_streams._grid_value,
        "f32(f32(f32(code) * step) + minimum)",
        "f32(f32(code * step) + minimum)",
        ("6.5", "6.17"),
    ),
    Mutant(
        "steps below the least denormal do not become 0",
        reference_streams._sorted,
        "f32(step * 2.0 ** -(h + more))",
        "step * 2.0 ** -(h + more)",
        ("6.5", "6.17"),
    ),
    Mutant(
        "extra bits follow from refined scales",
        reference_decoder._head,
        "coarse = streams.numbers(payload[SCALES, 0])",
        "coarse = streams.numbers(payload[SCALES, 0], None, finer.get((SCALES, 0)))",
        ("7.4",),
    ),
    Mutant(
        "bytes of an attribute are taken the highest first",
        reference_decoder._attributes,
        "for row in range(rows) for plane in own)",
        "for row in range(rows) for plane in own[::-1])",
        ("5.7",),
    ),
]


@pytest.mark.parametrize("mutant", REFERENCE, ids=lambda m: m.name)
def test_mistakes_of_the_second_decoder_show(mutant, monkeypatch):
    files = [data for _, data in vectors_of("valid", mutant.clauses)]
    right = [told(data) for data in files]
    apply(mutant, monkeypatch)
    assert [told(data) for data in files] != right


def test_texts_without_their_byte_order_mark_show(monkeypatch):
    """TextDecoder of browsers drops it unless it is told not to."""
    ((_, data),) = [v for v in vectors_of("valid", ("4.1",)) if v[0]["name"] == "byte-order-mark"]
    right = told(data)
    unpackb = msgpack.unpackb

    def without_mark(value):
        if isinstance(value, dict):
            return {without_mark(k): without_mark(v) for k, v in value.items()}
        if isinstance(value, list):
            return [without_mark(v) for v in value]
        return value.removeprefix("\ufeff") if isinstance(value, str) else value

    monkeypatch.setattr(msgpack, "unpackb", lambda packed: without_mark(unpackb(packed)))
    assert told(data) != right


_header = zstd_frames._check_header
_enter = canonical_msgpack._Reader._enter

READER = [
    Mutant(
        "another minor version is read",
        layout.unpack_preamble,
        "if minor != MINOR:",
        "if minor < MINOR:",
        ("3.2",),
    ),
    Mutant(
        "an earlier minor version is read",
        layout.unpack_preamble,
        "if minor != MINOR:",
        "if minor > MINOR:",
        ("3.2",),
    ),
    Mutant(
        "values of msgpack are not counted",
        _enter,
        "self._values += values",
        "self._values += 0",
        ("4.1",),
    ),
    Mutant(
        "the depth of msgpack is checked last",
        _enter,
        'if depth == MAX_DEPTH:\n        raise self.error("msgpack-depth"',
        'if depth == MAX_DEPTH and values <= self.left:\n        raise self.error("msgpack-depth"',
        ("4.1",),
    ),
    Mutant(
        "lengths in too many bytes are accepted",
        canonical_msgpack._Reader._length,
        "if length < shortest:",
        "if length < 0:",
        ("4.1",),
    ),
    Mutant(
        "a text may be cut before it is seen that its length is too long",
        canonical_msgpack._Reader._length,
        "if length < shortest:",
        "if length < shortest and length <= self.left:",
        ("4.1",),
    ),
    Mutant(
        "a dictionary field of 0 is accepted",
        _header,
        "if descriptor & _DICTIONARY_BITS:",
        "if descriptor & _DICTIONARY_BITS and stored[header_bytes - size_bytes - 1]:",
        ("6.3",),
    ),
    Mutant(
        "the window is taken for a power of two",
        zstd_frames._window_bytes,
        "base + base // 8 * (descriptor & 7)",
        "base",
        ("6.3",),
    ),
    Mutant(
        "a frame may state fewer bytes than its plane has",
        _header,
        "if not size_bytes or stated != length:",
        "if not size_bytes or stated > length:",
        ("6.3",),
    ),
    Mutant(
        "blocks of a frame that states 0 bytes are not looked at",
        zstd_frames._decompress_frame,
        "if length:",
        "if True:",
        ("6.3",),
    ),
    Mutant(
        "the CRC of segments is not checked",
        reader.CogsFile.read_segment,
        "if zlib.crc32(data) != crc:",
        "if False:",
        ("5.3",),
    ),
    Mutant(
        "hashes are not checked",
        verification.read_verified,
        "if key_of(data) != file.segments.hash[row].tobytes():",
        "if False:",
        ("5.3",),
    ),
    Mutant(
        "attributes are not counted as decoded bytes",
        decoded_rows.row_bytes,
        "sum(kind.row_bytes for kind in kinds)",
        "0",
        ("9.2",),
    ),
    Mutant(
        "boxes are compared with coarse means alone",
        verification._progressive_checks,
        "if rows.refinement is not None:",
        "if False:",
        ("5.4",),
    ),
    Mutant(
        "boxes are compared with refined means alone",
        verification._require_inside,
        "if not ((means >= box[:3]) & (means <= box[3:])).all():",
        "if offset == file.offsets[file.chunk_rows(chunk).refinement or 0] and not "
        "((means >= box[:3]) & (means <= box[3:])).all():",
        ("5.4",),
    ),
    Mutant(
        "layers of compensation stand in any order",
        segment_rows._layer_rows,
        "if not np.array_equal(owners, np.arange(len(rows)))",
        "if not np.array_equal(np.sort(owners), np.arange(len(rows)))",
        ("5.9",),
    ),
    Mutant(
        "a shift of 0 is not added",
        prefix_compensation.Compensation.apply_per_chunk,
        "shifts = self.shifts_of(chunks[is_part], prefixes[is_part], own_parts)",
        "shifts = self.shifts_of(chunks[is_part], prefixes[is_part], own_parts)\n"
        "    if not shifts.any():\n        return splats",
        ("8.5",),
    ),
]


@pytest.mark.parametrize("mutant", READER, ids=lambda m: m.name)
def test_mistakes_of_a_reader_show(mutant, monkeypatch):
    files = vectors_of("valid", mutant.clauses) + vectors_of("invalid", mutant.clauses)
    right = [outcome(entry, data) for entry, data in files]
    assert [c for c, (e, _) in zip(right, files, strict=True) if "code" in e] == [
        e["code"] for e, _ in files if "code" in e
    ]
    apply(mutant, monkeypatch)
    assert [outcome(entry, data) for entry, data in files] != right
