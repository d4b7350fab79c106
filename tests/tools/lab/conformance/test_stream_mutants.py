"""Small mistakes in the decoding of streams, each of which at least one conformance file shows."""

import pytest
from mutants import Mutant, apply, outcome, told, vectors_of

from cogsplat.codec.segments import stream_set
from cogsplat.codec.streams import (
    bit_fields,
    byte_planes,
    codebook_index,
    decoding_tiers,
    refinement_bits,
    scalar,
    sorted_means,
    swing_twist,
)
from cogsplat.tools.lab.conformance import reference_decoder, reference_streams

REFERENCE = [
    Mutant(
        "half a level is not taken off",
        reference_streams._sorted,
        " - (1 << more) // 2",
        "",
        ("6.17",),
    ),
    Mutant(
        "extra bits of means follow from scales without their factor",
        reference_decoder._head,
        "coarse, quats = scales, [row[3:] for row in shapes]",
        "coarse, quats = [row[:3] for row in shapes], [row[3:] for row in shapes]",
        ("6.5",),
    ),
    Mutant(
        "a step model adds in float64",
        reference_streams.extra_bits,
        "total = f32(total + f32(factor * feature))",
        "total = math.ceil(total + factor * feature)",
        ("6.10",),
    ),
    Mutant(
        "a last code of shN is stored as it is",
        reference_streams.shn_basis,
        "code + part for place",
        "code for place",
        ("6.14",),
    ),
]


@pytest.mark.parametrize("mutant", REFERENCE, ids=lambda m: m.name)
def test_mistakes_of_the_second_decoder_show(mutant, monkeypatch):
    files = vectors_of("valid", mutant.clauses)
    right = [told(data) for _, data in files]
    apply(mutant, monkeypatch)
    assert [told(data) for _, data in files] != right


READER = [
    Mutant(
        "codes of rotations above 2^h are read",
        swing_twist.read,
        "if bool((codes >",
        "if False and bool((codes >",
        ("6.11",),
    ),
    Mutant(
        "escape rows that no index takes are overlooked",
        codebook_index.read_indices,
        "if len(escaped) != escape_rows:",
        "if len(escaped) > escape_rows:",
        ("6.7",),
    ),
    Mutant(
        "digits of a float stream are skipped",
        stream_set.RefinementSet.pop,
        "if stream.kind != wanted:",
        "if wanted is not None and stream.kind != wanted:",
        ("7.4",),
    ),
    Mutant(
        "planes of any size are read",
        byte_planes.parse_packing,
        "if length > MAX_PLANE_BYTES:",
        "if False:",
        ("9.1",),
    ),
    Mutant(
        "infinities have as many levels as others",
        scalar.parse,
        "grids.MAX_LEVELS - infinity_codes(stream)",
        "grids.MAX_LEVELS",
        ("6.4",),
    ),
    Mutant(
        "Morton codes may have 63 bits",
        sorted_means.unpack_differences,
        "(codes >> np.uint64(MORTON_BITS))",
        "(codes >> np.uint64(63))",
        ("6.5",),
    ),
    Mutant(
        "codes above 2^24 are not rounded",
        sorted_means.dequantise,
        "codes.astype(np.float32) * step",
        "codes * step.astype(np.float64)",
        ("6.5",),
    ),
    Mutant(
        "bits after bit fields are ignored",
        bit_fields.require_padding,
        "if total & 7 and",
        "if False and",
        ("6.15",),
    ),
    Mutant(
        "refined codes below 0 are read",
        refinement_bits.read,
        "if int(refined.min(initial=0)) < 0:",
        "if False:",
        ("6.17",),
    ),
]


@pytest.fixture
def in_numpy():
    """Decode with numpy, whose readers the mutants change."""
    before = decoding_tiers.is_compiled()
    decoding_tiers.use_compiled(False)
    yield
    decoding_tiers.use_compiled(before)


@pytest.mark.parametrize("mutant", READER, ids=lambda m: m.name)
def test_mistakes_of_a_reader_show(mutant, in_numpy, monkeypatch):
    monkeypatch.setattr(decoding_tiers, "_load", lambda: None)
    files = vectors_of("valid", mutant.clauses) + vectors_of("invalid", mutant.clauses)
    right = [outcome(entry, data) for entry, data in files]
    assert [c for c, (e, _) in zip(right, files, strict=True) if "code" in e] == [
        e["code"] for e, _ in files if "code" in e
    ]
    apply(mutant, monkeypatch)
    assert [outcome(entry, data) for entry, data in files] != right
