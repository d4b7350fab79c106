""".splat scenes: records of 32 bytes without a header, the format of antimatter15/splat.

A record holds the position (3 float32), standard deviations (3 float32, linear), colour and opacity
(4 uint8, activated) and a quaternion (4 uint8, wxyz, 128 for zero). SH is of degree 0.
"""

from __future__ import annotations

import os
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError, StorageError
from cogsplat.codec.geometry.rotations import unit
from cogsplat.codec.geometry.sh import C0
from cogsplat.codec.geometry.transforms import convert_axes
from cogsplat.codec.splats import Splats, empty
from cogsplat.formats.storage.atomic import StrPath, atomic_write, open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.magic import describe

from .dropped_values import dropped_extras, dropped_info, warn_dropped
from .quantised_values import BYTE_LOGITS, opacity_bytes, unit_opacities

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

RECORD: Final = np.dtype(
    [("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("quats", "u1", 4)]
)

# Axes of 3DGS training, which viewers of this format expect.
_AXES: Final = "RDF"

_BLOCK_ROWS: Final = 1 << 14

COLOUR_BYTES: Final = ((np.arange(256) / 255 - 0.5) / C0).astype(np.float32)
"""Lookup table from a colour byte to its DC coefficient, (256,) float32."""

# Log scale that replaces a scale of zero: the logarithm of half the smallest float32.
_ZERO_LOG_SCALE: Final = np.float32(np.log(2.0**-150))


def no_magic(head: bytes) -> bool:
    """Return False: the format has no magic bytes, so its extension decides."""
    return False


def log_scales(linear: F32, zero: np.float32) -> F32:
    """Return the logarithms of standard deviations: `zero` for 0, NaN for negative values.

    Parameters
    ----------
    linear : (..., 3) float32
        Standard deviations, scene units.
    zero : float32
        Finite log scale of a flat splat: a row with infinite values would be invalid.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(linear)
        logs[linear == 0] = zero
    return logs


def read_splat(path: StrPath, *, limits: Limits | None = None) -> Splats:
    """Read a scene from a .splat file.

    Parameters
    ----------
    path : path
        A file of 32-byte records.
    limits : Limits, optional
        Limits on splats and decoded bytes.

    Returns
    -------
    Splats
        Splats of SH degree 0 in RDF axes. Opacity byte 255 is a logit of +inf, 0 of -inf. Rows
        with NaN are kept.

    Raises
    ------
    FormatError
        ``splat-size``: the file's size is not a multiple of 32 bytes.
    LimitError
        ``decoded-size``, ``too-many-splats``.
    StorageError
        See `open_for_read`; ``file-changed``: another process truncated the file.
    """
    where = os.fspath(path)
    with storage_errors(path), open_for_read(path) as file:
        size = os.fstat(file.fileno()).st_size
        count, rest = divmod(size, RECORD.itemsize)
        if rest:
            raise FormatError(
                "splat-size",
                f"{where}: {size} bytes of {describe(file.read(64))}, expected a multiple of "
                f"{RECORD.itemsize}",
            )
        (limits or Limits()).require_scene(count, sh_degree=0, source_bytes=size, where=where)
        splats = empty(0, count)
        buffer = np.empty(min(count, _BLOCK_ROWS), RECORD)
        for start in range(0, count, _BLOCK_ROWS):
            block = buffer[: min(_BLOCK_ROWS, count - start)]
            if file.readinto(block.view(np.uint8).data) != block.nbytes:
                raise StorageError(
                    "file-changed",
                    f"{where}: ended before its {size} bytes, expected a file at rest",
                )
            rows = slice(start, start + len(block))
            splats.means[rows] = block["means"]
            splats.scales[rows] = log_scales(block["scales"], _ZERO_LOG_SCALE)
            splats.sh0[rows] = COLOUR_BYTES[block["rgba"][:, :3]]
            splats.opacities[rows] = BYTE_LOGITS[block["rgba"][:, 3]]
            splats.quats[rows] = _unpack_quats(block["quats"])
    return splats


def _unpack_quats(stored: U8) -> F32:
    """Unpack (n, 4) bytes, where 128 stands for 0, to unit wxyz quaternions."""
    quats = (stored.astype(np.float32) - np.float32(128)) / np.float32(128)
    # Four bytes of 128 are a zero quaternion: read it as the identity.
    quats[~quats.any(axis=1), 0] = 1
    return unit(quats)


def write_splat(splats: Splats, path: StrPath, *, force: bool = False) -> None:
    """Write a scene as .splat, atomically.

    Parameters
    ----------
    splats : Splats
        Scene in any axes, stored in RDF. Splats are sorted by descending product of standard
        deviations and opacity, as in antimatter15/splat, so that large opaque splats come first.
    path : path
        The output.
    force : bool
        Whether an existing file may be replaced.

    Raises
    ------
    DataError
        ``invalid-rows``: a row cannot be rendered; ``bad-scene-info``: the axes are invalid.
    StorageError
        See `atomic_write`, e.g. ``exists``.

    Warns
    -----
    CogsplatWarning
        The scene has values that .splat cannot hold: SH above degree 0, an origin, a colour space,
        anti-aliasing, extras.

    Notes
    -----
    Quantisation steps are 1/255 for colours and opacities, which are clipped to 0 to 1, and 1/128
    for the components of quaternions.
    """
    stored = convert_axes(splats.with_sh_degree(0).require_valid(), _AXES)
    # Logarithms, because the product of standard deviations may overflow.
    volumes = stored.scales.astype(np.float64).sum(axis=1)
    with np.errstate(divide="ignore"):
        order = np.argsort(-(volumes + np.log(unit_opacities(stored.opacities))), kind="stable")
    with atomic_write(path, force) as file:
        for start in range(0, len(stored), _BLOCK_ROWS):
            rows = order[start : start + _BLOCK_ROWS]
            block = np.empty(len(rows), RECORD)
            block["means"] = stored.means[rows]
            with np.errstate(over="ignore"):
                block["scales"] = np.exp(stored.scales[rows])
            block["rgba"][:, :3] = _to_byte((stored.sh0[rows].astype(np.float64) * C0 + 0.5) * 255)
            block["rgba"][:, 3] = opacity_bytes(stored.opacities[rows])
            block["quats"] = _to_byte(unit(stored.quats[rows]).astype(np.float64) * 128 + 128)
            file.write(block.view(np.uint8).data)
    dropped = dropped_info(splats.info) + dropped_extras(splats)
    if splats.sh_degree:
        dropped.insert(0, f"SH of degree {splats.sh_degree}")
    warn_dropped(path, ".splat", dropped)


def _to_byte(values: NDArray[np.float64]) -> U8:
    """Round values to bytes, clipped to 0 to 255."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
