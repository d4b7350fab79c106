"""Check the arrays of a checkpoint before training resumes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError
from cogsplat.codec.splats import Splats

from .differentiable_rendering import Gradients

CheckpointArrays = Mapping[str, NDArray[np.generic]]
"""Checkpoint: all arrays needed to resume training, by name."""

_MAX_STEPS = 1 << 40


def checkpoint_array(
    state: CheckpointArrays, name: str, shape: tuple[int | None, ...], kind: str = "f"
) -> NDArray[np.generic]:
    """Return an array of a checkpoint.

    Parameters
    ----------
    state : mapping of str to array
        Checkpoint.
    name : str
        Name of the array.
    shape : tuple of int or None
        Expected shape; None for an axis of any length.
    kind : str
        Expected kind of the numbers, as `numpy.dtype.kind`: ``f`` or ``i``.

    Raises
    ------
    FormatError
        ``bad-checkpoint``: the array is missing, or has another shape or type.
    """
    values = state.get(name)
    if values is None:
        raise FormatError("bad-checkpoint", f"no array {name!r}, expected all of a checkpoint")
    lengths = zip(values.shape, shape, strict=False)
    fits = values.ndim == len(shape) and all(n in (length, None) for length, n in lengths)
    if not fits or values.dtype.kind != kind:
        raise FormatError(
            "bad-checkpoint",
            f"array {name!r} of {values.dtype} and shape {values.shape}, expected type {kind} and "
            f"shape {shape}",
        )
    return values


def checkpoint_count(state: CheckpointArrays, name: str) -> int:
    """Return a count of a checkpoint, such as its steps; raises like `checkpoint_array`."""
    count = int(checkpoint_array(state, name, (), "i"))
    if not 0 <= count <= _MAX_STEPS:
        raise FormatError("bad-checkpoint", f"{name} of {count}, expected 0 to {_MAX_STEPS}")
    return count


def checkpoint_splats(
    state: CheckpointArrays, prefix: str, source: Splats
) -> dict[str, NDArray[np.float32]]:
    """Return the arrays of a scene by name, in which every array has one row per splat.

    Parameters
    ----------
    state : mapping of str to array
        Checkpoint.
    prefix : str
        Beginning of the names of the arrays.
    source : Splats
        Scene whose arrays have the same axes; the number of splats may differ.

    Raises
    ------
    FormatError
        ``bad-checkpoint``: an array is missing, or has another shape or type.
    """
    rows = len(checkpoint_array(state, f"{prefix}opacities", (None,)))
    shapes = {name: (rows, *getattr(source, name).shape[1:]) for name in Gradients.names()}
    return {
        name: np.array(checkpoint_array(state, f"{prefix}{name}", shape), np.float32)
        for name, shape in shapes.items()
    }
