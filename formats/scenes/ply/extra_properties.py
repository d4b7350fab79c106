"""Extra properties of a PLY's vertices, and doubles far from zero as offsets from an origin."""

from __future__ import annotations

import re
import warnings
from collections.abc import Collection, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.splats import MAX_EXTRA_NAME_BYTES, MAX_EXTRAS, Extra

from .header import Element, Property

NORMALS: Final = ("nx", "ny", "nz")
"""What 3DGS training writes as zeros and never reads."""

# What any parser of PLY takes for one word.
_WORD: Final = re.compile(r"[!-~]+")

# Float32 steps at this distance are about 1/8000 of a unit; farther than this, and than so many
# times the scene's own extent, its centre is taken for a place on a map.
_FAR: Final = 1000.0
_FAR_EXTENTS: Final = 4.0


def extra_properties(
    vertex: Element, fields: Mapping[str, Collection[str]], where: str
) -> list[Property]:
    """Return the properties that become extras: scalars other than a splat's own values.

    More than `Splats` can hold, or names too long for it, are left out with a warning.
    """
    drawn = {name for group in fields.values() for name in group}
    others = [prop for prop in vertex.properties if prop.name not in drawn]
    kept = [prop for prop in others if len(prop.name.encode()) <= MAX_EXTRA_NAME_BYTES]
    kept = kept[:MAX_EXTRAS]
    if len(kept) < len(others):
        warnings.warn(
            f"{where}: {len(others) - len(kept)} of {len(others)} properties beside those of a "
            f"3DGS scene are left out, expected at most {MAX_EXTRAS} with names of at most "
            f"{MAX_EXTRA_NAME_BYTES} bytes",
            CogsplatWarning,
            stacklevel=3,
        )
    return kept


def without_padding(extras: dict[str, Extra]) -> dict[str, Extra]:
    """Return extras without normals that are all zero."""
    there = [name for name in NORMALS if name in extras]
    if any(extras[name].any() for name in there):
        return extras
    return {name: values for name, values in extras.items() if name not in there}


def extra_columns(
    extras: Mapping[str, Extra], taken: Collection[str]
) -> tuple[dict[str, Extra], list[str]]:
    """Return the columns to write, and the names of extras that no PLY can hold.

    Parameters
    ----------
    extras : mapping
        Of a scene; those of several components become columns ``name_0``, ``name_1`` and on.
    taken : collection of str
        Properties that have their place already.

    Returns
    -------
    columns : dict of str to (N,) array
    losses : list of str
        Extras whose names are no words of ASCII, or are taken.
    """
    columns: dict[str, Extra] = {}
    losses = []
    for name, values in extras.items():
        own = {name: values}
        if values.ndim == 2:
            own = {f"{name}_{k}": values[:, k] for k in range(values.shape[1])}
        if all(_WORD.fullmatch(n) and n not in taken and n not in columns for n in own):
            columns |= own
        else:
            losses.append(f"the attribute {name!r}")
    return columns, losses


def as_origin(
    means: NDArray[np.float64], where: str
) -> tuple[NDArray[np.float64], tuple[float, float, float]]:
    """Return means relative to a whole-numbered origin where float32 would lose their digits.

    Parameters
    ----------
    means : (N, 3) float64
    where : str
        Name of the file for the warning that says so.

    Returns
    -------
    means : (N, 3) float64
    origin : tuple of float
        Zeros where they stay as they are.
    """
    still = (0.0, 0.0, 0.0)
    finite = means[np.isfinite(means).all(axis=1)]
    if not len(finite):
        return means, still
    low, centre, high = np.quantile(finite, [0.01, 0.5, 0.99], axis=0, method="nearest")
    with np.errstate(over="ignore"):
        extent = float((high - low).max())
        far = float(np.abs(centre).max())
        if not max(_FAR, _FAR_EXTENTS * extent) < far < np.inf:
            return means, still
        # Plus zero, for what rounds to -0.
        x, y, z = (float(value) + 0.0 for value in np.rint(centre))
        warnings.warn(
            f"{where}: centres lie about ({x:.0f}, {y:.0f}, {z:.0f}), which becomes the origin; "
            "cameras are expected relative to it",
            CogsplatWarning,
            stacklevel=3,
        )
        return means - np.array([x, y, z]), (x, y, z)
