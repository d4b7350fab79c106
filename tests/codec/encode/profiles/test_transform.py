from dataclasses import fields, replace
from functools import cache

import decoding
import numpy as np
import oracle
import pytest
from encoding import encode, unseen

from cogsplat.codec.encode.config import Ablation
from cogsplat.codec.geometry.sh import C0
from cogsplat.codec.metrics import psnr
from cogsplat.codec.rate import costs
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.scoring.contribution import score, zero_scores
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.splats import concatenate
from cogsplat.codec.streams import records
from cogsplat.codec.streams.records import Attribute, Kind

CAMERAS = [oracle.camera(angle) for angle in (0.0, 0.5, 1.1)]
OTHERS = [oracle.camera(angle) for angle in (0.25, 0.8)]
CONFIG = unseen(profile="transform", prune=None, chunk_splats=400, threads=1)
N = 900


@cache
def scene(degree=3):
    splats = oracle.scene(1, n=N, degree=degree)
    splats.scales[:] -= 0.7
    splats.shN[:] *= 0.3
    return splats


@cache
def scores(sensitivities=True, degree=3):
    return score(scene(degree), CAMERAS, ScoreConfig(sensitivity_every=int(sensitivities)))


def encoded(quality=40.0, found=None, splats=None, **changes):
    config = replace(CONFIG, quality_db=quality, **changes)
    return encode(splats or scene(), scores() if found is None else found, config)


def decoded(whole, *, refine=True):
    return concatenate(decoding.chunks(whole, refine=refine))


def size(whole):
    payloads = [payload for book in whole.codebooks for payload in book.payloads]
    for chunk in whole.chunks:
        parts = chunk.payloads
        payloads += [parts.head, parts.refinement or b"", parts.tail or b""]
    return sum(map(len, payloads))


def quality(whole, cameras=OTHERS, splats=None):
    out = decoded(whole)
    pairs = [(render(out, c), render(splats or scene(), c)) for c in cameras]
    return float(np.mean([psnr(a, b) for a, b in pairs]))


def kinds(chunk):
    found = records.unpack(memoryview(chunk.payloads.head), "head", 1 << 18)
    if chunk.payloads.tail is not None:
        found += records.unpack(memoryview(chunk.payloads.tail), "tail", 1 << 18)
    return {one.attribute: one.kind for one in found}


def everything(whole):
    return [(chunk.payloads, chunk.box.tobytes()) for chunk in whole.chunks], whole.codebooks


@pytest.mark.parametrize("sensitivities", [True, False])
def test_more_decibels_are_more_bytes_and_a_better_picture(sensitivities):
    results = []
    for nominal in (25.0, 32.0, 39.0, 46.0, 53.0):
        whole = encoded(nominal, scores(sensitivities))
        results.append((size(whole), quality(whole)))
    sizes, reached = zip(*results, strict=True)
    assert list(sizes) == sorted(sizes)
    assert list(reached) == sorted(reached)
    assert reached[-1] - reached[0] > 15
    # Nominal, and of views that were not scored.
    assert abs(reached[2] - 39) < 5


def test_streams_are_those_of_the_profile():
    whole = encoded()
    assert len(whole.chunks) > 1
    assert [book.attribute for book in whole.codebooks] == ["colour"]
    for chunk in whole.chunks:
        assert kinds(chunk) == {
            Attribute.SCALES: Kind.DIFFERENCES,
            Attribute.QUATS: Kind.SWING_TWIST,
            Attribute.MEANS: Kind.SORTED,
            Attribute.OPACITIES: Kind.SCALAR,
            Attribute.SH0: Kind.BASIS,
            Attribute.SHN: Kind.BASIS,
        }
        assert chunk.payloads.head_needs == ()
        assert chunk.payloads.tail_needs == (0,)


def test_without_shn_there_is_no_codebook_and_no_tail():
    whole = encoded(found=scores(degree=0), splats=scene(0))
    assert list(whole.codebooks) == []
    assert all(chunk.payloads.tail is None for chunk in whole.chunks)
    assert quality(whole, splats=scene(0)) > 35


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_shn_of_zero_costs_next_to_nothing(degree):
    splats = replace(scene(degree), shN=np.zeros_like(scene(degree).shN))
    whole = encoded(found=scores(degree=degree), splats=splats)
    assert all(len(chunk.payloads.tail) < 60 for chunk in whole.chunks)
    out = decoded(whole)
    assert out.shN.shape == splats.shN.shape
    assert not out.shN.any()


@pytest.mark.parametrize("threads", [2, 3])
def test_the_number_of_threads_changes_nothing(threads):
    assert everything(encoded(threads=threads)) == everything(encoded())


def test_rows_that_are_not_sorted_stay_where_they_are():
    whole = encoded(60.0, order="source", morton=False)
    assert {kinds(chunk)[Attribute.MEANS] for chunk in whole.chunks} == {Kind.SCALAR}
    out = decoded(whole)
    # Unseen splats are stored coarsely; those that count are where they were.
    seen = scores().energy > np.median(scores().energy)
    assert np.abs(out.means - scene().means)[seen].max() < 0.05


def test_every_gaussian_stays_the_ellipsoid_it_was():
    whole = encoded(75.0, order="source", morton=False)
    out = decoded(whole)
    for row in np.argsort(-scores().energy)[:50]:
        shapes = []
        for splats in (scene(), out):
            spread = oracle.rotation_matrix(splats.quats[row])
            spread = spread * np.exp(splats.scales[row].astype(float))
            shapes.append(spread @ spread.T)
        np.testing.assert_allclose(shapes[1], shapes[0], atol=0.01 * np.trace(shapes[0]))


def test_sh0_makes_up_for_what_shn_loses_in_the_mean_view():
    source = scene()
    errors = []
    for makes_up in (True, False):
        whole = encoded(
            28.0, order="source", morton=False, ablation=Ablation(sh0_makes_up=makes_up)
        )
        out = decoded(whole)
        # Colour over what each splat's views see on average.
        mean = scores().basis_mean.astype(float)
        missed = C0 * (out.sh0 - source.sh0) + np.einsum("nk,nkc->nc", mean, out.shN - source.shN)
        weight = scores().energy / scores().energy.sum()
        errors.append(float(weight @ np.square(missed).sum(axis=1)))
    assert errors[0] < 0.8 * errors[1]


@pytest.mark.parametrize("name", [one.name for one in fields(Ablation)])
def test_every_technique_can_be_left_out(name):
    without = encoded(ablation=replace(Ablation(), **{name: False}))
    assert quality(without) > 30
    assert size(without) < 1.6 * size(encoded())
    assert everything(without) != everything(encoded())


def test_unscored_scenes_are_encoded_too():
    for found in (zero_scores(N), None):
        whole = encode(scene(), found, replace(CONFIG, quality_db=45.0))
        assert quality(whole) > 30


# Degenerate chunks.


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("nominal", [10.0, 40.0, 90.0])
def test_a_splat_or_two_come_back(degree, n, nominal):
    splats = oracle.scene(3, n=n, degree=degree)
    splats.means[:] *= 0.3  # before the cameras
    splats.opacities[:] = 1
    found = score(splats, CAMERAS, ScoreConfig(sensitivity_every=1))
    for given in (found, None):
        whole = encode(splats, given, replace(CONFIG, quality_db=nominal))
        out = decoded(whole)
        assert len(out) == n
        assert all(np.isfinite(getattr(out, name)).all() for name in ("means", "scales", "sh0"))
        if nominal == 90.0:
            # By colour: the order in a chunk is its own.
            rows = np.argsort(out.sh0[:, 0])[np.argsort(np.argsort(splats.sh0[:, 0]))]
            np.testing.assert_allclose(out.sh0[rows], splats.sh0, atol=0.05)
            np.testing.assert_allclose(out.means[rows], splats.means, atol=0.05)


@pytest.mark.parametrize("degree", [0, 3])
def test_equal_splats_cost_no_bits(degree):
    splats = oracle.scene(4, n=1, degree=degree).take(np.zeros(400, np.int64))
    whole = encode(splats, None, CONFIG)
    out = decoded(whole)
    np.testing.assert_allclose(out.means, splats.means, atol=1e-5)
    np.testing.assert_allclose(np.sort(out.scales), np.sort(splats.scales), atol=0.1)
    assert max(len(chunk.payloads.head) for chunk in whole.chunks) < 900


def test_flat_round_and_thin_shapes_come_back():
    for shape in ([0, 0, 0], [-40, -40, -40], [-3, -3, -40], [-40, -40, -3], [2, -9, -9]):
        splats = replace(scene(), scales=np.tile(np.array([shape], np.float32), (N, 1)))
        out = decoded(encode(splats, None, CONFIG))
        assert np.abs(np.sort(out.scales) - np.sort(splats.scales)).max() < 0.8
        np.testing.assert_allclose(np.square(out.quats).sum(axis=1), 1, atol=1e-6)


def test_means_on_a_point_a_line_and_far_apart_come_back():
    rng = np.random.default_rng(5)
    point = np.tile(np.array([[7, -3, 1e4]], np.float32), (N, 1))
    line = point.copy()
    line[:, 1] = rng.uniform(-1, 1, N)
    far = scene().means.copy()
    far[5] = [1e9, -1e12, 3]
    for means in (point, line, far):
        out = decoded(encode(replace(scene(), means=means), None, CONFIG))
        for axis in range(3):
            low, high = means[:, axis].min(), means[:, axis].max()
            slack = 0.02 + 1e-5 * (float(high) - float(low)) + np.spacing(np.abs(means).max())
            found = np.sort(out.means[:, axis])
            assert abs(found[0] - low) <= slack
            assert abs(found[-1] - high) <= slack


def test_costs_all_equal_and_costs_far_apart_are_survived():
    found = scores()
    for energy in (np.full(N, 1e-6), np.geomspace(1e-60, 1e6, N), np.full(N, 1e-200)):
        even = replace(found, energy=energy)
        for given in (even, replace(even, sensitivities=None)):
            out = decoded(encoded(found=given))
            assert np.isfinite(out.means).all()
            assert np.isfinite(out.shN).all()


def test_nothing_sensitive_and_no_spread_are_survived():
    found = scores()
    numb = {
        one.name: np.zeros_like(getattr(found.sensitivities, one.name))
        for one in fields(found.sensitivities)
    }
    for given in (
        replace(found, sensitivities=replace(found.sensitivities, **numb)),
        replace(found, basis_spread=np.zeros((15, 15))),
        replace(found, basis_mean=np.zeros_like(found.basis_mean)),
    ):
        assert quality(encoded(found=given)) > 25


def test_costs_are_not_changed_by_a_chunk_that_does_without():
    """What one encoding limits must not leak into the next from the same scores."""
    before = [costs.costs(scene(), scores()).mean.copy(), scores().energy.copy()]
    encoded(20.0)
    after = [costs.costs(scene(), scores()).mean, scores().energy]
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(one, other)
