"""Every technique can be left out: other bytes, still a file, still the scene."""

from dataclasses import fields, replace

import decoding
import numpy as np
import oracle
import pytest
from encoding import encode, unseen

from cogsplat.codec.encode.config import Ablation
from cogsplat.codec.rate import allocation
from cogsplat.codec.rate import costs as rate_costs
from cogsplat.codec.render.sensitivities import Sensitivities
from cogsplat.codec.scoring.contribution import zero_scores
from cogsplat.codec.splats import concatenate

N = 900
TECHNIQUES = [field.name for field in fields(Ablation)]


def scored():
    rng = np.random.default_rng(5)
    energy = rng.lognormal(-9, 2, N)

    def cost(*shape):
        return energy.reshape(-1, *[1] * len(shape)) * rng.lognormal(0, 1, (N, *shape))

    spread = rng.normal(size=(15, 15))
    return replace(
        zero_scores(N),
        contribution=energy * rng.lognormal(0, 1, N),
        energy=energy,
        basis_mean=rng.normal(0, 0.3, (N, 15)).astype(np.float32),
        basis_spread=spread @ spread.T / 100,
        sensitivities=Sensitivities(cost(), cost(3), cost(3), cost(3), cost(3)),
    )


def encoded(ablation):
    config = unseen(chunk_splats=300, prune=None, ablation=ablation, quality_db=40)
    return encode(oracle.scene(3, n=N, degree=3), scored(), config)


def payloads(scene):
    parts = [payload for book in scene.codebooks for payload in book.payloads]
    return [*parts, *(p for c in scene.chunks for p in (c.payloads.head, c.payloads.tail))]


@pytest.fixture(scope="module")
def whole():
    return payloads(encoded(Ablation()))


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_without_a_technique_it_is_another_file_of_the_same_scene(technique, whole):
    without = encoded(Ablation(**{technique: False}))
    assert payloads(without) != whole
    out = concatenate(decoding.chunks(without))
    assert len(out) == N
    for name in ("means", "scales", "quats", "opacities", "sh0", "shN"):
        assert np.isfinite(getattr(out, name)).all(), name


def test_without_any_it_still_decodes():
    nothing = Ablation(**dict.fromkeys(TECHNIQUES, False))
    assert len(concatenate(decoding.chunks(encoded(nothing)))) == N


def test_equalised_costs_give_one_step():
    costs = rate_costs.costs(oracle.scene(3, n=N, degree=3), scored())
    level = costs.equalise()
    rng = np.random.default_rng(1)
    for name in ("energy", "mean", "opacity", "scale_long", "swing", "twist"):
        own = getattr(level, name)
        assert own.mean() == pytest.approx(getattr(costs, name).mean())
        part = rng.choice(N, 50)
        steps = [allocation.equal_step(1e-6, x) for x in (own[part], own)]
        assert steps[0] == pytest.approx(steps[1], rel=1e-12)
    np.testing.assert_array_equal(level.basis_mean, costs.basis_mean)
