from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.fit.differentiable_rendering import Gradients
from cogsplat.codec.fit.splat_adam import SplatAdam

torch = pytest.importorskip("torch", reason="needs torch")


def random_gradients(splats, seed):
    rng = np.random.default_rng(seed)
    arrays = {
        name: rng.normal(size=getattr(splats, name).shape).astype(np.float32)
        for name in Gradients.names()
    }
    return Gradients(**arrays)


def copy(splats):
    return replace(splats, **{name: getattr(splats, name).copy() for name in Gradients.names()})


def rates_of(splats):
    return {
        name: np.linspace(0.01, 0.02, len(splats), dtype=np.float32) for name in Gradients.names()
    }


def test_steps_match_pytorch():
    splats = oracle.scene(0, n=12, degree=1)
    values = torch.from_numpy(splats.scales.copy()).requires_grad_()
    other = torch.optim.Adam([values], lr=0.01, betas=(0.9, 0.999), eps=1e-15)
    adam, moved = SplatAdam(splats), copy(splats)
    for step in range(5):
        gradients = random_gradients(splats, step)
        values.grad = torch.from_numpy(gradients.scales.copy())
        other.step()
        adam.step(moved, gradients, {"scales": np.full(12, 0.01, np.float32)})
    np.testing.assert_allclose(moved.scales, values.detach().numpy(), rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(moved.means, splats.means)


def test_the_result_does_not_depend_on_threads():
    splats = oracle.scene(1, n=50)
    found = []
    for threads in (1, 3):
        adam, moved = SplatAdam(splats), copy(splats)
        for step in range(3):
            adam.step(moved, random_gradients(splats, step), rates_of(splats), threads)
        found.append(moved)
    for name in Gradients.names():
        np.testing.assert_array_equal(*(getattr(moved, name) for moved in found), err_msg=name)


def test_moments_survive_selection_and_checkpoints():
    splats = oracle.scene(2, n=20)
    rows = np.array([3, 4, 11])
    adam, moved = SplatAdam(splats), copy(splats)
    adam.step(moved, random_gradients(splats, 0), rates_of(splats))
    later = random_gradients(splats, 1)
    fewer = copy(moved.take(rows))
    some = Gradients(**{name: getattr(later, name)[rows].copy() for name in Gradients.names()})
    rates = {name: rate[rows].copy() for name, rate in rates_of(splats).items()}
    SplatAdam.from_state(adam.select(rows).state(), fewer).step(fewer, some, rates)
    adam.step(moved, later, rates_of(splats))
    for name in Gradients.names():
        np.testing.assert_array_equal(getattr(fewer, name), getattr(moved, name)[rows])


def test_scenes_of_sh_degree_0_are_updated():
    splats = oracle.scene(3, n=5, degree=0)
    moved = copy(splats)
    SplatAdam(splats).step(moved, random_gradients(splats, 0), rates_of(splats))
    assert np.abs(moved.sh0 - splats.sh0).min() > 0
