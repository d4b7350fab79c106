"""Quantisation of scenes to SPZ's streams, and dequantisation.

Steps and ranges follow the format's public description (github.com/nianticlabs/spz): 24-bit
fixed-point positions, 8-bit log scales, 8-bit colours, alphas and SH coefficients, and quaternions
by their first or smallest three components.
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

# Rows per step of a conversion, so that its temporary arrays stay in the processor's cache.
_BLOCK_ROWS: Final = 1 << 15

# Scale of sh0 in colour bytes, 0.15 × sh0 + 0.5; their range exceeds that of displayed colours.
_COLOUR_SCALE: Final = 0.15

# Log scales are bytes in steps of 1/16 from -10.
_SCALE_STEPS: Final = 16.0
_SCALE_OFFSET: Final = 10.0

_MAX_POSITION: Final = (1 << 23) - 1

# The reference writer's value: a step of 0.24 mm in a scene in metres.
_DEFAULT_FRACTIONAL_BITS: Final = 12

PRECISIONS: Final = ("fine", "usual")
"""Steps of centres: finer ones for small scenes, or the reference writer's for all scenes."""

# With "fine", the extent of the central 98 % of the means gets at least this number of steps.
_MIN_STEPS: Final = 1 << 13
_CENTRAL_FRACTION: Final = 0.98

# Smallest three components: nine bits and a sign for values up to sqrt(1/2).
_SMALLEST_STEPS: Final = 511
_SMALLEST_MAX: Final = math.sqrt(0.5)

# Lookup tables from stored codes to values.
_BYTE: Final = np.arange(256)
_TEN_BITS: Final = np.arange(1024)

_SH0: Final = ((_BYTE / 255 - 0.5) / _COLOUR_SCALE).astype(np.float32)
_SCALES: Final = (_BYTE / _SCALE_STEPS - _SCALE_OFFSET).astype(np.float32)
_FIRST: Final = (_BYTE / 127.5 - 1).astype(np.float32)
_SMALLEST: Final = (
    np.where(_TEN_BITS < 512, 1, -1) * (_TEN_BITS & 511) * (_SMALLEST_MAX / _SMALLEST_STEPS)
).astype(np.float32)


def dequantise(spz: SpzFile, change: AxesChange, info: SceneInfo) -> Splats:
    """Dequantise the streams of a file.

    Parameters
    ----------
    spz : SpzFile
        File with SH of any degree; degree 4 is cut to 3.
    change : AxesChange
        Axis flips to apply during dequantisation, at no cost.
    info : SceneInfo
        Metadata of the returned scene.

    Returns
    -------
    Splats
        The scene; equal for any number of threads.
    """
    count = spz.header.count
    degree = min(spz.header.sh_degree, MAX_SH_DEGREE)
    # Every row is filled below.
    splats = empty(degree, count, info)
    signs = np.array(change.signs, np.float32)
    quat_signs = np.array(change.quat_signs, np.float32)
    sh_steps = np.repeat(change.sh_signs(degree), 3) / np.float32(128)

    def convert(start: int) -> None:
        rows = slice(start, min(start + _BLOCK_ROWS, count))
        positions, alphas, colors, scales, rotations, sh = (s[rows] for s in spz.streams)
        if spz.header.version == 1:
            # Rows with NaN are kept, without warnings.
            with np.errstate(invalid="ignore"):
                splats.means[rows] = positions.view("<f2")
                splats.means[rows] *= signs
        else:
            _unpack_fixed_point(positions, signs, spz.header.fractional_bits, splats.means[rows])
        _look_up(BYTE_LOGITS, alphas[:, 0], splats.opacities[rows])
        _look_up(_SH0, colors, splats.sh0[rows])
        _look_up(_SCALES, scales, splats.scales[rows])
        if spz.header.version >= 3:
            _unpack_smallest_three(rotations, quat_signs, splats.quats[rows])
        else:
            _unpack_first_three(rotations, quat_signs, splats.quats[rows])
        if degree:
            values = splats.shN[rows].reshape(len(sh), -1)
            # Flipping the top bit of a byte subtracts 128 in two's complement, exactly.
            values[...] = (sh[:, : values.shape[1]] ^ np.uint8(128)).view(np.int8)
            values *= sh_steps

    for _ in ordered_map(convert, range(0, count, _BLOCK_ROWS), thread_count(0)):
        pass
    return splats


def _look_up(table: F32, index: U8, out: F32) -> None:
    """Write the values of a lookup table at byte indices to `out`."""
    # "clip" lets numpy write to `out` directly; no byte is outside a table of 256.
    np.take(table, index, out=out, mode="clip")


def _unpack_fixed_point(positions: U8, signs: F32, fractional_bits: int, out: F32) -> None:
    """Write 24-bit fixed-point positions, times `signs`, to `out`, (n, 3)."""
    wide = np.zeros((*out.shape, 4), np.uint8)
    wide[..., 1:] = positions.reshape(*out.shape, 3)
    fixed = wide.view("<i4")[..., 0]
    # The 24 bits are in the upper bytes of an int32, which keeps the sign and adds 8 fractional
    # bits. 24 bits are exact in float32.
    np.multiply(fixed, signs * np.float32(2.0 ** -(fractional_bits + 8)), out=out, casting="unsafe")


def _unpack_first_three(rotations: U8, signs: F32, out: F32) -> None:
    """Write quaternions stored as x, y, z to `out`, (n, 4) wxyz, with x, y, z times `signs`."""
    xyz = _FIRST[rotations]
    rest = np.float32(1) - np.square(xyz).sum(axis=1)
    np.sqrt(np.maximum(rest, 0), out=out[:, 0])
    np.multiply(xyz, signs, out=out[:, 1:])


def _unpack_smallest_three(rotations: U8, signs: F32, out: F32) -> None:
    """Write smallest-three quaternions to `out`, (n, 4) wxyz, with x, y, z times `signs`."""
    packed = rotations.view("<u4")[:, 0]
    largest = packed >> np.uint32(30)
    # The first stored component is in the highest bits.
    a, b, c = (_SMALLEST[(packed >> np.uint32(shift)) & np.uint32(1023)] for shift in (20, 10, 0))
    d = np.sqrt(np.maximum(np.float32(1) - (a * a + b * b + c * c), 0))
    x, y, z = signs
    np.multiply(np.where(largest == 0, d, a), x, out=out[:, 1])
    np.multiply(np.where(largest == 1, d, np.where(largest < 1, a, b)), y, out=out[:, 2])
    np.multiply(np.where(largest == 2, d, np.where(largest < 2, b, c)), z, out=out[:, 3])
    out[:, 0] = np.where(largest == 3, d, c)


def fractional_bits(means: F32, precision: str = "fine") -> int:
    """Return the number of fractional bits of 24-bit positions for a scene's extent.

    The default is 12. ``"fine"`` raises it until the central 98 % of the means span 8192 steps. Any
    precision lowers it until the farthest mean fits.

    Parameters
    ----------
    means : (N, 3) float32
        Centres, scene units.
    precision : str
        One of `PRECISIONS`.
    """
    bits = _DEFAULT_FRACTIONAL_BITS
    if not len(means):
        return bits
    ends = [(1 - _CENTRAL_FRACTION) / 2, (1 + _CENTRAL_FRACTION) / 2]
    low, high = np.quantile(means, ends, axis=0)
    span = float((high - low).max())
    while precision == "fine" and 0 < span * 2.0**bits < _MIN_STEPS and bits < 24:
        bits += 1
    farthest = float(np.abs(means).max())
    while farthest * 2.0**bits > _MAX_POSITION and bits > 0:
        bits -= 1
    return bits


def quantise(
    splats: Splats, version: int, sh1_bits: int, sh_rest_bits: int, precision: str
) -> tuple[SpzHeader, list[U8], dict[str, float]]:
    """Quantise a scene to SPZ's streams.

    Parameters
    ----------
    splats : Splats
        Scene in the axes of the file, all rows valid.
    version : int
        Version of the file: 2 (coarser quaternions), 3 or 4 (equal values).
    sh1_bits, sh_rest_bits : int
        Bits kept of SH coefficients of degree 1, and of degrees above 1; 1 to 8.
    precision : str
        One of `PRECISIONS`.

    Returns
    -------
    header : SpzHeader
        Header of the file.
    streams : list of (N, row bytes) uint8
        Uncompressed streams, in the order of `STREAMS`.
    clipped : dict of str to float
        Fraction of clipped values, by attribute.
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
    # Round to the kept bits of a byte; zero stays exact.
    first = 3 * (sh_coefficients(1) - 1)
    flat = splats.shN.reshape(len(splats), 3 * splats.shN.shape[1])
    steps = np.full(flat.shape[1], 2.0 ** (8 - sh_rest_bits))
    steps[:first] = 2.0 ** (8 - sh1_bits)
    sh = np.rint(flat * (128 / steps)) * steps + 128
    # The top step, 1, would be 256: store 255, as the reference does.
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
    """Pack wxyz quaternions into four bytes: an index and three 10-bit components."""
    largest, others = to_smallest_three(quats)
    # From wxyz to xyzw: w moves to the end, unless it is the omitted component.
    three = np.where(largest[:, None] == 0, others, np.roll(others, -1, axis=1))
    index = ((largest + 3) % 4).astype(np.uint32)
    steps = np.rint(np.abs(three) * (_SMALLEST_STEPS / _SMALLEST_MAX)).astype(np.uint32)
    steps = np.minimum(steps, _SMALLEST_STEPS) | (np.signbit(three).astype(np.uint32) << 9)
    packed = index << 30 | steps[:, 0] << 20 | steps[:, 1] << 10 | steps[:, 2]
    stored: U8 = packed.astype("<u4").view(np.uint8).reshape(-1, 4)
    return stored


def _pack_first_three(quats: F32) -> U8:
    """Pack wxyz quaternions into three bytes: x, y and z."""
    wxyz = unit(quats)
    # Readers compute w as a square root, so flip the sign of quaternions with negative w.
    xyz = np.where(wxyz[:, :1] < 0, -wxyz[:, 1:], wxyz[:, 1:])
    stored: U8 = np.rint((xyz.astype(np.float64) + 1) * 127.5).astype(np.uint8)
    return stored
