"""SPZ's stored values as the arrays of a scene, and back.

Steps and ranges are those of the format's public description (github.com/nianticlabs/spz): 24-bit
fixed-point positions, 8-bit logarithmic scales, 8-bit colours, alphas and SH coefficients, and
quaternions by their first or smallest three components.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry.rotations import unit
from cogsplat.codec.geometry.transforms import AxesChange
from cogsplat.codec.splats import MAX_SH_DEGREE, SceneInfo, Splats, empty, sh_coefficients
from cogsplat.codec.threads import ordered_map, thread_count
from cogsplat.formats.scenes.quantised_values import BYTE_LOGITS, opacity_bytes, to_smallest_three

from .container import FLAG_ANTIALIASED, SpzFile, SpzHeader

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

# Rows that are converted while they are in a processor's cache.
_BLOCK_ROWS: Final = 1 << 15

# sh0 in 1 / 0.15 of the colour byte's range, wider than the range of colours.
_COLOUR_SCALE: Final = 0.15

# Scales are bytes of 1/16 from e^-10 up.
_SCALE_STEPS: Final = 16.0
_SCALE_OFFSET: Final = 10.0

_MAX_POSITION: Final = (1 << 23) - 1

_DEFAULT_FRACTIONAL_BITS: Final = 12
"""What the reference writes: a step of 0.24 mm in a scene in metres."""

PRECISIONS: Final = ("fine", "usual")
"""How finely centres are stored: small scenes in finer steps, or all in those of the reference."""

# With "fine", scenes smaller than two units get at least this many steps across most of the scene.
_MIN_STEPS: Final = 1 << 13
_MOST: Final = 0.98

# Smallest three: nine bits and a sign for values up to sqrt(1/2).
_SMALLEST_STEPS: Final = 511
_SMALLEST_MAX: Final = math.sqrt(0.5)


_BYTE: Final = np.arange(256)
_TEN_BITS: Final = np.arange(1024)

_SH0: Final = ((_BYTE / 255 - 0.5) / _COLOUR_SCALE).astype(np.float32)
_SCALES: Final = (_BYTE / _SCALE_STEPS - _SCALE_OFFSET).astype(np.float32)
_FIRST: Final = (_BYTE / 127.5 - 1).astype(np.float32)
_SMALLEST: Final = (
    np.where(_TEN_BITS < 512, 1, -1) * (_TEN_BITS & 511) * (_SMALLEST_MAX / _SMALLEST_STEPS)
).astype(np.float32)


def decode(spz: SpzFile, change: AxesChange, info: SceneInfo) -> Splats:
    """Return the scene in a file's streams.

    Parameters
    ----------
    spz : SpzFile
        With SH of any degree; what is above 3 is left out.
    change : AxesChange
        Flips to apply on the way, at no cost.
    info : SceneInfo
        What the scene says of itself after them.

    Returns
    -------
    Splats
        The same for any number of threads.
    """
    count = spz.header.count
    degree = min(spz.header.sh_degree, MAX_SH_DEGREE)
    # Every row is filled below: zeroed pages cost nothing until then.
    splats = empty(degree, count, info)
    signs = np.array(change.signs, np.float32)
    quat_signs = np.array(change.quat_signs, np.float32)
    sh_steps = np.repeat(change.sh_signs(degree), 3) / np.float32(128)

    def convert(start: int) -> None:
        rows = slice(start, min(start + _BLOCK_ROWS, count))
        positions, alphas, colors, scales, rotations, sh = (s[rows] for s in spz.streams)
        if spz.header.version == 1:
            # NaN of any kind passes through.
            with np.errstate(invalid="ignore"):
                splats.means[rows] = positions.view("<f2")
                splats.means[rows] *= signs
        else:
            _fixed_point(positions, signs, spz.header.fractional_bits, splats.means[rows])
        _look_up(BYTE_LOGITS, alphas[:, 0], splats.opacities[rows])
        _look_up(_SH0, colors, splats.sh0[rows])
        _look_up(_SCALES, scales, splats.scales[rows])
        if spz.header.version >= 3:
            _smallest_three(rotations, quat_signs, splats.quats[rows])
        else:
            _first_three(rotations, quat_signs, splats.quats[rows])
        if degree:
            values = splats.shN[rows].reshape(len(sh), -1)
            # x - 128 by turning over the top bit of a two's complement byte; exact.
            values[...] = (sh[:, : values.shape[1]] ^ np.uint8(128)).view(np.int8)
            values *= sh_steps

    for _ in ordered_map(convert, range(0, count, _BLOCK_ROWS), thread_count(0)):
        pass
    return splats


def _look_up(table: F32, index: U8, out: F32) -> None:
    # "clip" lets numpy write to `out` directly; bytes cannot leave a table of 256.
    np.take(table, index, out=out, mode="clip")


def _fixed_point(positions: U8, signs: F32, fractional_bits: int, out: F32) -> None:
    wide = np.zeros((*out.shape, 4), np.uint8)
    wide[..., 1:] = positions.reshape(*out.shape, 3)
    fixed = wide.view("<i4")[..., 0]
    # The low byte is zero, so the sign is in place and 8 fractional bits more are divided away;
    # 24 bits are exact in float32.
    np.multiply(fixed, signs * np.float32(2.0 ** -(fractional_bits + 8)), out=out, casting="unsafe")


def _first_three(rotations: U8, signs: F32, out: F32) -> None:
    xyz = _FIRST[rotations]
    rest = np.float32(1) - np.square(xyz).sum(axis=1)
    np.sqrt(np.maximum(rest, 0), out=out[:, 0])
    np.multiply(xyz, signs, out=out[:, 1:])


def _smallest_three(rotations: U8, signs: F32, out: F32) -> None:
    packed = rotations.view("<u4")[:, 0]
    largest = packed >> np.uint32(30)
    # The first of the three that are stored is in the highest bits.
    a, b, c = (_SMALLEST[(packed >> np.uint32(shift)) & np.uint32(1023)] for shift in (20, 10, 0))
    d = np.sqrt(np.maximum(np.float32(1) - (a * a + b * b + c * c), 0))
    x, y, z = signs
    np.multiply(np.where(largest == 0, d, a), x, out=out[:, 1])
    np.multiply(np.where(largest == 1, d, np.where(largest < 1, a, b)), y, out=out[:, 2])
    np.multiply(np.where(largest == 2, d, np.where(largest < 2, b, c)), z, out=out[:, 3])
    out[:, 0] = np.where(largest == 3, d, c)


def fractional_bits(means: F32, precision: str = "fine") -> int:
    """Return how many bits of 24-bit positions go behind the point for a scene's extent.

    12, as everybody writes; with the precision ``"fine"`` more where most of the scene would span
    fewer than 8192 steps; with either fewer where the farthest mean would not fit.

    Parameters
    ----------
    means : (N, 3) float32
        Scene units.
    precision : str
        One of `PRECISIONS`.
    """
    bits = _DEFAULT_FRACTIONAL_BITS
    if not len(means):
        return bits
    low, high = np.quantile(means, [(1 - _MOST) / 2, (1 + _MOST) / 2], axis=0)
    span = float((high - low).max())
    while precision == "fine" and 0 < span * 2.0**bits < _MIN_STEPS and bits < 24:
        bits += 1
    farthest = float(np.abs(means).max())
    while farthest * 2.0**bits > _MAX_POSITION and bits > 0:
        bits -= 1
    return bits


def encode(
    splats: Splats, version: int, sh1_bits: int, sh_rest_bits: int, precision: str
) -> tuple[SpzHeader, list[U8], dict[str, float]]:
    """Quantise a scene to SPZ's streams.

    Parameters
    ----------
    splats : Splats
        In the frame of the file, all rows valid.
    version : int
        2, whose quaternions are coarser; 3 or 4, whose values are the same.
    sh1_bits, sh_rest_bits : int
        Bits that SH coefficients of degree 1 and above keep, 1 to 8.
    precision : str
        One of `PRECISIONS`.

    Returns
    -------
    header : SpzHeader
    streams : list of (N, row bytes) uint8
    clipped : dict of str to float
        Shares of values that lie outside what the format holds, by attribute.
    """
    clipped: dict[str, float] = {}

    def to_byte(name: str, values: F64) -> U8:
        rounded = np.rint(values)
        outside = np.count_nonzero((rounded < 0) | (rounded > 255))
        clipped[name] = outside / max(1, values.size)
        return np.clip(rounded, 0, 255).astype(np.uint8)

    bits = fractional_bits(splats.means, precision)
    fixed = np.rint(splats.means.astype(np.float64) * 2.0**bits)
    far = np.abs(fixed) > _MAX_POSITION
    clipped["means"] = np.count_nonzero(far) / max(1, fixed.size)
    fixed = np.clip(fixed, -_MAX_POSITION, _MAX_POSITION).astype("<i4")
    positions = fixed.view(np.uint8).reshape(-1, 3, 4)[:, :, :3].reshape(-1, 9)
    scales = (splats.scales.astype(np.float64) + _SCALE_OFFSET) * _SCALE_STEPS
    sh0 = (splats.sh0.astype(np.float64) * _COLOUR_SCALE + 0.5) * 255
    # Rounded to what `sh1_bits` and `sh_rest_bits` keep of a byte, with zero as one of the steps.
    first = 3 * (sh_coefficients(1) - 1)
    flat = splats.shN.reshape(len(splats), 3 * splats.shN.shape[1])
    steps = np.full(flat.shape[1], 2.0 ** (8 - sh_rest_bits))
    steps[:first] = 2.0 ** (8 - sh1_bits)
    sh = np.rint(flat * (128 / steps)) * steps + 128
    # The top step is 1, one beyond the byte: 255 stands for it, as in the reference.
    sh[sh == 256] = 255
    streams = [
        np.ascontiguousarray(positions),
        opacity_bytes(splats.opacities)[:, None],
        to_byte("sh0", sh0),
        to_byte("scales", scales),
        (_pack_smallest_three if version >= 3 else _pack_first_three)(splats.quats),
        to_byte("shN", sh),
    ]
    header = SpzHeader(
        version=version,
        count=len(splats),
        sh_degree=splats.sh_degree,
        fractional_bits=bits,
        flags=FLAG_ANTIALIASED if splats.info.antialiased else 0,
    )
    return header, streams, clipped


def _pack_smallest_three(quats: F32) -> U8:
    largest, others = to_smallest_three(quats)
    # From wxyz to xyzw: w goes behind, or is the one that is not there.
    three = np.where(largest[:, None] == 0, others, np.roll(others, -1, axis=1))
    index = ((largest + 3) % 4).astype(np.uint32)
    steps = np.rint(np.abs(three) * (_SMALLEST_STEPS / _SMALLEST_MAX)).astype(np.uint32)
    steps = np.minimum(steps, _SMALLEST_STEPS) | (np.signbit(three).astype(np.uint32) << 9)
    packed = index << 30 | steps[:, 0] << 20 | steps[:, 1] << 10 | steps[:, 2]
    stored: U8 = packed.astype("<u4").view(np.uint8).reshape(-1, 4)
    return stored


def _pack_first_three(quats: F32) -> U8:
    wxyz = unit(quats)
    # The component that is not stored, w, is read as a root: 0 or more.
    xyz = np.where(wxyz[:, :1] < 0, -wxyz[:, 1:], wxyz[:, 1:])
    stored: U8 = np.rint((xyz.astype(np.float64) + 1) * 127.5).astype(np.uint8)
    return stored
