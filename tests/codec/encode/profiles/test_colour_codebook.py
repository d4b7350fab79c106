from dataclasses import replace
from functools import cache

import decoding
import numpy as np
import oracle
import pytest
from encoding import encode, unseen

from cogsplat.codec.clustering.kmeans import TrainingConfig
from cogsplat.codec.encode import colour_transform
from cogsplat.codec.encode.profiles import colour_codebook
from cogsplat.codec.metrics import psnr
from cogsplat.codec.rate import allocation
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.splats import concatenate
from cogsplat.codec.streams import codebook_index, records
from cogsplat.codec.streams.records import Attribute, Kind

N = 4000
LAMBDA = 1e-6
CHUNKS = [slice(0, 500), slice(500, 2000), slice(2000, N)]
CAMERAS = [oracle.camera(angle) for angle in (0.0, 0.5, 1.1)]


def few_colours(seed, n=N, colours=4, degree=3):
    """Return a scene in which few view-dependent colours occur."""
    splats = oracle.scene(seed, n=n, degree=degree)
    rng = np.random.default_rng(seed)
    rows = rng.normal(0, 0.3, (colours, *splats.shN.shape[1:]))
    noise = rng.normal(0, 0.01, splats.shN.shape)
    shN = rows[rng.integers(colours, size=n)] + noise
    return replace(splats, shN=shN.astype(np.float32))


def fitted(splats, energy=None, chunks=CHUNKS, start=None, **training):
    """Return the basis and the codebook of a scene."""
    energy = np.full(len(splats), 1e-4) if energy is None else energy

    def of(run):
        return splats.shN[run]

    basis = colour_transform.fit(of, energy, np.zeros((15, 15)), LAMBDA, chunks)
    config = TrainingConfig(**training)
    return basis, colour_codebook.fit(basis, of, energy, LAMBDA, chunks, config, start)


def bits(coder, splats, run, energy):
    stream, missed = coder.encode(splats.shN[run], energy[run], LAMBDA, 0)
    return 8 * len(records.pack([stream])), coder, missed


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_colours_that_repeat_are_indices(degree):
    splats = few_colours(1, degree=degree)
    energy = np.full(N, 1e-4)
    basis, book = fitted(splats, energy)
    assert book.chunks == {run.start for run in CHUNKS}
    assert len(book.payloads) == degree
    assert book.rows.shape[1:] == splats.shN.shape[1:]
    assert 4 <= len(book.rows) < 30
    for run in CHUNKS:
        indexed, _, missed = bits(book, splats, run, energy)
        plain, _, of_basis = bits(basis, splats, run, energy)
        assert indexed < 0.6 * plain
        price = allocation.bit_price(LAMBDA)
        costs = [
            basis.error(each, energy[run]) + price * size
            for each, size in ((missed, indexed), (of_basis, plain))
        ]
        assert costs[0] < costs[1]


def test_a_stream_decodes_to_what_was_not_missed():
    splats = few_colours(2)
    _, book = fitted(splats)
    stream, missed = book.encode(splats.shN[:500], np.full(500, 1e-4), LAMBDA, 7)
    (stored,) = records.unpack(memoryview(records.pack([stream])), "tail", 500)
    assert codebook_index.parse(stored) == codebook_index.CodebookUse(7, 0)
    indices = codebook_index.read_indices(stored, len(book.rows))
    np.testing.assert_allclose(book.rows[indices], splats.shN[:500] - missed, atol=1e-6)
    assert np.abs(missed).max() < 0.1


def test_noise_and_what_many_pictures_show_stay_on_the_basis():
    noise = oracle.scene(3, n=N)
    assert fitted(noise, np.full(N, 1.0))[1] is None
    splats = few_colours(4)
    rng = np.random.default_rng(4)
    splats.shN[CHUNKS[0]] = rng.normal(0, 0.3, splats.shN[CHUNKS[0]].shape)
    energy = np.full(N, 1e-4)
    energy[CHUNKS[0]] = 1.0
    _, book = fitted(splats, energy)
    assert book.chunks == {500, 2000}


def test_a_codebook_of_few_splats_does_not_pay():
    splats = few_colours(5, n=40)
    assert fitted(splats, chunks=[slice(0, 40)])[1] is None


def test_training_starts_from_earlier_rows():
    splats = few_colours(6)
    _, first = fitted(splats)
    _, again = fitted(splats, start=first.rows, iterations=1)
    _, anew = fitted(splats, iterations=1)
    assert len(again.rows) <= len(first.rows)

    def error(book):
        missed = [
            book.encode(splats.shN[run], np.full(N, 1e-4)[run], LAMBDA, 0)[1] for run in CHUNKS
        ]
        return sum(float(np.square(each).sum()) for each in missed)

    assert error(again) < error(anew)


def test_training_vectors_are_limited():
    splats = few_colours(7)
    _, whole = fitted(splats)
    _, part = fitted(splats, samples=800)
    assert abs(len(whole.rows) - len(part.rows)) < 8
    assert part.chunks == whole.chunks


# Whole encodes.


@cache
def scene():
    splats = few_colours(8, n=3000)
    splats.scales[:] -= 0.7
    return splats


@cache
def scores():
    return score(scene(), CAMERAS, ScoreConfig(sensitivity_every=1))


@cache
def encoded(profile, quality_db=40.0):
    config = unseen(profile=profile, quality_db=quality_db, prune=None, chunk_splats=500, threads=1)
    return encode(scene(), scores(), config)


def size(whole):
    payloads = [payload for book in whole.codebooks for payload in book.payloads]
    for chunk in whole.chunks:
        parts = chunk.payloads
        payloads += [parts.head, parts.refinement or b"", parts.tail or b""]
    return sum(map(len, payloads))


def quality(whole):
    out = concatenate(decoding.chunks(whole))
    return np.mean([psnr(render(out, c), render(scene(), c)) for c in CAMERAS])


def test_the_profile_takes_fewer_bytes_than_transform_at_no_less_quality():
    indexed, plain = encoded("vq"), encoded("transform", 38.0)
    assert size(indexed) < 0.9 * size(plain)
    assert quality(indexed) > quality(plain)


def test_chunks_name_the_codebook_they_need():
    whole = encoded("vq")
    names = [book.attribute for book in whole.codebooks]
    assert names in (["colour", "shape"], ["colour", "colour", "shape"])
    kinds = set()
    for chunk in whole.chunks:
        (stream,) = records.unpack(memoryview(chunk.payloads.tail), "tail", chunk.splats)
        kinds.add(stream.kind)
        assert chunk.payloads.tail_needs == ((len(names) - 2 if stream.kind is Kind.VQ else 0),)
        head = records.unpack(memoryview(chunk.payloads.head), "head", chunk.splats)
        indexed = Attribute.SHAPE in {stream.attribute for stream in head}
        assert chunk.payloads.head_needs == ((len(names) - 1,) if indexed else ())
    assert Kind.VQ in kinds
    assert any(chunk.payloads.head_needs for chunk in whole.chunks)


def test_without_sh_the_profile_is_transform():
    splats = oracle.scene(9, n=300, degree=0)
    made = [
        encode(splats, None, unseen(profile=profile, prune=None, chunk_splats=100))
        for profile in ("vq", "transform")
    ]
    assert [size(each) for each in made] == [size(made[1])] * 2
    assert list(made[0].codebooks) == []
