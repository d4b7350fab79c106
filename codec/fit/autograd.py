"""Differentiable rendering as a PyTorch autograd function."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from cogsplat.codec.cameras import Camera
from cogsplat.codec.render.rasteriser import RenderConfig
from cogsplat.codec.splats import SceneInfo, Splats

from .differentiable_rendering import Gradients, render_forward


def _array(tensor: torch.Tensor) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Return the values of a tensor as a numpy array in main memory."""
    found: np.ndarray[Any, np.dtype[np.float32]] = tensor.detach().cpu().numpy()
    return found


class _Render(torch.autograd.Function):  # type: ignore[misc]
    """Autograd function from the six tensors of a scene to a picture."""

    @staticmethod
    def forward(
        ctx: Any, camera: Camera, config: RenderConfig, info: SceneInfo, *tensors: torch.Tensor
    ) -> torch.Tensor:
        """Render the tensors of a scene; return the (H, W, 3) picture."""
        ctx.save_for_backward(*tensors)
        values: dict[str, Any] = dict(zip(Gradients.names(), map(_array, tensors), strict=True))
        ctx.forward_pass = render_forward(Splats(**values, info=info), camera, config)
        return torch.from_numpy(ctx.forward_pass.picture).to(tensors[0].device)

    @staticmethod
    def backward(ctx: Any, *by_outputs: torch.Tensor) -> tuple[Any, ...]:
        """Return the gradients of the six tensors, given the gradient of the picture."""
        # PyTorch raises here if a tensor was changed since the forward pass.
        means = ctx.saved_tensors[0]
        gradients = Gradients.zeros(ctx.forward_pass.splats)
        ctx.forward_pass.backward(_array(by_outputs[0].contiguous()), gradients)
        values = [getattr(gradients, name) for name in Gradients.names()]
        return (None, None, None, *(torch.from_numpy(value).to(means.device) for value in values))


def render(
    means: torch.Tensor,
    scales: torch.Tensor,
    quats: torch.Tensor,
    opacities: torch.Tensor,
    sh0: torch.Tensor,
    shN: torch.Tensor,
    camera: Camera,
    config: RenderConfig | None = None,
    info: SceneInfo | None = None,
) -> torch.Tensor:
    """Render splats as a PyTorch operation that is differentiable by all six tensors.

    Parameters
    ----------
    means : (N, 3) float32 tensor
        Means, scene units.
    scales : (N, 3) float32 tensor
        Log scales.
    quats : (N, 4) float32 tensor
        Quaternions, wxyz, of any non-zero norm.
    opacities : (N,) float32 tensor
        Opacity logits.
    sh0, shN : (N, 3), (N, K-1, 3) float32 tensor
        SH coefficients.
    camera : Camera
        Camera in the frame of the means.
    config : RenderConfig or None
        Render settings. By default, over black and on the CPU. With ``device="cuda"``, forward and
        backward pass run on the GPU.
    info : SceneInfo or None
        Kernel and anti-aliasing; None for those of 3DGS.

    Returns
    -------
    (H, W, 3) float32 tensor
        Picture, not clipped, on the device of the means.

    Raises
    ------
    DataError
        ``bad-shape`` or ``bad-dtype``: the tensors do not form a scene.
    MissingExtraError, LimitError
        The errors of `rasteriser.render`.

    Examples
    --------
    >>> import torch
    >>> from cogsplat.codec.fit.autograd import render
    >>> import cogsplat
    >>> splats = cogsplat.read("scene.ply")
    >>> camera = cogsplat.read_cameras("cameras.json")[0]
    >>> names = ("means", "scales", "quats", "opacities", "sh0", "shN")
    >>> tensors = [torch.from_numpy(getattr(splats, name)).requires_grad_() for name in names]
    >>> render(*tensors, camera).square().mean().backward()
    >>> bool(tensors[0].grad.abs().max() > 0)
    True
    """
    tensors = (means, scales, quats, opacities, sh0, shN)
    picture: torch.Tensor = _Render.apply(
        camera, config or RenderConfig(), info or SceneInfo(), *tensors
    )
    return picture
