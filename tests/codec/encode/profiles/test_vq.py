from dataclasses import replace

import decoding
import numpy as np
import oracle
import pytest
from scipy.spatial.transform import Rotation

from cogsplat.codec.clustering.kmeans import TrainingConfig
from cogsplat.codec.encode.profiles import vq
from cogsplat.codec.encode.profiles.vq import (
    MAX_COEFFICIENT,
    MAX_LOG_SCALE,
    MAX_ROWS,
    clip_outliers,
    codebook_rows,
)
from cogsplat.codec.geometry import covariance
from cogsplat.codec.progress import silent
from cogsplat.codec.rate.energy_costs import EnergyCosts
from cogsplat.codec.segments.codebooks import decode_colour_codebook, decode_shape_codebook
from cogsplat.codec.streams.records import Attribute

N = 600


def planned(splats, energy=None, lagrangian=1e-7, progress=silent):
    energy = np.full(len(splats), 1e-3) if energy is None else energy
    config = TrainingConfig()
    return vq.plan(splats, energy, lagrangian, training=config, threads=1, progress=progress)


def books(plan, degree):
    out = {0: decode_shape_codebook(memoryview(plan.shape_payload), plan.shape_rows, "shape")}
    if plan.colour_rows:
        bands = {b: memoryview(p) for b, p in enumerate(plan.colour_payloads, start=1)}
        out[1] = decode_colour_codebook(bands, plan.colour_rows, degree, "colour")
    return out


def decoded(splats, plan, rows=None, morton=False):
    rows = np.arange(len(splats)) if rows is None else rows
    payloads = vq.encode_chunk(splats, plan, rows, morton)
    out = decoding.chunk(payloads, len(rows), splats.sh_degree, books(plan, splats.sh_degree))
    return payloads, out


def covariances(splats):
    quats = splats.quats[:, [1, 2, 3, 0]].astype(np.float64)
    turned = Rotation.from_quat(quats).as_matrix()
    return np.einsum("nij,nj,nkj->nik", turned, np.exp(2 * splats.scales.astype(float)), turned)


def shape_distance(a, b):
    """Frobenius distances of trace-normalised covariances."""
    return [
        np.linalg.norm(x / np.trace(x) - y / np.trace(y))
        for x, y in zip(covariances(a), covariances(b), strict=True)
    ]


def test_codebooks_grow_with_the_scene_in_powers_of_two():
    for per_row in (16, 32):
        for splats in (0, 1, per_row - 1, per_row, 1000, 15_000, 10**6, 10**9):
            rows = codebook_rows(splats, per_row)
            assert rows & (rows - 1) == 0
            assert rows == MAX_ROWS or rows <= max(splats / per_row, 1) < 2 * rows
    assert codebook_rows(15_000, 16) == 512


def test_strays_are_clipped_and_others_left_alone():
    splats = oracle.scene(1, n=5)
    same = clip_outliers(splats)
    assert all(getattr(same, f) is getattr(splats, f) for f in ("scales", "sh0", "shN"))
    assert clip_outliers(splats.take(slice(0, 0))).sh_degree == 3
    splats.sh0[1, 2] = -1e20
    splats.shN[3, 7, 0] = 1e20
    splats.scales[2] = [-1e20, 1, 1e20]
    out = clip_outliers(splats)
    assert out.sh0[1, 2] == -MAX_COEFFICIENT
    assert out.shN[3, 7, 0] == MAX_COEFFICIENT
    assert out.scales[2].tolist() == [-MAX_LOG_SCALE, 1, MAX_LOG_SCALE]
    assert splats.shN[3, 7, 0] == np.float32(1e20)
    assert out.means is splats.means
    untouched = np.ones((5, 15, 3), bool)
    untouched[3, 7, 0] = False
    np.testing.assert_array_equal(out.shN[untouched], splats.shN[untouched])


@pytest.mark.parametrize("degree", range(4))
def test_a_plan_places_every_splat(degree):
    splats = oracle.scene(degree, n=N, degree=degree)
    plan = planned(splats)
    assert 1 <= plan.shape_rows <= codebook_rows(N, 16)
    assert plan.shape_indices.shape == plan.shape_escape.shape == (N,)
    assert plan.shape_indices.max() < plan.shape_rows
    assert len(plan.colour_payloads) == degree
    if degree:
        assert 1 <= plan.colour_rows <= codebook_rows(N, 32)
        assert plan.colour_indices.max() < plan.colour_rows
    else:
        assert plan.colour_rows == 0
        assert not plan.colour_escape.any()


def test_every_splat_has_the_nearest_row_as_it_is_stored():
    splats = oracle.scene(5, n=N)
    plan = planned(splats)
    stored = books(plan, 3)
    vectors = covariance.shape_vectors(plan.quats, plan.scales).astype(np.float64)
    rows = covariance.shape_vectors(stored[0].quats, stored[0].scales).astype(np.float64)
    distances = np.linalg.norm(vectors[:, None] - rows, axis=2)
    chosen = distances[np.arange(N), plan.shape_indices]
    np.testing.assert_allclose(chosen, distances.min(axis=1), atol=1e-4)
    distances = np.linalg.norm(
        splats.shN.reshape(N, 1, -1).astype(np.float64) - stored[1].shN.reshape(-1, 45), axis=2
    )
    chosen = distances[np.arange(N), plan.colour_indices]
    np.testing.assert_allclose(chosen, distances.min(axis=1), atol=1e-4)


@pytest.mark.parametrize("morton", [True, False])
def test_numbers_stay_within_half_the_steps_of_equal_slope(morton):
    splats = oracle.scene(6, n=N)
    # A tag per row, far above the step, to find rows again behind the sort.
    splats.sh0[:, 2] = np.arange(N)
    energy = np.random.default_rng(7).lognormal(-7, 1, N)
    plan = planned(splats, energy)
    _, out = decoded(splats, plan, morton=morton)
    rows = np.rint(out.sh0[:, 2]).astype(int)
    assert sorted(rows) == list(range(N))
    assert (rows.tolist() == list(range(N))) is not morton
    source = splats.take(rows)
    ulp = 1 + 1e-5

    costs = EnergyCosts(1e-7, energy)

    def half(attribute):
        return costs.step(attribute) / 2 * ulp

    step = costs.mean_step(plan.scales)
    assert np.abs(out.means - source.means).max() <= step / 2 * ulp
    assert np.abs(out.opacities - source.opacities).max() <= half(Attribute.OPACITIES) + 1e-5
    assert np.abs(out.sh0 - source.sh0).max() <= half(Attribute.SH0) + 1e-4
    # Codebook rows are off norm one by their own steps only.
    norms = covariance.scale_factor(out.scales) - covariance.scale_factor(source.scales)
    own = half(Attribute.SCALE_FACTOR) + half(Attribute.SCALES)
    assert np.abs(norms).max() <= own * 1.01 + 1e-5


def test_what_the_codebook_fits_badly_is_an_escape_row():
    splats = oracle.scene(8, n=N)
    energy = np.full(N, 1e-6)
    energy[::5] = 1e2
    plan = planned(splats, energy, lagrangian=1e-6)
    assert plan.shape_escape[::5].mean() > 0.9
    assert plan.shape_escape[1::5].mean() < 0.1
    assert plan.colour_escape[::5].mean() > 0.9
    assert not plan.colour_escape[1::5].any()
    payloads, out = decoded(splats, plan)
    own = np.flatnonzero(plan.colour_escape)
    step = EnergyCosts(1e-6, energy[own]).step(Attribute.SHN)
    assert np.abs(out.shN[own] - splats.shN[own]).max() <= step / 2 * 1.001 + 1e-6
    shapes = np.array(shape_distance(out, splats))
    assert shapes[plan.shape_escape].max() < 0.02
    assert shapes[~plan.shape_escape].mean() > shapes[plan.shape_escape].mean()
    assert payloads.head_needs == (0,)
    assert payloads.tail_needs == (1,)


@pytest.mark.parametrize(("lagrangian", "escape"), [(1e-14, True), (1e3, False)])
def test_all_or_none_may_be_escape_rows(lagrangian, escape):
    splats = oracle.scene(9, n=N)
    plan = planned(splats, lagrangian=lagrangian)
    assert (plan.colour_escape == escape).all()
    if escape:
        assert plan.shape_escape.mean() > 0.95
    else:
        assert not plan.shape_escape.any()
    _, out = decoded(splats, plan)
    assert len(out) == N
    if escape:
        np.testing.assert_allclose(out.shN, splats.shN, atol=1e-4)
        assert max(shape_distance(out, splats)) < 1e-3


def test_finer_slopes_cost_bytes_and_save_error():
    splats = oracle.scene(10, n=N)
    sizes, errors = [], []
    for lagrangian in (1e-4, 1e-6, 1e-8, 1e-10):
        payloads, out = decoded(splats, planned(splats, lagrangian=lagrangian))
        sizes.append(len(payloads.head) + len(payloads.tail))
        errors.append(float(np.square(out.shN - splats.shN).mean()))
    assert sizes == sorted(sizes)
    assert errors == sorted(errors, reverse=True)


@pytest.mark.parametrize("n", [1, 2, 17])
@pytest.mark.parametrize("degree", [0, 3])
def test_few_and_equal_splats(n, degree):
    one = oracle.scene(11, n=1, degree=degree)
    splats = one.take(np.zeros(n, np.int64))
    plan = planned(splats)
    assert plan.shape_rows == 1
    assert plan.colour_rows == (1 if degree else 0)
    for morton in (True, False):
        payloads, out = decoded(splats, plan, morton=morton)
        assert (payloads.tail is None) == (degree == 0)
        np.testing.assert_array_equal(out.means, splats.means)
        assert max(shape_distance(out, splats)) < 0.05
        if degree:
            np.testing.assert_allclose(out.shN, splats.shN, atol=0.05)


def test_a_chunk_holds_the_rows_it_is_asked_for():
    splats = oracle.scene(12, n=N)
    plan = planned(splats)
    _, whole = decoded(splats, plan)
    rows = np.array([599, 3, 77, 3])
    _, out = decoded(splats, plan, rows)
    np.testing.assert_allclose(out.means, whole.means[rows], atol=0.05)
    np.testing.assert_array_equal(
        out.shN[~plan.colour_escape[rows]], whole.shN[rows][~plan.colour_escape[rows]]
    )


@pytest.mark.parametrize("scales", [(-30, -1, -1), (-30, -30, -1), (40, -1, -1), (-1e6, 0, 1e6)])
def test_needles_and_discs_neither_fail_nor_spread(scales):
    splats = oracle.scene(13, n=N, degree=0)
    splats.scales[::7] = scales
    plan = planned(splats)
    _, out = decoded(splats, plan)
    assert np.isfinite(out.scales).all()
    factors = covariance.scale_factor(splats.scales)
    error = np.abs(covariance.scale_factor(out.scales) - factors)
    assert error.max() <= max(np.ptp(factors) / 2**23, 0.05)


def test_inputs_are_left_alone():
    splats = oracle.scene(14, n=N)
    before = replace(splats, **{f: getattr(splats, f).copy() for f in ("quats", "scales", "shN")})
    decoded(splats, planned(splats))
    for name in ("quats", "scales", "shN"):
        np.testing.assert_array_equal(getattr(splats, name), getattr(before, name))


def test_progress_is_told_and_may_stop_it():
    calls = []
    splats = oracle.scene(15, n=50)
    planned(splats, progress=lambda *call: calls.append(call))
    assert calls == [("codebooks", done, 2) for done in range(3)]

    def stop(stage, done, total):
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        planned(splats, progress=stop)
