from dataclasses import replace

import decoding
import numpy as np
import oracle
import pytest
from encoding import encode, unseen

from cogsplat.codec.encode.config import PROFILE_NAMES, Ablation, EncodeConfig
from cogsplat.codec.encode.encoder import compress_chunks, encode_chunks
from cogsplat.codec.encode.prepared import prepare
from cogsplat.codec.encode.profiles.near_lossless import NearLosslessBounds
from cogsplat.codec.errors import Cancelled, DataError
from cogsplat.codec.geometry import bounds as extent
from cogsplat.codec.order import chunk_plan
from cogsplat.codec.order.orders import OrderConfig
from cogsplat.codec.rate.allocation import lagrangian
from cogsplat.codec.rate.pruning import PruneConfig
from cogsplat.codec.scoring.contribution import score, zero_scores
from cogsplat.codec.splats import concatenate, empty
from cogsplat.codec.streams.grid import MAX_VALUE

FIELDS = ("means", "scales", "quats", "opacities", "sh0", "shN")
KEEP = unseen(prune=None)


def config(**changes):
    return replace(KEEP, **changes)


def tagged(n, degree=3, seed=1):
    """A scene whose rows can be told apart behind any profile: sh0[2] is the row."""
    splats = oracle.scene(seed, n=n, degree=degree)
    splats.sh0[:, 2] = np.arange(n)
    return splats


def tags(splats):
    return np.rint(splats.sh0[:, 2]).astype(int).tolist()


def scored(n, seed=2):
    rng = np.random.default_rng(seed)
    return replace(
        zero_scores(n),
        contribution=rng.lognormal(0, 2, n),
        energy=rng.lognormal(-9, 2, n),
        peak=rng.uniform(0, 1, n).astype(np.float32),
        covered=rng.integers(0, 9, n).astype(np.int32),
    )


def oracle_axes(splats):
    """Axes of the ellipsoids at the cut, (n, 3, 3), as columns."""
    turned = np.array([oracle.rotation_matrix(quat) for quat in splats.quats])
    cut = np.sqrt(2 * np.log(255))
    return turned * cut * np.exp(splats.scales.astype(np.float64))[:, None, :]


def payload_bytes(encoded):
    parts = [payload for book in encoded.codebooks for payload in book.payloads]
    for chunk in encoded.chunks:
        parts += [chunk.payloads.head, chunk.payloads.tail or b"", chunk.box.tobytes()]
    return b"".join(parts)


def check(encoded, n, degree):
    """Decode every chunk and look at what no reader may find broken."""
    parts = decoding.chunks(encoded)
    out = concatenate(parts) if parts else empty(degree)
    assert encoded.splats == len(out) == n
    assert encoded.scene.sh_degree == out.sh_degree == degree
    assert len(encoded.scene) == 0
    for name in FIELDS:
        assert np.isfinite(getattr(out, name)).all() or name == "opacities"
    assert not np.isnan(out.opacities).any()
    np.testing.assert_allclose(np.square(out.quats).sum(axis=1), 1, atol=1e-5)
    assert (out.quats[:, 0] >= 0).all()
    return out


@pytest.mark.parametrize("profile", PROFILE_NAMES)
@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("n", [0, 1, 2, 100])
def test_small_scenes_come_back(profile, degree, n):
    splats = tagged(n, degree)
    for morton in (True, False):
        encoded = encode(splats, None, config(profile=profile, morton=morton))
        out = check(encoded, n, degree)
        assert sorted(tags(out)) == list(range(n))
        if not morton:
            assert tags(out) == list(range(n))
        assert len(encoded.chunks) == min(n, 1)
        assert encoded.pruned == 0


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_equal_splats_come_back(profile):
    splats = oracle.scene(3, n=1).take(np.zeros(1500, np.int64))
    encoded = encode(splats, None, config(profile=profile, chunk_splats=500))
    out = check(encoded, 1500, 3)
    for name in ("means", "opacities", "sh0"):
        np.testing.assert_allclose(getattr(out, name), getattr(splats, name), atol=0.05)
    assert len(payload_bytes(encoded)) < 4000


@pytest.mark.parametrize("profile", PROFILE_NAMES)
@pytest.mark.parametrize("logit", [-np.inf, np.inf])
def test_opacities_may_all_be_infinite(profile, logit):
    splats = replace(tagged(50), opacities=np.full(50, logit, np.float32))
    out = check(encode(splats, None, config(profile=profile)), 50, 3)
    if profile == "near-lossless":
        assert (out.opacities == logit).all()
    else:
        assert (np.sign(out.opacities) == np.sign(logit)).all()
        assert (np.abs(out.opacities) >= 10).all()
    pruned = encode(splats, None, config(profile=profile, prune=PruneConfig()))
    # An archive keeps even what nothing can show.
    assert pruned.pruned == (50 if logit < 0 and profile != "near-lossless" else 0)
    check(pruned, 50 - pruned.pruned, 3)
    if pruned.pruned:
        assert (len(pruned.chunks), len(pruned.codebooks)) == (0, 0)
        assert pruned.box.tolist() == [0] * 6


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_scores_of_nothing_keep_everything_in_file_order(profile):
    splats = tagged(300)
    encoded = encode(splats, zero_scores(300), unseen(profile=profile, morton=False, prune=None))
    assert tags(check(encoded, 300, 3)) == list(range(300))
    assert payload_bytes(encoded) == payload_bytes(
        encode(splats, None, unseen(profile=profile, morton=False, prune=None))
    )


def test_cameras_that_see_half_leave_the_other_half():
    splats = tagged(400)
    splats.means[200:, 2] -= 500
    splats.opacities[:] = np.maximum(splats.opacities, 0)
    scores = score(splats, [oracle.camera(0.2 * k) for k in range(6)])
    assert not scores.shown[200:].any()
    encoded = encode(splats, scores, unseen(chunk_splats=64))
    out = check(encoded, 400 - encoded.pruned, 3)
    hidden = out.means[:, 2] < -250
    assert hidden.sum() == 200
    # They come last, but for what a chunk's sort mixes.
    assert not hidden[: 200 - encoded.pruned - 64].any()


@pytest.mark.parametrize("profile", PROFILE_NAMES)
@pytest.mark.parametrize("morton", [True, False])
def test_chunks_follow_the_order_and_say_what_they_hold(profile, morton):
    n = 2500
    splats, scores = tagged(n), scored(n)
    settings = config(profile=profile, morton=morton, chunk_splats=700, quality_db=45.0)
    encoded = encode(splats, scores, settings)
    order = np.argsort(-scores.contribution, kind="stable")
    start = 0
    heads = decoding.chunks(encoded, refine=False)
    for chunk, part, head in zip(encoded.chunks, decoding.chunks(encoded), heads, strict=True):
        rows = order[start : start + chunk.splats]
        found = tags(part)
        assert (found if not morton else sorted(found)) == (
            rows.tolist() if not morton else sorted(rows)
        )
        assert chunk.contribution == pytest.approx(scores.contribution[rows].sum())
        fine, coarse = extent.box(part), extent.box(head)
        np.testing.assert_array_equal(chunk.box[:3], np.minimum(fine, coarse)[:3])
        np.testing.assert_array_equal(chunk.box[3:], np.maximum(fine, coarse)[3:])
        start += chunk.splats
    assert start == n
    runs = chunk_plan.plan_chunks(n, 700)
    assert [chunk.splats for chunk in encoded.chunks] == [run.stop - run.start for run in runs]
    boxes = np.array([chunk.box for chunk in encoded.chunks])
    whole = np.concatenate([boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)])
    np.testing.assert_array_equal(encoded.box, whole)


@pytest.mark.parametrize("quality", [10.0, 25.0, 60.0])
def test_boxes_hold_splats_as_they_are_decoded(quality):
    splats = oracle.scene(5, n=1500)
    encoded = encode(splats, scored(1500), config(chunk_splats=400, quality_db=quality))
    for chunk, part in zip(encoded.chunks, decoding.chunks(encoded), strict=True):
        axes = oracle_axes(part)
        for sign in (1, -1):
            tips = part.means[:, :, None].astype(np.float64) + sign * axes
            assert (tips.min(axis=(0, 2)) >= chunk.box[:3]).all()
            assert (tips.max(axis=(0, 2)) <= chunk.box[3:]).all()


def test_the_source_order_is_kept():
    splats = tagged(500)
    encoded = encode(splats, scored(500), config(order="source", morton=False, chunk_splats=90))
    assert tags(check(encoded, 500, 3)) == list(range(500))


def test_the_near_profile_drops_nothing():
    prune = PruneConfig(peak=0.5, views=3)
    encoded = encode(tagged(800), scored(800), unseen(profile="near-lossless", prune=prune))
    assert encoded.pruned == 0
    assert sorted(tags(check(encoded, 800, 3))) == list(range(800))


@pytest.mark.parametrize("profile", [name for name in PROFILE_NAMES if name != "near-lossless"])
def test_pruned_rows_are_gone_and_counted(profile):
    splats, scores = tagged(800), scored(800)
    prune = PruneConfig(peak=0.5, views=3)
    prepared = prepare(splats, scores, unseen(profile=profile, prune=prune))
    assert encode_chunks(prepared, 60.0).pruned < encode_chunks(prepared, 30.0).pruned
    encoded = encode_chunks(prepared, 31.0)
    worth = scores.energy >= prune.worth * lagrangian(scores, 31.0)
    gone = (scores.peak < 0.5) & (scores.covered >= 3) & ~worth
    gone |= splats.opacities < -np.log(254)
    assert encoded.pruned == gone.sum() > 5
    out = check(encoded, 800 - encoded.pruned, 3)
    assert sorted(tags(out)) == np.flatnonzero(~gone).tolist()


@pytest.mark.parametrize("ablation", [Ablation(), Ablation(digits=False)])
@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_planes_can_be_compressed_later(profile, ablation):
    settings = unseen(profile=profile, ablation=ablation, chunk_splats=300)
    prepared = prepare(tagged(800), scored(800), settings)
    at_once = encode_chunks(prepared, 35.0)
    trial = encode_chunks(prepared, 35.0, compress=False)
    assert len(payload_bytes(trial)) > len(payload_bytes(at_once))
    later = compress_chunks(trial, settings)
    for chunk, expected in zip(later.chunks, at_once.chunks, strict=True):
        assert chunk.payloads == expected.payloads
    assert compress_chunks(later, settings) is later
    np.testing.assert_array_equal(trial.decoded.shN, at_once.decoded.shN)


def test_the_near_profile_meets_its_bounds_in_every_chunk():
    splats = tagged(1200)
    bounds = NearLosslessBounds(means=0.5, scales=0.01, opacities=0.1, sh0=0.01, shN=0.02)
    settings = config(profile="near-lossless", near_lossless=bounds, chunk_splats=300)
    out = check(encode(splats, scored(1200), settings), 1200, 3)
    source = splats.take(np.array(tags(out)))
    size = np.exp(np.median(splats.scales.astype(np.float64)))
    for name, bound in (
        ("means", 0.5 * size), ("scales", 0.01), ("opacities", 0.1), ("sh0", 0.01), ("shN", 0.02),
    ):  # fmt: skip
        assert np.abs(getattr(out, name) - getattr(source, name)).max() <= bound * 1.00001, name


def test_more_quality_costs_more_and_loses_less():
    splats, scores = oracle.scene(6, n=1500), scored(1500)
    sizes = [
        len(payload_bytes(encode(splats, scores, config(quality_db=quality))))
        for quality in (15.0, 30.0, 45.0, 60.0)
    ]
    assert sizes == sorted(sizes)


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_the_number_of_threads_changes_no_byte(profile):
    splats, scores = oracle.scene(7, n=800), scored(800)
    first, *others = (
        payload_bytes(
            encode(splats, scores, config(profile=profile, chunk_splats=128, threads=threads))
        )
        for threads in (1, 2, 5)
    )
    assert all(other == first for other in others)


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_stray_values_are_survived(profile):
    for name in ("means", "scales", "quats", "opacities", "sh0", "shN"):
        for value in (-1e7, MAX_VALUE):
            splats = oracle.scene(8, n=200)
            getattr(splats, name).reshape(200, -1)[17, -1] = value
            check(encode(splats, None, config(profile=profile)), 200, 3)


def test_a_stray_colour_does_not_spoil_the_others():
    plain = oracle.scene(9, n=2000)
    stray = replace(plain, shN=plain.shN.copy(), sh0=plain.sh0.copy())
    stray.shN[5, 3, 1] = 1e25
    stray.sh0[6, 0] = -1e25
    settings = config(morton=False)
    errors = []
    for splats in (plain, stray):
        out = check(encode(splats, None, settings), 2000, 3)
        rows = slice(10, None)
        errors.append(np.abs(out.shN[rows] - plain.shN[rows]).max())
        errors.append(np.abs(out.sh0[rows] - plain.sh0[rows]).max())
    assert errors[2] <= 1.5 * errors[0]
    assert errors[3] <= 1.5 * errors[1]


def test_energies_of_any_scale_are_survived():
    splats = oracle.scene(10, n=300)
    for energy in (0.0, 1e-300, 1e-30, 1e30, 1e200):
        scores = replace(scored(300), energy=np.full(300, energy))
        check(encode(splats, scores, KEEP), 300, 3)
    mixed = replace(scored(300), energy=np.geomspace(1e-200, 1e3, 300))
    check(encode(splats, mixed, KEEP), 300, 3)


def test_the_source_is_left_alone():
    splats, scores = oracle.scene(11, n=300), scored(300)
    before = [getattr(splats, name).copy() for name in FIELDS]
    encode(splats, scores, config(chunk_splats=100))
    for name, expected in zip(FIELDS, before, strict=True):
        np.testing.assert_array_equal(getattr(splats, name), expected)


# Refusals.


def refusal(splats, scores=None, settings=KEEP):
    with pytest.raises(DataError) as caught:
        encode(splats, scores, settings)
    return caught.value.code


@pytest.mark.parametrize("name", FIELDS)
def test_rows_that_cannot_be_drawn_are_refused(name):
    splats = oracle.scene(12, n=20)
    getattr(splats, name)[3] = np.nan
    assert refusal(splats) == "invalid-rows"


@pytest.mark.parametrize("profile", PROFILE_NAMES)
@pytest.mark.parametrize("name", ["means", "scales", "opacities", "sh0", "shN"])
def test_values_that_no_reader_takes_are_refused(name, profile):
    splats = oracle.scene(13, n=20)
    getattr(splats, name).reshape(20, -1)[3, 0] = -1.5 * MAX_VALUE
    assert refusal(splats, None, config(profile=profile)) == "value-range"


@pytest.mark.parametrize("name", ["contribution", "energy", "peak", "covered"])
def test_scores_of_another_scene_are_refused(name):
    splats = oracle.scene(14, n=20)
    assert refusal(splats, scored(19)) == refusal(splats, scored(21)) == "scores-mismatch"
    scores = scored(20)
    broken = replace(scores, **{name: getattr(scores, name)[:-1]})
    assert refusal(splats, broken) == "scores-mismatch"
    assert refusal(empty(0), scored(1)) == "scores-mismatch"


@pytest.mark.parametrize(
    "changes",
    [
        {"profile": "best"},
        {"order": "gloss"},
        {"chunk_splats": 0},
        {"chunk_splats": 2**18 + 1},
        {"quality_db": 9.9},
        {"quality_db": float("nan")},
        {"threads": -1},
        {"cells": True, "chunk_splats": 1},
        {"cells": True, "ordering": OrderConfig(by_object=True)},
    ],
)
def test_settings_out_of_range_are_refused_when_made(changes):
    with pytest.raises(ValueError, match="expected"):
        EncodeConfig(**changes)


# Progress.


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_progress_counts_every_stage_to_its_end(profile):
    calls = []
    settings = config(profile=profile, chunk_splats=100)
    encode(oracle.scene(15, n=500), None, settings, progress=lambda *call: calls.append(call))
    expected = [("order", 1, 1)]
    expected += [("codebooks", 1, 1)] if profile == "vq" else []
    expected += [("quantisers", 1, 1)]
    assert calls == expected + [("chunks", done, 5) for done in range(6)]


@pytest.mark.parametrize("threads", [1, 2])
def test_raising_from_progress_stops_the_work(threads):
    splats = oracle.scene(16, n=500)
    settings = config(chunk_splats=100, threads=threads)
    calls = []

    def stop(*call):
        calls.append(call)
        if len(calls) > allowed:
            raise Cancelled

    for allowed in range(6):
        calls.clear()
        with pytest.raises(Cancelled):
            encode(splats, None, settings, progress=stop)
        assert len(calls) == allowed + 1
