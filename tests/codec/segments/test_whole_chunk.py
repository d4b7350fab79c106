"""Chunks decoded by the compiled chunk reader, against numpy."""

from dataclasses import replace

import numpy as np
import pytest
from encoding import encode, unseen

from cogsplat.codec.errors import CogsplatError
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.segments.codebooks import decode_colour_codebook, decode_shape_codebook
from cogsplat.codec.segments.whole_chunk import decode_chunk
from cogsplat.codec.splats import empty
from cogsplat.codec.streams import decoding_tiers, records
from cogsplat.codec.streams.records import Attribute
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")
MUTANTS = 400

# Heads, refinements and tails. Tails of `vq` are indices.
EVERY_PART = pytest.mark.parametrize(
    ("profile", "part"),
    [("transform", 0), ("transform", 1), ("transform", 2), ("vq", 0), ("vq", 2)],
    indirect=["profile"],
)


def decode_codebooks(encoded):
    """Return the shape and the colour codebooks of an encoded scene by number."""
    shapes, colours = {}, {}
    for number, book in enumerate(encoded.codebooks):
        if book.attribute == "shape":
            payload = memoryview(book.payloads[0])
            shapes[number] = decode_shape_codebook(payload, book.rows, "codebook")
        else:
            payloads = {band: memoryview(data) for band, data in enumerate(book.payloads, start=1)}
            colours[number] = decode_colour_codebook(payloads, book.rows, 3, "codebook")
    return shapes, colours


@pytest.fixture(scope="module", params=["transform", "vq"])
def profile(request):
    return request.param


@pytest.fixture(scope="module")
def encoded(profile):
    scene = synth(2500, sh_degree=3)
    if profile == "vq":
        # Few colours and shapes, so that codebooks save more than they take, and escape rows.
        rng = np.random.default_rng(8)
        colours = rng.normal(0, 0.3, (6, *scene.shN.shape[1:])).astype(np.float32)
        alike = np.where(rng.random(len(scene)) < 0.8, rng.integers(9, size=len(scene)), 0)
        alike = np.where(alike, alike, np.arange(len(scene)))
        scene = replace(
            scene,
            shN=colours[rng.integers(6, size=len(scene))],
            quats=scene.quats[alike],
            scales=scene.scales[alike] + rng.normal(0, 1, (len(scene), 1)).astype(np.float32),
        )
    scores = score(scene, synth_cameras(6, 96, 72), ScoreConfig(jitter=False))
    config = unseen(profile=profile, prune=None, order="contribution")
    return encode(scene, scores, config)


@pytest.fixture(scope="module")
def books(encoded):
    return decode_codebooks(encoded)


@pytest.fixture
def switch():
    before = decoding_tiers.is_compiled()
    yield decoding_tiers.use_compiled
    decoding_tiers.use_compiled(before)


@pytest.fixture
def answers(monkeypatch):
    """Return a list of the answers of the compiled chunk reader, True where it decoded a chunk."""
    found = []
    plain = decoding_tiers.chunk_reader

    def chunk_reader():
        reader = plain()
        if reader is None:
            return None

        def read(*arguments):
            found.append(reader(*arguments))
            return found[-1]

        return read

    monkeypatch.setattr(decoding_tiers, "chunk_reader", chunk_reader)
    return found


def decode(payloads, rows, books, degree=3):
    """Return the bits of a chunk, or the code of its refusal."""
    out = empty(degree, rows)
    views = [None if payload is None else memoryview(payload) for payload in payloads]
    try:
        decode_chunk(*views, books, out, "chunk", sh_degree=3)
    except CogsplatError as error:
        return error.code
    return [getattr(out, name).tobytes() for name in ARRAYS]


def escapes_of(chunk):
    streams = records.unpack(memoryview(chunk.payloads.head), "head", chunk.splats)
    return [stream for stream in streams if stream.flags & records.ESCAPE]


def payloads_of(chunk):
    return [chunk.payloads.head, chunk.payloads.refinement, chunk.payloads.tail]


def largest_chunk(encoded):
    """Return a chunk with all segments that its profile writes."""
    return next(c for c in encoded.chunks if c.payloads.refinement is not None or c.splats > 1000)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("segments", [(0, 1, 2), (0, 2), (0, 1), (0,)])
def test_the_compiled_pass_gives_the_same_bits(
    profile, encoded, books, switch, answers, segments, degree
):
    refined = 0
    for chunk in encoded.chunks:
        parts = [p if n in segments else None for n, p in enumerate(payloads_of(chunk))]
        refined += parts[1] is not None
        switch(False)
        plain = decode(parts, chunk.splats, books, degree)
        assert switch(True)
        assert decode(parts, chunk.splats, books, degree) == plain
    assert answers == [True] * len(encoded.chunks)
    assert (refined > 0) is (1 in segments)
    if profile == "vq":
        assert [book.attribute for book in encoded.codebooks] == ["colour", "shape"]
        assert {c.payloads.tail_needs for c in encoded.chunks} == {(0,)}
        assert {c.payloads.head_needs for c in encoded.chunks} == {(1,)}
        assert all(book.rows < 20 for book in encoded.codebooks)
        assert {s.attribute for c in encoded.chunks for s in escapes_of(c)} == {
            Attribute.SCALES,
            Attribute.QUATS,
        }


@EVERY_PART
def test_damaged_chunks_decode_or_fail_alike(encoded, books, switch, answers, part):
    rng = np.random.default_rng(part)
    chunk = largest_chunk(encoded)
    parts = payloads_of(chunk)
    outcomes = set()
    for _ in range(MUTANTS):
        damaged = bytearray(parts[part])
        # Most of them among records, parameters and words, which come first.
        at = int(rng.integers(min(len(damaged), 700) if rng.random() < 0.8 else len(damaged)))
        damaged[at] = rng.integers(256)
        mutant = [bytes(damaged) if n == part else p for n, p in enumerate(parts)]
        switch(False)
        plain = decode(mutant, chunk.splats, books)
        assert switch(True)
        assert decode(mutant, chunk.splats, books) == plain, at
        outcomes.add(plain if isinstance(plain, str) else "decoded")
    assert any(answers)
    assert len(outcomes) > 6


@EVERY_PART
def test_the_pass_declines_short_and_long_payloads(profile, encoded, books, switch, answers, part):
    chunk = largest_chunk(encoded)
    parts = payloads_of(chunk)
    switch(True)
    for payload in (parts[part][:-1], parts[part][:13], parts[part][:1], parts[part] + b"\0"):
        changed = [payload if n == part else p for n, p in enumerate(parts)]
        assert decode(changed, chunk.splats, books) == "stream-record"
    assert decode(parts, chunk.splats, ({}, {})) == "codebook-missing"
    assert decode(parts, chunk.splats + 1, books) == "stream-rows"
    # Tails of indices are read by numpy, whatever the compiled reader decoded before.
    assert any(answers) is (profile == "vq" and part == 2)


def test_the_pass_declines_other_streams(switch, answers):
    switch(True)
    scene = synth(1500, sh_degree=0)
    encoded = encode(scene, None, unseen(profile="near-lossless", prune=None))
    for chunk in encoded.chunks:
        decode(payloads_of(chunk), chunk.splats, ({}, {}), degree=0)
    assert answers
    assert not any(answers)


def test_numpy_decodes_if_the_pass_is_not_in_use(switch):
    switch(False)
    assert decoding_tiers.chunk_reader() is None
