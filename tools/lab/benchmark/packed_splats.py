"""Decoder of the packed splats that Spark and the npm package ``cogsplat`` upload to the GPU."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry.sh import C0, COLOUR_OFFSET
from cogsplat.codec.splats import SceneInfo, Splats

U32 = NDArray[np.uint32]
F32 = NDArray[np.float32]

# Words per splat, bits per value and values per splat of each band, as in
# tools/web/src/scene/packed_splats.ts.
_BANDS: Final = ((2, 7, 9), (4, 8, 15), (4, 6, 21))
_LOG_SCALE_MIN: Final = -12.0
_LOG_SCALE_STEP: Final = 21.0 / 254.0
# Log scale of code 0, which Spark treats as a scale of 0.
_LOG_SCALE_ZERO: Final = -30.0


def unpack(
    words: U32,
    bands: Sequence[U32],
    colours: tuple[float, float],
    sh_max: Sequence[float],
    info: SceneInfo,
) -> Splats:
    """Decode packed splats; fully transparent splats are dropped.

    Parameters
    ----------
    words : (N, 4) uint32
        Packed words (``PackedSplats`` of tools/web/src/scene/packed_splats.ts).
    bands : sequence of (N, 2), (N, 4), (N, 4) uint32
        Packed SH bands 1, 2 and 3; higher bands may be absent.
    colours : tuple of float
        DC colours of codes 0 and 255.
    sh_max : sequence of float
        SH coefficient of the largest code, per band.
    info : SceneInfo
        Frame of the means.

    Returns
    -------
    Splats
    """
    shown = words[:, 0] >> 24 > 0
    words = words[shown]
    octets = words.view(np.uint8).reshape(-1, 16)
    halves = words.view(np.float16).reshape(-1, 8)
    alpha = octets[:, 3].astype(np.float32) / 255.0
    with np.errstate(divide="ignore"):
        opacities = np.log(alpha / (1.0 - alpha))
    colour = octets[:, :3].astype(np.float32) / 255.0 * (colours[1] - colours[0]) + colours[0]
    codes = octets[:, 12:15].astype(np.float32)
    scales = np.where(codes > 0, _LOG_SCALE_MIN + (codes - 1.0) * _LOG_SCALE_STEP, _LOG_SCALE_ZERO)
    coefficients = [
        _band(band[shown], bits, values) * (largest / (2 ** (bits - 1) - 1))
        for band, (_, bits, values), largest in zip(bands, _BANDS, sh_max, strict=False)
    ]
    sh = np.concatenate(coefficients, 1) if coefficients else np.zeros((len(words), 0), np.float32)
    return Splats.from_arrays(
        means=halves[:, 2:5].astype(np.float32),
        scales=scales,
        quats=_rotations(octets[:, 10], octets[:, 11], octets[:, 15]),
        opacities=opacities,
        sh0=(colour - COLOUR_OFFSET) / C0,
        shN=sh.reshape(len(words), -1, 3),
        info=info,
    )


def words_of_band(degree: int) -> int:
    """Return the number of 32-bit words of one splat in the packed SH band of a degree."""
    return _BANDS[degree - 1][0]


def _band(words: U32, bits: int, values: int) -> F32:
    """Unpack the coefficients of one SH band to (N, values) integers, as float32.

    Parameters
    ----------
    words : (N, W) uint32
        Packed words of each splat.
    bits : int
        Bits per coefficient, in two's complement; coefficients follow each other from bit 0 on.
    values : int
        Number of coefficients per splat.
    """
    flat = np.unpackbits(words.view(np.uint8), axis=1, bitorder="little")[:, : bits * values]
    digits = flat.reshape(-1, values, bits).astype(np.int32)
    unsigned = digits @ (1 << np.arange(bits, dtype=np.int32))
    return np.where(unsigned >= 1 << (bits - 1), unsigned - (1 << bits), unsigned).astype(
        np.float32
    )


def _rotations(u: NDArray[np.uint8], v: NDArray[np.uint8], angle: NDArray[np.uint8]) -> F32:
    """Decode wxyz quaternions from an octahedral axis and an angle in units of π/255."""
    x, y = (code.astype(np.float32) / 127.5 - 1.0 for code in (u, v))
    z = 1.0 - np.abs(x) - np.abs(y)
    fold = np.maximum(-z, 0.0)
    axis = np.stack([x - np.copysign(fold, x), y - np.copysign(fold, y), z], 1)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    half = angle.astype(np.float32) * (np.pi / 510.0)
    quats = np.concatenate([np.cos(half)[:, None], np.sin(half)[:, None] * axis], 1)
    return quats.astype(np.float32)
