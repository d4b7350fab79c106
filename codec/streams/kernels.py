"""Compiled decoding: the reader of each stream kind that has one, with the bits of numpy's.

A reader returns False where something in the file is wrong, and the reader in numpy then
raises the error. Importing this module takes numba.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from . import (
    kernels_chunk,
    kernels_grid,
    kernels_shn_transform,
    kernels_sorted_means,
    kernels_swing_twist,
)
from .compiled import CompiledReader
from .records import SH_BANDS, Attribute, Kind

READERS: Final[Mapping[tuple[Attribute, Kind], CompiledReader]] = {
    (Attribute.MEANS, Kind.SCALAR): kernels_grid.read_scalar,
    (Attribute.MEANS, Kind.SORTED): kernels_sorted_means.read,
    (Attribute.OPACITIES, Kind.SCALAR): kernels_grid.read_scalar,
    (Attribute.SH0, Kind.SCALAR): kernels_grid.read_scalar,
    (Attribute.SH0, Kind.BASIS): kernels_grid.read_sh0,
    (Attribute.SCALES, Kind.SCALAR): kernels_grid.read_scalar,
    (Attribute.SCALES, Kind.DIFFERENCES): kernels_grid.read_differences,
    (Attribute.QUATS, Kind.QUAT): kernels_grid.read_quats,
    (Attribute.QUATS, Kind.SWING_TWIST): kernels_swing_twist.read,
    (Attribute.SCALE_FACTOR, Kind.SCALAR): kernels_grid.read_scalar,
    (Attribute.SHN, Kind.BASIS): kernels_shn_transform.read,
    **{(band, Kind.SCALAR): kernels_grid.read_scalar for band in SH_BANDS},
}

read_chunk: Final = kernels_chunk.read
"""Reads all streams of a chunk together."""
