"""Pairs of a pixel and a splat on a CUDA device, with weights by the rules of `blending`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cogsplat.codec.geometry.frustum import ALPHA_MIN

from .blending import ALPHA_MAX, TRANSMITTANCE_MIN
from .projection import FLAT, NARROW, OPACITY, SHEAR, X, Y

# PyTorch is an optional dependency, so its tensors have no static type here.
Tensor = Any


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of a pixel and a splat drawn in it, sorted by pixel, then nearest splat first.

    Parameters
    ----------
    splat : (P,) int64 tensor
        Number of the footprint.
    pixel : (P,) int64 tensor
        Number of the pixel, row by row over the whole picture.
    first : (P,) int64 tensor
        Number of the first pair of the same pixel.
    u, v : (P,) float32 tensor
        Offset from the footprint's centre, scaled so that alpha is ``opacity · exp(-u² - v²)``.
    alpha : (P,) float32 tensor
        Alpha, at most `blending.ALPHA_MAX`.
    free : (P,) bool tensor
        Whether alpha is not capped; the derivatives of a capped alpha are 0.
    weight : (P,) float64 tensor
        Blending weight T·alpha.
    """

    splat: Tensor
    pixel: Tensor
    first: Tensor
    u: Tensor
    v: Tensor
    alpha: Tensor
    free: Tensor
    weight: Tensor

    def colour_derivatives(self, colours: Tensor, pictures: Tensor) -> Tensor:
        """Return the derivative of the pixel's colour w.r.t. ln alpha of the splat, by pair.

        The derivative equals the pixel's colour minus its colour without the splat.

        Parameters
        ----------
        colours : (M, 3) float64 tensor
            Colours of the footprints.
        pictures : (H·W, 3) float64 tensor
            Picture by pixel, with background if the derivative should include it.

        Returns
        -------
        (P, 3) float64 tensor
            T·alpha·colour - (colour behind the splat)·alpha / (1 - alpha) (Kerbl et al. 2023,
            appendix C).
        """
        shown = self.weight[:, None] * colours[self.splat]
        behind = pictures[self.pixel] - _running_sums(shown, self.first)
        alpha = self.alpha.double()
        return shown - behind * (alpha / (1.0 - alpha))[:, None]

    def largest(self, top_k: int) -> Tensor:
        """Return a mask of the `top_k` largest weights of each pixel; ties go to the nearest splat.

        Returns
        -------
        (P,) bool tensor
        """
        import torch

        by_weight = self.weight.argsort(descending=True, stable=True)
        order = by_weight[self.pixel[by_weight].argsort(stable=True)]
        kept = torch.zeros_like(self.free)
        kept[order] = torch.arange(len(order), device=order.device) - self.first < top_k
        return kept


def _running_sums(values: Tensor, first: Tensor) -> Tensor:
    """Return the running sum of values within each pixel, the pair itself included."""
    sums = values.cumsum(0)
    return sums - (sums - values)[first]


def _first(pixel: Tensor) -> Tensor:
    """Return the number of the first pair of each pair's pixel; pairs must be sorted by pixel."""
    import torch

    _, place, counts = torch.unique_consecutive(pixel, return_inverse=True, return_counts=True)
    return (counts.cumsum(0) - counts)[place]


def drawn_pairs(splat: Tensor, pixel: Tensor, ellipse: Tensor, width: int) -> Pairs:
    """Select the pairs that are drawn, and compute their weights.

    Parameters
    ----------
    splat, pixel : (L,) int64 tensor
        Candidate pairs, sorted by pixel, then nearest splat first; none may be missing.
    ellipse : (M, 8) float32 tensor
        `Footprints.ellipse` of the footprints.
    width : int
        Width of the picture, px.
    """
    of = ellipse[splat]
    dx, dy = pixel % width + 0.5 - of[:, X], pixel // width + 0.5 - of[:, Y]
    u = of[:, NARROW] * (dx - of[:, SHEAR] * dy)
    v = of[:, FLAT].sqrt() * dy
    raw = of[:, OPACITY] * (-(u * u) - v * v).exp()
    alpha = raw.clamp(max=float(ALPHA_MAX))
    touched = alpha >= float(np.float32(ALPHA_MIN))
    splat, pixel, u, v, raw, alpha = (value[touched] for value in (splat, pixel, u, v, raw, alpha))
    through = (-alpha.double()).log1p()
    after = _running_sums(through, _first(pixel))
    # After a pair that ends the pixel, the transmittance stays below the limit.
    drawn = after.exp() >= float(TRANSMITTANCE_MIN)
    weight = (after - through).exp() * alpha
    values = (splat, pixel, u, v, alpha, raw <= float(ALPHA_MAX), weight)
    splat, pixel, u, v, alpha, free, weight = (value[drawn] for value in values)
    return Pairs(splat, pixel, _first(pixel), u, v, alpha, free, weight)
