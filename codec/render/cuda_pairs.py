"""Pairs of a pixel and a splat on a CUDA device: what each weighs by the rules of `blending`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cogsplat.codec.geometry.frustum import ALPHA_MIN

from .blending import ALPHA_MAX, TRANSMITTANCE_MIN
from .projection import FLAT, NARROW, OPACITY, SHEAR, X, Y

# PyTorch comes with an extra: its tensors have no type here.
Tensor = Any


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of a pixel and a splat that is drawn in it: by pixel, the nearest splat first.

    Parameters
    ----------
    splat : (P,) int64 tensor
        Number of the footprint.
    pixel : (P,) int64 tensor
        Row by row over the whole picture.
    first : (P,) int64 tensor
        Place of the first pair of the same pixel.
    u, v : (P,) float32 tensor
        Offset from the centre, in which alpha is ``opacity · exp(-u² - v²)``.
    alpha : (P,) float32 tensor
        At most `blending.ALPHA_MAX`.
    free : (P,) bool tensor
        Where alpha is not capped: elsewhere its derivatives are 0.
    weight : (P,) float64 tensor
        T·alpha.
    """

    splat: Tensor
    pixel: Tensor
    first: Tensor
    u: Tensor
    v: Tensor
    alpha: Tensor
    free: Tensor
    weight: Tensor

    def lost(self, colours: Tensor, pictures: Tensor) -> Tensor:
        """Return what pixels gain by ln alpha, which they lose without the splat.

        Parameters
        ----------
        colours : (M, 3) float64 tensor
            Of the footprints.
        pictures : (H·W, 3) float64 tensor
            All that shows behind a splat counts: with a background or without.

        Returns
        -------
        (P, 3) float64 tensor
            T·alpha·colour less what is behind times alpha / (1 - alpha) (Kerbl et al. 2023,
            appendix C).
        """
        shown = self.weight[:, None] * colours[self.splat]
        behind = pictures[self.pixel] - _running(shown, self.first)
        alpha = self.alpha.double()
        return shown - behind * (alpha / (1.0 - alpha))[:, None]

    def largest(self, top_k: int) -> Tensor:
        """Return whether each weight is among the largest of its pixel, of equal ones the nearest.

        Parameters
        ----------
        top_k : int
            How many of a pixel are.

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


def _running(values: Tensor, first: Tensor) -> Tensor:
    """Return sums of the values of a pixel up to each pair, this one included."""
    sums = values.cumsum(0)
    return sums - (sums - values)[first]


def _first(pixel: Tensor) -> Tensor:
    """Return the place of the first pair of each pair's pixel; pairs come by pixel."""
    import torch

    _, place, counts = torch.unique_consecutive(pixel, return_inverse=True, return_counts=True)
    return (counts.cumsum(0) - counts)[place]


def drawn_pairs(splat: Tensor, pixel: Tensor, ellipse: Tensor, width: int) -> Pairs:
    """Return those of some pairs that are drawn, with their weights.

    Parameters
    ----------
    splat, pixel : (L,) int64 tensor
        By pixel, the nearest splat first, and all that may be drawn.
    ellipse : (M, 8) float32 tensor
        Of the footprints.
    width : int
        Of the picture, px.
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
    after = _running(through, _first(pixel))
    # What follows a pair that would end the pixel leaves less transmittance still.
    drawn = after.exp() >= float(TRANSMITTANCE_MIN)
    weight = (after - through).exp() * alpha
    values = (splat, pixel, u, v, alpha, raw <= float(ALPHA_MAX), weight)
    splat, pixel, u, v, alpha, free, weight = (value[drawn] for value in values)
    return Pairs(splat, pixel, _first(pixel), u, v, alpha, free, weight)
