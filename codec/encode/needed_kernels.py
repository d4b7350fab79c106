"""List the kernels that an encode calls, to be compiled ahead."""

from __future__ import annotations

from typing import Final

from cogsplat.codec.compiling import DeclaredKernel, kernels_in
from cogsplat.codec.order.orders import split_name

from .config import EncodeConfig

# Kernels that share inner kernels are adjacent; see the notes of `needed_kernels`.
_LOSSY: Final = ("rate.sparse_codes", "render.sensitivities")
_BLENDING: Final = ("render.blend_weights", "render.rasteriser")
_GAIN: Final = ("render.marginal_gains",)
_FIT: Final = ("render.gradients", "encode.shift_kernels")
_OTHERS: Final = (
    "render.shading",
    "scoring.view_sums",
    "render.depth_order",
    "render.visible_depth",
    "render.tiles",
    "render.projection",
    "render.splat_blocks",
    # Of the first view, of close views, in which predictions are measured, and of planned ones.
    "render.peak_weights",
    "views.occlusion",
)


def needed_kernels(config: EncodeConfig) -> list[DeclaredKernel]:
    """Return the kernels that an encode calls.

    Parameters
    ----------
    config : EncodeConfig
        Configuration of the encode.

    Notes
    -----
    Kernels that share inner kernels are adjacent, so that one process compiles the inner kernels
    for all of them.
    """
    modules = [
        *(_GAIN if split_name(config.order)[0] == "gain" else ()),
        *(() if config.profile == "near-lossless" else _LOSSY),
        *_BLENDING,
        *(_FIT if config.compensates else ()),
        *_OTHERS,
    ]
    return kernels_in(f"cogsplat.codec.{module}" for module in modules)
