"""Pictures equal those of the rasteriser; gradients match a float64 oracle in PyTorch."""

from dataclasses import replace

import numpy as np
import oracle
import pytest
import torch_oracle
from gsplat_on_cpu import on_cpu

from cogsplat.codec.fit.differentiable_rendering import Gradients, render_forward
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.splats import SceneInfo, Splats

torch = torch_oracle.torch

BACKGROUND = (0.613, 0.01, 0.398)


def derivatives(splats: Splats, camera, target, background):
    """Return the picture and the gradients of a squared error from the oracle."""
    values = {
        name: torch.from_numpy(getattr(splats, name).astype(np.float64)).requires_grad_()
        for name in Gradients.names()
    }
    added = np.array([oracle.added(splats, camera, row) for row in range(len(splats))])
    seen = torch_oracle.picture(values, camera, added, background=background)
    (seen - torch.from_numpy(target.astype(np.float64))).square().sum().backward()
    found = {name: value.grad.numpy() for name, value in values.items()}
    return seen.detach().numpy(), found


def small_scene(seed: int, degree: int, opacity: float = 1.5, info: SceneInfo | None = None):
    splats = oracle.scene(seed, n=30, degree=degree, opacity=opacity, info=info)
    camera = oracle.camera(angle=seed + 0.3, width=37, height=21, focal=24.0, shift=1.5)
    rng = np.random.default_rng(seed)
    target = rng.uniform(size=(camera.height, camera.width, 3)).astype(np.float32)
    return splats, camera, target


@pytest.mark.parametrize("info", oracle.INFOS.values(), ids=oracle.INFOS)
@pytest.mark.parametrize(("seed", "degree"), [(0, 0), (1, 1), (2, 2), (3, 3), (4, 3)])
def test_gradients_match_the_oracle(seed, degree, info):
    splats, camera, target = small_scene(seed, degree, info=info)
    config = RenderConfig(background=BACKGROUND)
    forward = render_forward(splats, camera, config)
    seen, expected = derivatives(splats, camera, target, BACKGROUND)
    # A pixel at which alpha is within rounding of 1/255 may fall to either side.
    same = np.abs(forward.picture - seen) < 1e-4
    assert same.mean() > 0.999
    found = Gradients.zeros(splats)
    forward.backward(2 * (forward.picture - target), found)
    for name, wanted in expected.items():
        size = np.abs(wanted).max(initial=1e-9)
        off = np.abs(getattr(found, name) - wanted)
        assert np.sum(off > 2e-3 * size) <= 0.01 * off.size, f"{name}: {off.max(initial=0):.2g} off"


def test_gradients_of_one_splat_are_finite_differences():
    splats = oracle.scene(5, n=1, degree=3)
    splats.means[:] = [[0.1, -0.1, 0.2]]
    splats.scales[:] = [[-0.9, -1.4, -1.1]]
    splats.opacities[:] = 1.0
    camera = oracle.camera(angle=0.4, width=40, height=30, focal=26.0)
    weights = np.random.default_rng(5).normal(size=(30, 40, 3))
    # Only pixels well above the alpha threshold of 1/255, which none may cross.
    weights[render_forward(splats, camera).picture.max(axis=2) < 0.02] = 0.0
    found = Gradients.zeros(splats)
    render_forward(splats, camera).backward(weights.astype(np.float32), found)
    for name in Gradients.names():
        values = getattr(splats, name)
        for place in np.ndindex(values.shape):
            step = np.zeros_like(values)
            step[place] = 2e-3
            up, down = (
                oracle.view(replace(splats, **{name: values + sign * step}), camera).image
                for sign in (1, -1)
            )
            wanted = np.sum(weights * (up - down)) / 4e-3
            assert getattr(found, name)[place] == pytest.approx(wanted, rel=0.01, abs=0.01), name


def test_pictures_equal_those_of_the_rasteriser_for_any_threads():
    splats = oracle.scene(6, n=300)
    camera = oracle.camera(width=90, height=70, focal=70.0)
    found = []
    for threads in (1, 3):
        config = RenderConfig(background=BACKGROUND, threads=threads)
        forward = render_forward(splats, camera, config)
        np.testing.assert_array_equal(forward.picture, render(splats, camera, config))
        gradients = Gradients.zeros(splats)
        forward.backward(forward.picture - 0.5, gradients)
        found.append(gradients)
    for name in Gradients.names():
        one, three = (getattr(gradients, name) for gradients in found)
        assert np.abs(one).max() > 0
        np.testing.assert_array_equal(one, three, err_msg=name)


def test_gradients_of_two_pictures_add_up_and_clear():
    splats, camera, target = small_scene(7, 2)
    forward = render_forward(splats, camera)
    once, twice = Gradients.zeros(splats), Gradients.zeros(splats)
    centres = forward.backward(forward.picture - target, once)
    for _ in range(2):
        forward.backward(forward.picture - target, twice)
    for name in Gradients.names():
        np.testing.assert_allclose(getattr(twice, name), 2 * getattr(once, name), rtol=1e-6)
    assert centres.shape == (len(forward.footprints), 2)
    assert np.abs(centres).max() > 0
    twice.clear()
    assert not any(getattr(twice, name).any() for name in Gradients.names())


def test_sh_degrees_that_are_not_rendered_have_no_gradients():
    splats, camera, target = small_scene(8, 3)
    forward = render_forward(splats, camera, RenderConfig(sh_degree=1))
    found = Gradients.zeros(splats)
    forward.backward(forward.picture - target, found)
    assert np.abs(found.shN[:, :3]).max() > 0
    assert not found.shN[:, 3:].any()


def test_infinite_opacities_and_invisible_splats_have_no_gradients():
    splats, camera, target = small_scene(9, 1)
    splats.opacities[:2] = [np.inf, -np.inf]
    splats.means[2] = camera.position - 5.0 * camera.rotation[2]
    found = Gradients.zeros(splats)
    forward = render_forward(splats, camera)
    forward.backward(forward.picture - target, found)
    assert not found.opacities[:2].any()
    assert not any(getattr(found, name)[2].any() for name in Gradients.names())
    assert all(np.isfinite(getattr(found, name)).all() for name in Gradients.names())


@pytest.mark.parametrize("info", oracle.INFOS.values(), ids=oracle.INFOS)
def test_cuda_gradients_match_up_to_rounding(monkeypatch, info):
    splats, camera, target = small_scene(3, 2, info=info)
    splats.opacities[::4] = 9.0
    config = RenderConfig(background=BACKGROUND)
    expected, wanted = render_forward(splats, camera, config), Gradients.zeros(splats)
    sums = expected.footprint_sums(2 * (expected.picture - target))
    centres = expected.add_gradients(sums, wanted)
    on_cpu(monkeypatch)
    forward, found = (
        render_forward(splats, camera, replace(config, device="cuda")),
        Gradients.zeros(splats),
    )
    np.testing.assert_allclose(forward.picture, expected.picture, atol=1e-4)
    np.testing.assert_array_equal(forward.footprints.index, expected.footprints.index)
    by_picture = 2 * (forward.picture - target)
    assert_close(forward.footprint_sums(by_picture), sums)
    assert_close(forward.backward(by_picture, found), centres)
    for name in Gradients.names():
        assert_close(getattr(found, name), getattr(wanted, name))


def assert_close(found, expected):
    """All but a few are near: alpha within rounding of 1/255 may fall to either side."""
    assert np.mean(np.abs(found - expected) > 1e-3 * np.abs(expected).max()) <= 0.01
