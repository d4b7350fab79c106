import numpy as np
import oracle
import pytest
from gsplat_on_cpu import on_cpu

from cogsplat.codec.errors import DataError
from cogsplat.codec.fit.differentiable_rendering import Gradients, render_forward
from cogsplat.codec.render.rasteriser import RenderConfig

torch = pytest.importorskip("torch", reason="needs torch")

from cogsplat.codec.fit.autograd import render  # noqa: E402


def tensors(splats):
    return [torch.from_numpy(getattr(splats, name)).requires_grad_() for name in Gradients.names()]


def test_picture_and_gradients_match_the_numpy_interface():
    splats, camera = oracle.scene(1, n=40), oracle.camera()
    forward = render_forward(splats, camera)
    wanted = Gradients.zeros(splats)
    forward.backward(2 * forward.picture, wanted)
    values = tensors(splats)
    picture = render(*values, camera)
    np.testing.assert_array_equal(picture.detach().numpy(), forward.picture)
    picture.square().sum().backward()
    for name, value in zip(Gradients.names(), values, strict=True):
        np.testing.assert_array_equal(value.grad.numpy(), getattr(wanted, name), err_msg=name)


def test_a_pytorch_optimiser_reduces_the_error():
    splats, camera = oracle.scene(2, n=40), oracle.camera()
    target = torch.full((camera.height, camera.width, 3), 0.4)
    values = tensors(splats)
    adam = torch.optim.Adam(values, lr=0.02)
    errors = []
    for _ in range(20):
        adam.zero_grad()
        error = (render(*values, camera) - target).square().mean()
        error.backward()
        adam.step()
        errors.append(error.item())
    assert errors[-1] < 0.5 * errors[0]


def test_tensors_changed_after_the_forward_pass_are_refused():
    values = tensors(oracle.scene(3, n=20))
    loss = render(*values, oracle.camera()).sum()
    with torch.no_grad():
        values[0] += 1.0
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        loss.backward()


def test_tensors_of_other_types_are_refused():
    values = tensors(oracle.scene(4, n=20))
    with pytest.raises(DataError, match="float32"):
        render(values[0].double(), *values[1:], oracle.camera())


def test_cuda_gradients_match_those_of_the_cpu(monkeypatch):
    splats, camera = oracle.scene(1, n=30), oracle.camera(width=30, height=20)
    gradients = []
    for device in ("cpu", "cuda"):
        values = tensors(splats)
        render(*values, camera, RenderConfig(device=device)).square().sum().backward()
        gradients.append([value.grad.numpy() for value in values])
        on_cpu(monkeypatch)
    for expected, found in zip(*gradients, strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())
