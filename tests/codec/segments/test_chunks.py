"""Chunks decoded whole by kernels, against the readers of single streams in numpy."""

import numpy as np
import pytest
from encoding import encode, unseen

from cogsplat.codec.errors import CogsplatError
from cogsplat.codec.scoring.contribution import ScoreConfig, score
from cogsplat.codec.segments.chunks import decode_chunk
from cogsplat.codec.segments.codebooks import decode_colour_codebook
from cogsplat.codec.splats import empty
from cogsplat.codec.streams import compiled, whole_chunk
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")
MUTANTS = 700


@pytest.fixture(scope="module")
def encoded():
    scene = synth(2500, sh_degree=3)
    scores = score(scene, synth_cameras(6, 96, 72), ScoreConfig(jitter=False))
    return encode(scene, scores, unseen(prune=None, order="contribution"))


@pytest.fixture(scope="module")
def books(encoded):
    colour = encoded.codebooks[0]
    payloads = {band: memoryview(data) for band, data in enumerate(colour.payloads, start=1)}
    return {0: decode_colour_codebook(payloads, colour.rows, 3, "codebook")}


@pytest.fixture
def switch():
    before = compiled.ready()
    yield compiled.use
    compiled.use(before)


@pytest.fixture
def taken(monkeypatch):
    """Return what the reader of whole chunks has answered."""
    answers = []
    real = whole_chunk.read

    def read(*arguments):
        answers.append(real(*arguments))
        return answers[-1]

    monkeypatch.setattr(whole_chunk, "read", read)
    return answers


def decoded(payloads, rows, books, degree=3):
    """Return the bits of a chunk, or the code of its refusal."""
    out = empty(degree, rows)
    views = [None if payload is None else memoryview(payload) for payload in payloads]
    try:
        decode_chunk(*views, ({}, books), out, "chunk", sh_degree=3)
    except CogsplatError as error:
        return error.code
    return [getattr(out, name).tobytes() for name in ARRAYS]


def payloads_of(chunk):
    return [chunk.payloads.head, chunk.payloads.refinement, chunk.payloads.tail]


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("left", [(0, 1, 2), (0, 2), (0, 1), (0,)])
def test_usual_chunks_are_read_whole_to_the_same_bits(encoded, books, switch, taken, left, degree):
    refined = 0
    for chunk in encoded.chunks:
        parts = [p if n in left else None for n, p in enumerate(payloads_of(chunk))]
        refined += parts[1] is not None
        switch(False)
        plain = decoded(parts, chunk.splats, books, degree)
        assert switch(True)
        assert decoded(parts, chunk.splats, books, degree) == plain
    assert taken == [False, True] * len(encoded.chunks)
    assert (refined > 0) is (1 in left)


@pytest.mark.parametrize("part", [0, 1, 2])
def test_damaged_chunks_come_to_the_same_end_either_way(encoded, books, switch, taken, part):
    rng = np.random.default_rng(part)
    chunk = next(chunk for chunk in encoded.chunks if chunk.payloads.refinement is not None)
    parts = payloads_of(chunk)
    outcomes = set()
    for _ in range(MUTANTS):
        damaged = bytearray(parts[part])
        # Most of them among records, parameters and words, which stand in front.
        at = int(rng.integers(min(len(damaged), 700) if rng.random() < 0.8 else len(damaged)))
        damaged[at] = rng.integers(256)
        mutant = [bytes(damaged) if n == part else p for n, p in enumerate(parts)]
        switch(False)
        plain = decoded(mutant, chunk.splats, books)
        assert switch(True)
        assert decoded(mutant, chunk.splats, books) == plain, at
        outcomes.add(plain if isinstance(plain, str) else "decoded")
    assert any(taken)
    assert len(outcomes) > 6


@pytest.mark.parametrize("part", [0, 1, 2])
def test_short_and_long_payloads_are_not_read_whole(encoded, books, switch, taken, part):
    chunk = next(chunk for chunk in encoded.chunks if chunk.payloads.refinement is not None)
    parts = payloads_of(chunk)
    switch(True)
    for payload in (parts[part][:-1], parts[part][:13], parts[part][:1], parts[part] + b"\0"):
        changed = [payload if n == part else p for n, p in enumerate(parts)]
        assert decoded(changed, chunk.splats, books) == "stream-record"
    assert decoded(parts, chunk.splats, {}) == "codebook-missing"
    assert decoded(parts, chunk.splats + 1, books) == "stream-rows"
    assert not any(taken)


def test_other_streams_are_left_to_their_readers(switch, taken):
    switch(True)
    for profile in ("vq", "near-lossless"):
        scene = encode(synth(1500, sh_degree=0), None, unseen(profile=profile, prune=None))
        for chunk in scene.chunks:
            decoded(payloads_of(chunk), chunk.splats, {}, degree=0)
    assert taken
    assert not any(taken)
