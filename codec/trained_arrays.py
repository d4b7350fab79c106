"""Arrays of trained scenes: names, tensors, and the spaces of scales, opacities, quaternions."""

from __future__ import annotations

from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from .errors import DataError

_Float = TypeVar("_Float", np.float32, np.float64)

# Names of each array in trainers: gsplat's, then nerfstudio's.
TRAINED_NAMES: Final = {
    "means": ("means",),
    "scales": ("scales",),
    "quats": ("quats",),
    "opacities": ("opacities",),
    "sh0": ("sh0", "features_dc"),
    "shN": ("shN", "features_rest"),
}


def as_floats(name: str, values: object) -> NDArray[np.float32]:
    """Convert an array-like to float32, including tensors with gradients or on a device."""
    if hasattr(values, "detach"):
        values = values.detach().cpu().numpy()
    try:
        return np.asarray(values, np.float32)
    except (TypeError, ValueError) as error:
        raise DataError("bad-dtype", f"{name}: {error}, expected numbers") from error


def log_scales(values: NDArray[np.float32], space: str) -> NDArray[np.float32]:
    """Convert scales to natural logarithms from `space`, ``log`` or ``linear``."""
    if space == "log":
        return values
    if space != "linear":
        raise ValueError(f"scale_space {space!r}, expected 'log' or 'linear'")
    if not bool((values > 0).all()):
        raise DataError("bad-value", f"a linear scale of {values.min()}, expected more than 0")
    return np.log(values)


def logits(values: NDArray[np.float32], space: str) -> NDArray[np.float32]:
    """Convert opacities to logits from `space`, ``logit`` or ``unit``."""
    if space == "logit":
        return values
    if space != "unit":
        raise ValueError(f"opacity_space {space!r}, expected 'logit' or 'unit'")
    if not bool(((values >= 0) & (values <= 1)).all()):
        raise DataError(
            "bad-value",
            f"opacities from {values.min()} to {values.max()}, expected 0 to 1; trained ones are "
            "logits (opacity_space='logit')",
        )
    with np.errstate(divide="ignore"):
        wide = values.astype(np.float64)
        return (np.log(wide) - np.log1p(-wide)).astype(np.float32)


def opacities_from_logits(values: NDArray[_Float]) -> NDArray[_Float]:
    """Convert opacity logits, ±inf included, to opacities from 0 to 1 of the same precision."""
    with np.errstate(over="ignore"):
        return np.asarray(1.0 / (1.0 + np.exp(-values)), values.dtype)


def wxyz(values: NDArray[np.float32], order: str) -> NDArray[np.float32]:
    """Convert quaternions to wxyz from `order`, ``wxyz`` or ``xyzw``."""
    if order == "wxyz":
        return values
    if order != "xyzw":
        raise ValueError(f"quat_order {order!r}, expected 'wxyz' or 'xyzw'")
    return np.roll(values, 1, axis=-1)
