"""Merging of scenes: one scene in the frame of the first, with the highest SH degree."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cogsplat.codec.capture import merged_capture, moved_capture
from cogsplat.codec.errors import CogsplatWarning, DataError
from cogsplat.codec.splats import Splats, concatenate, sh_coefficients

from .transforms import convert_axes


def merge(parts: Sequence[Splats]) -> Splats:
    """Concatenate scenes with different frames; world positions are preserved.

    Parameters
    ----------
    parts : sequence of Splats
        Scenes, at least one. Axes and origins may differ; missing SH coefficients become zeros.

    Returns
    -------
    Splats
        Rows of all parts in order, with the `info` of the first part. The world position
        ``origin + means`` of every splat is preserved, rounded once to float32. Extras are kept
        only if all parts have them in the same type and shape.

    Raises
    ------
    ValueError
        There are no parts.
    DataError
        ``colour-spaces-differ``: some parts have linear colours, others display-referred colours;
        ``moved-too-far``: a centre overflows float32 relative to the first origin.

    Warns
    -----
    CogsplatWarning
        Extras are omitted, or a part was trained with a different kernel than the first.

    Examples
    --------
    >>> from cogsplat.codec.geometry.merging import merge
    >>> from cogsplat.codec.splats import empty
    >>> merge([empty(0, 2), empty(1, 3)])
    <Splats: 5 of SH degree 1>
    """
    if not parts:
        raise ValueError("no scenes, expected at least one to merge")
    first = parts[0].info
    degree = max(part.sh_degree for part in parts)
    kept = _shared_extras(parts)
    placed = []
    for number, part in enumerate(parts, 1):
        if part.info.colour_space != first.colour_space:
            raise DataError(
                "colour-spaces-differ",
                f"part {number} has colours in {part.info.colour_space}, "
                f"expected {first.colour_space} as the first",
            )
        if (part.info.kernel_px, part.info.antialiased) != (first.kernel_px, first.antialiased):
            warnings.warn(
                f"part {number} was trained with a kernel of {part.info.kernel_px:g} px² and the "
                f"first with {first.kernel_px:g} px², or one of them is anti-aliased; all are "
                "drawn as the first",
                CogsplatWarning,
                stacklevel=2,
            )
        extras = {name: part.extras[name] for name in kept}
        turned = convert_axes(replace(part, extras=extras), first.axes)
        placed.append(_at_origin(_with_degree(turned, degree), first.origin, number))
    capture = merged_capture([part.info.capture for part in placed])
    if not capture and any(part.info.capture for part in placed):
        warnings.warn(
            "not all parts know the viewpoints of their training pictures, or there are more than "
            "64; in small pictures, all are drawn as thick as usual",
            CogsplatWarning,
            stacklevel=2,
        )
    merged = concatenate(placed)
    return replace(merged, info=replace(merged.info, capture=capture))


def _shared_extras(parts: Sequence[Splats]) -> list[str]:
    """Return names of the extras common to all parts, and warn of the extras that are omitted."""
    kinds = [
        {(name, values.dtype.str, values.shape[1:]) for name, values in part.extras.items()}
        for part in parts
    ]
    shared = {name for name, *_ in set.intersection(*kinds)}
    lost = sorted({name for part in parts for name in part.extras} - shared)
    if lost:
        warnings.warn(
            f"the attributes {', '.join(lost)} are not alike in all parts and are left out",
            CogsplatWarning,
            stacklevel=3,
        )
    return [name for name in parts[0].extras if name in shared]


def _with_degree(part: Splats, degree: int) -> Splats:
    """Return the part with zero coefficients added up to an SH degree."""
    missing = sh_coefficients(degree) - sh_coefficients(part.sh_degree)
    return replace(part, shN=np.pad(part.shN, ((0, 0), (0, missing), (0, 0))))


def _at_origin(part: Splats, origin: tuple[float, float, float], number: int) -> Splats:
    """Return the part with its means relative to `origin`; `number` is for error messages."""
    if part.info.origin == origin:
        return part
    shift = np.array(part.info.origin) - np.array(origin)
    # NaN and infinite values are preserved.
    with np.errstate(invalid="ignore", over="ignore"):
        means = (part.means.astype(np.float64) + shift).astype(np.float32)
    lost = np.isfinite(part.means).all(axis=1) & ~np.isfinite(means).all(axis=1)
    if lost.any():
        raise DataError(
            "moved-too-far",
            f"part {number}: {int(lost.sum()):,} centres exceed float32 relative to the first "
            "part's origin, expected origins nearer to each other",
        )
    capture = moved_capture(part.info.capture, np.eye(3), shift)
    return replace(part, means=means, info=replace(part.info, origin=origin, capture=capture))
