from dataclasses import replace
from functools import cache

import decoding
import numpy as np
import oracle
import pytest
from encoding import encode, unseen

from cogsplat.codec.clustering.kmeans import TrainingConfig
from cogsplat.codec.encode.profiles import shape_codebook
from cogsplat.codec.encode.profiles.shapes import ShapeSource
from cogsplat.codec.geometry import rotations
from cogsplat.codec.metrics import psnr
from cogsplat.codec.rate.costs import Costs
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.segments.codebooks import ShapeCodebook
from cogsplat.codec.segments.stream_set import StreamSet
from cogsplat.codec.splats import concatenate
from cogsplat.codec.streams import codebook_index, kinds, records, swing_twist
from cogsplat.codec.streams.records import Attribute, Kind
from cogsplat.codec.streams.stream_inputs import Inputs

N = 4000
LAMBDA = 1e-6
CHUNKS = [slice(0, 500), slice(500, 2000), slice(2000, N)]
CAMERAS = [oracle.camera(angle) for angle in (0.0, 0.5, 1.1)]


def few_shapes(seed, n=N, shapes=6, own=0.0):
    """Return rotations and log scales of few shapes in all sizes; the share `own` has its own."""
    rng = np.random.default_rng(seed)
    quats = rotations.unit(rng.normal(size=(n, 4)).astype(np.float32))
    scales = rng.normal(0, 1.2, (n, 3)).astype(np.float32)
    like = np.where(rng.random(n) < own, np.arange(n), rng.integers(shapes, size=n))
    return quats[like], scales[like] + rng.normal(-4, 1, (n, 1)).astype(np.float32)


def source(quats, scales, cost=1e-4):
    """Return shapes whose errors all cost the same, or what `cost` says of each."""
    each = np.broadcast_to(np.float64(cost), len(quats)).copy()
    costs = Costs(*[each] * 8, np.zeros((len(quats), 0)))
    return ShapeSource(*swing_twist.decompose(quats, scales), costs)


def fitted(shapes, chunks=CHUNKS, start=None, **training):
    def of(run):
        return shapes.take(np.arange(len(shapes))[run])

    return shape_codebook.fit(of, LAMBDA, chunks, TrainingConfig(**training), start)


def decoded(streams, book, rows):
    """Return log scales and rotations of the streams of a head, as SPEC 7.2 has it."""
    found = StreamSet(memoryview(records.pack(streams)), "head", rows, "7.2")
    shape = found.pop(Attribute.SHAPE)
    escape = kinds.codebook_use(shape).escape_rows
    own = ShapeCodebook(np.empty((escape, 3), np.float32), np.empty((escape, 4), np.float32))
    if escape:
        kinds.read(found.pop_escape(Attribute.SCALES, escape), own.scales)
        turned = found.pop_escape(Attribute.QUATS, escape)
        assert turned.kind is Kind.SWING_TWIST
        kinds.read(turned, own.quats, Inputs(scales=own.scales))
    at = codebook_index.read_indices(shape, len(book.rows))
    factors = np.empty((rows, 1), np.float32)
    kinds.read(found.pop(Attribute.SCALE_FACTOR), factors)
    found.require_empty()
    scales = np.concatenate([book.rows.scales, own.scales])[at] + factors
    return scales, np.concatenate([book.rows.quats, own.quats])[at]


def covariances(quats, scales):
    turned = rotations.matrices(quats) * np.exp(scales.astype(np.float64))[:, None, :]
    return turned @ turned.transpose(0, 2, 1)


def test_shapes_that_repeat_are_indices():
    quats, scales = few_shapes(1)
    shapes = source(quats, scales)
    book = fitted(shapes)
    assert book.chunks == {run.start for run in CHUNKS}
    assert 6 <= len(book.rows) < 12
    stored = book.quantise(shapes, LAMBDA, 3)
    assert stored.needs == (3,)
    assert (stored.indices < len(book.rows)).all()
    (index, factors), _ = stored.write(np.arange(N))
    assert (index.attribute, factors.attribute) == (Attribute.SHAPE, Attribute.SCALE_FACTOR)
    sizes, turned = decoded([index, factors], book, N)
    wide, narrow = covariances(quats, scales), covariances(turned, sizes)
    error = np.linalg.norm(wide - narrow, axis=(1, 2)) / np.linalg.norm(wide, axis=(1, 2))
    assert np.quantile(error, 0.99) < 0.2


def test_what_no_row_serves_is_an_escape_row():
    quats, scales = few_shapes(2, own=0.3)
    shapes = source(quats, scales)
    book = fitted(shapes)
    stored = book.quantise(shapes, LAMBDA, 0)
    escaped = stored.indices == len(book.rows)
    assert 0.15 < escaped.mean() < 0.35
    # In any order of the rows.
    inside = np.random.default_rng(2).permutation(N)
    streams, refined = stored.write(inside)
    assert refined.stream is None
    sizes, turned = decoded(streams, book, N)
    np.testing.assert_array_equal(sizes, stored.scales[inside])
    np.testing.assert_array_equal(stored.head_scales, stored.scales)
    wide, narrow = covariances(quats[inside], scales[inside]), covariances(turned, sizes)
    error = np.linalg.norm(wide - narrow, axis=(1, 2)) / np.linalg.norm(wide, axis=(1, 2))
    assert np.quantile(error[escaped[inside]], 0.99) < 0.4


def test_splats_whose_errors_cost_much_escape():
    quats, scales = few_shapes(3)
    rng = np.random.default_rng(3)
    # Each shape is a little off.
    quats = rotations.unit(quats + rng.normal(0, 0.03, quats.shape).astype(np.float32))
    dear = rng.random(N) < 0.2
    shapes = source(quats, scales, np.where(dear, 0.1, 1e-4))
    book = fitted(shapes)
    escaped = book.quantise(shapes, LAMBDA, 0).indices == len(book.rows)
    assert escaped[dear].mean() > 0.9
    assert escaped[~dear].mean() < 0.1


def test_areas_are_kept():
    quats, scales = few_shapes(4, own=0.3)
    shapes = source(quats, scales)
    stored = fitted(shapes).quantise(shapes, LAMBDA, 0)

    def areas(rows):
        return np.exp(rows[:, 0].astype(np.float64) + rows[:, 2])

    ratio = areas(stored.scales) / areas(shapes.scales)
    assert abs(ratio.mean() - 1) < 0.01


def test_chunks_whose_shapes_are_all_different_do_without():
    quats, scales = few_shapes(5)
    rng = np.random.default_rng(5)
    quats[CHUNKS[0]] = rotations.unit(rng.normal(size=(500, 4)).astype(np.float32))
    cost = np.full(N, 1e-4)
    cost[CHUNKS[0]] = 0.1
    assert fitted(source(quats, scales, cost)).chunks == {500, 2000}
    noise = rotations.unit(rng.normal(size=(N, 4)).astype(np.float32))
    assert fitted(source(noise, rng.normal(-4, 1, (N, 3)).astype(np.float32), 1.0)) is None


def test_a_codebook_of_few_splats_does_not_pay():
    assert fitted(source(*few_shapes(6, n=20)), chunks=[slice(0, 20)]) is None


def test_training_starts_from_earlier_rows():
    shapes = source(*few_shapes(7, shapes=40))
    first = fitted(shapes)
    again = fitted(shapes, start=first.rows, iterations=1)
    anew = fitted(shapes, iterations=1)
    assert len(again.rows) <= len(first.rows) < len(anew.rows)


def test_training_vectors_are_limited():
    shapes = source(*few_shapes(8))
    part = fitted(shapes, samples=800)
    assert abs(len(fitted(shapes).rows) - len(part.rows)) < 5
    assert part.chunks == {run.start for run in CHUNKS}


@pytest.mark.parametrize("turn", [0.02, 0.1])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_error_of_a_turned_row_is_that_of_its_angle(turn, axis):
    scales = np.array([[-1.0, -2.0, 0.0]], np.float32)
    around = np.zeros(4)
    around[0], around[1 + axis] = np.cos(turn / 2), np.sin(turn / 2)
    quat = rotations.unit(np.random.default_rng(9).normal(size=(1, 4)).astype(np.float32))
    row = rotations.multiply(quat.astype(np.float64), around[None]).astype(np.float32)
    costs = Costs(*[np.ones(1) * c for c in (0, 0, 0, 0, 0, 0, 5.0, 5.0)], np.zeros((1, 0)))
    shapes = ShapeSource(swing_twist.decompose(quat, scales)[0], scales, costs)
    rows = ShapeCodebook(scales + np.float32(3), row)
    error = shape_codebook._errors(shapes, rows, np.zeros((1, 1), np.int64))[0, 0]
    # 2.5 squared radians are one squared value of swing or twist.
    np.testing.assert_allclose(error, 5.0 * turn**2 / 2.5, rtol=0.2)


def test_the_error_of_other_scales_is_that_of_their_differences():
    one = np.array([[1, 0, 0, 0]], np.float32)
    costs = Costs(*[np.ones(1) * c for c in (0, 0, 0, 1.0, 2.0, 4.0, 8.0, 8.0)], np.zeros((1, 0)))
    scales = np.array([[-1.0, -2.0, 0.0]], np.float32)
    shapes = ShapeSource(swing_twist.decompose(one, scales)[0], scales, costs)
    near = np.array([[0, 1, 2]])
    rows = np.array([[-1.0, -2.0, 0.0], [-1.2, -2.2, 0.0], [-1.0, -2.5, 0.0]], np.float32)
    error = shape_codebook._errors(shapes, ShapeCodebook(rows, np.repeat(one, 3, axis=0)), near)
    # A row of another middle axis gets half of the difference on its longest axis.
    np.testing.assert_allclose(error[0], [0, 0.1**2 + 2 * 0.2**2, 4 * 0.5**2], atol=1e-6)


# Whole encodes.


@cache
def scene():
    splats = oracle.scene(10, n=3000, degree=0)
    quats, scales = few_shapes(10, n=3000, shapes=8, own=0.2)
    return replace(splats, quats=quats, scales=scales - scales.mean() + splats.scales.mean())


@cache
def encoded(profile):
    scores = score(scene(), CAMERAS, ScoreConfig(sensitivity_every=1))
    config = unseen(profile=profile, prune=None, chunk_splats=500, threads=1)
    return encode(scene(), scores, config)


def size(whole):
    payloads = [payload for book in whole.codebooks for payload in book.payloads]
    for chunk in whole.chunks:
        payloads += [chunk.payloads.head, chunk.payloads.refinement or b""]
    return sum(map(len, payloads))


def quality(whole):
    out = concatenate(decoding.chunks(whole))
    return np.mean([psnr(render(out, c), render(scene(), c)) for c in CAMERAS])


def test_scenes_without_sh_have_a_codebook_of_shapes():
    indexed, plain = encoded("vq"), encoded("transform")
    assert [book.attribute for book in indexed.codebooks] == ["shape"]
    needs = {chunk.payloads.head_needs for chunk in indexed.chunks}
    assert (0,) in needs
    assert size(indexed) < 0.97 * size(plain)
    assert quality(indexed) > quality(plain) - 0.7


def test_decoded_chunks_are_what_the_encoder_said():
    whole = encoded("vq")
    out = concatenate(decoding.chunks(whole))
    for name in ("means", "scales", "quats", "opacities", "sh0"):
        np.testing.assert_array_equal(getattr(out, name), getattr(whole.decoded, name))
