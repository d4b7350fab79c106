"""Extra properties of a PLY's vertices, and the origin of scenes in map coordinates."""

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
"""Properties that 3DGS training writes as zeros and never reads."""

# A property name that every PLY parser reads as one word.
_WORD: Final = re.compile(r"[!-~]+")

# A scene is in map coordinates if its centre is farther from zero than both limits: this distance,
# where float32 steps are about 1/8000 of a unit, and this multiple of the scene's extent.
_MAP_DISTANCE: Final = 1000.0
_MAP_EXTENTS: Final = 4.0


def extra_properties(
    vertex: Element, fields: Mapping[str, Collection[str]], where: str
) -> list[Property]:
    """Return the vertex properties that become extra attributes of the scene.

    Parameters
    ----------
    vertex : Element
        The vertex element, without lists.
    fields : mapping of str to collection of str
        Properties of each array of `Splats`; these become no extras.
    where : str
        Name of the file for messages.

    Returns
    -------
    list of Property
        At most `MAX_EXTRAS` properties, in file order, with names of at most
        `MAX_EXTRA_NAME_BYTES` bytes. A warning reports any that are skipped.
    """
    standard = {name for group in fields.values() for name in group}
    extra = [prop for prop in vertex.properties if prop.name not in standard]
    kept = [prop for prop in extra if len(prop.name.encode()) <= MAX_EXTRA_NAME_BYTES]
    kept = kept[:MAX_EXTRAS]
    if len(kept) < len(extra):
        warnings.warn(
            f"{where}: {len(extra) - len(kept)} of {len(extra)} extra properties are skipped, "
            f"expected at most {MAX_EXTRAS} with names of at most "
            f"{MAX_EXTRA_NAME_BYTES} bytes",
            CogsplatWarning,
            stacklevel=3,
        )
    return kept


def without_zero_normals(extras: dict[str, Extra]) -> dict[str, Extra]:
    """Return the extras; normals are removed if all of their values are zero."""
    normals = [name for name in NORMALS if name in extras]
    if any(extras[name].any() for name in normals):
        return extras
    return {name: values for name, values in extras.items() if name not in normals}


def extra_columns(
    extras: Mapping[str, Extra], reserved: Collection[str]
) -> tuple[dict[str, Extra], list[str]]:
    """Return the PLY columns of a scene's extras, and the extras that a PLY cannot hold.

    Parameters
    ----------
    extras : mapping of str to array
        Extra attributes; one with several components becomes columns ``name_0``, ``name_1``, …
    reserved : collection of str
        Property names that extras must not use.

    Returns
    -------
    columns : dict of str to (N,) array
        Values by property name.
    dropped : list of str
        A phrase for each extra whose name is reserved or is no ASCII word.
    """
    columns: dict[str, Extra] = {}
    dropped = []
    for name, values in extras.items():
        own = {name: values}
        if values.ndim == 2:
            own = {f"{name}_{k}": values[:, k] for k in range(values.shape[1])}
        if all(_WORD.fullmatch(n) and n not in reserved and n not in columns for n in own):
            columns |= own
        else:
            dropped.append(f"the attribute {name!r}")
    return columns, dropped


def split_origin(
    means: NDArray[np.float64], where: str
) -> tuple[NDArray[np.float64], tuple[float, float, float]]:
    """Split map coordinates, which float32 would round, into an origin and relative means.

    Parameters
    ----------
    means : (N, 3) float64
        Centres in scene units.
    where : str
        Name of the file for the warning that reports the origin.

    Returns
    -------
    means : (N, 3) float64
        Centres relative to the origin.
    origin : tuple of float
        Whole numbers near the median centre; zeros if the scene is not in map coordinates.
    """
    zero = (0.0, 0.0, 0.0)
    finite = means[np.isfinite(means).all(axis=1)]
    if not len(finite):
        return means, zero
    low, centre, high = np.quantile(finite, [0.01, 0.5, 0.99], axis=0, method="nearest")
    with np.errstate(over="ignore"):
        extent = float((high - low).max())
        distance = float(np.abs(centre).max())
        if not max(_MAP_DISTANCE, _MAP_EXTENTS * extent) < distance < np.inf:
            return means, zero
        # Adding 0.0 turns -0.0 into 0.0.
        x, y, z = (float(value) + 0.0 for value in np.rint(centre))
        warnings.warn(
            f"{where}: centres lie about ({x:.0f}, {y:.0f}, {z:.0f}), which becomes the origin; "
            "cameras are expected relative to it",
            CogsplatWarning,
            stacklevel=3,
        )
        return means - np.array([x, y, z]), (x, y, z)
