"""Swing-twist streams: rotations as swing of the long axis and twist about it (SPEC 6.11)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError
from cogsplat.codec.geometry import rotations

from . import adaptive_step as step_models
from . import bit_fields
from .adaptive_step import MAX_EXTRA_BITS, MODEL_BYTES, StepModel
from .records import Attribute, Kind, StoredStream, Stream
from .stream_inputs import Inputs

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]

SYMBOL_BITS: Final = 6
"""High bits of a code that are stored as a symbol; lower bits are packed (SPEC 6.11)."""

COMPONENT_PLANES: Final = SYMBOL_BITS + 1
"""Planes of a component: one of symbols for each number of extra bits, and one of low bits."""

BASE_STEP: Final = 2.0
"""Quantiser step of a component without extra bits; values lie in ±1."""

STEPS: Final = np.ldexp(np.float32(BASE_STEP), -np.arange(MAX_EXTRA_BITS + 1)).astype(np.float32)
"""Quantiser step for each number of extra bits."""


def decompose(quats: F32, scales: F32) -> tuple[F64, F32]:
    """Decompose rotations into a swing of the longest axis and a twist about it.

    The axes of each splat are first sorted: x the middle one, y the thinnest, z the longest.
    Permuting or reversing axes does not change a Gaussian.

    Parameters
    ----------
    quats : (n, 4) float32
        Unit, wxyz.
    scales : (n, 3) float32
        Log scales.

    Returns
    -------
    components : (n, 3) float64
        Swing (a, b) and twist c: the quaternion is (1, a, b, 0)·(1, 0, 0, c), normalised; a² + b²
        and |c| are at most 1.
    scales : (n, 3) float32
        Log scales in the order middle, thin, long.
    """
    order = np.argsort(scales, axis=1, kind="stable")[:, [1, 0, 2]]
    permuted = np.take_along_axis(scales, order, axis=1)
    axes = np.take_along_axis(rotations.matrices(quats), order[:, None, :], axis=2)
    # An odd permutation mirrors; reversing one axis makes it a rotation again.
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    # The long axis must point up to swing by at most 90°; the middle axis is reversed with it.
    down = axes[:, 2, 2] < 0
    axes[down, :, 2] *= -1
    axes[down, :, 0] *= -1
    quat = rotations.from_matrices(axes)
    # A twist by 180° leaves the Gaussian unchanged: (w, z) becomes (-z, w).
    far = np.abs(quat[:, 3]) > np.abs(quat[:, 0])
    w, x, y, z = quat[far].T
    quat[far] = np.stack([-z, y, -x, w], axis=1)
    quat[quat[:, 0] < 0] *= -1
    w, x, y, z = quat.T
    c = z / w
    scale = 1 + c * c
    a = (x / w - c * y / w) / scale
    b = (y / w + c * x / w) / scale
    return np.stack([a, b, c], axis=1), np.ascontiguousarray(permuted)


def compose(components: F32) -> F32:
    """Return the (n, 4) unit quaternions of (n, 3) float32 swings and twists (SPEC 6.11)."""
    a, b, c = components.T
    out = np.empty((len(components), 4), np.float32)
    out[:, 0] = 1
    out[:, 1] = a + b * c
    out[:, 2] = b - a * c
    out[:, 3] = c
    w, x, y, z = out.T
    norm = np.sqrt(((w * w + x * x) + y * y) + z * z)
    out /= norm[:, None]
    return out


def quantise(values: F64, extra_bits: U8) -> U32:
    """Return the codes of (n,) values in ±1; a row with h > 0 extra bits has 2^h + 1 levels."""
    half = np.ldexp(0.5, extra_bits.astype(np.int32))
    codes = np.rint((values + 1) * half)
    codes = np.clip(codes, 0, 2 * half)
    return np.where(extra_bits > 0, codes, 0).astype(np.uint32)


def dequantise(codes: U32, extra_bits: U8) -> F32:
    """Return ``code · 2^(1 - h) - 1`` in float32 for rows with h > 0 extra bits, else 0."""
    values = codes.astype(np.float32) * STEPS[extra_bits] - np.float32(1)
    return np.where(extra_bits > 0, values, np.float32(0))


def write(components: F64, scales: F32, swing: StepModel, twist: StepModel) -> Stream:
    """Return a swing_twist stream.

    Parameters
    ----------
    components : (n, 3) float64
        Swing and twist from `decompose`.
    scales : (n, 3) float32
        Decoded log scales of the head: middle, thin, long.
    swing, twist : StepModel
        Step models of the swing (a, b) and of the twist c.
    """
    planes: list[U8] = []
    for column, extra_bits in enumerate(extra_bits_of(scales, swing, twist)):
        planes += split_component(quantise(components[:, column], extra_bits), extra_bits)
    params = swing.pack() + twist.pack()
    return Stream(Attribute.QUATS, Kind.SWING_TWIST, len(components), params, planes)


def extra_bits_of(scales: F32, swing: StepModel, twist: StepModel) -> list[U8]:
    """Return the extra bits of the swings a and b and of the twist c, (n,) each (SPEC 6.10)."""
    swings = swing.extra_bits(scales)
    return [swings, swings, twist.extra_bits(scales)]


def split_component(codes: U32, extra_bits: U8) -> list[U8]:
    """Split the codes of one component into planes.

    A row with h extra bits has a code from 0 to 2^h. If h exceeds `SYMBOL_BITS`, the lowest
    h - `SYMBOL_BITS` bits of the code are packed; the rest of the code is its symbol.

    Parameters
    ----------
    codes : (n,) uint32
        Codes of one component.
    extra_bits : (n,) uint8
        Number of extra bits of each row (SPEC 6.10).

    Returns
    -------
    list of uint8 arrays
        One plane of symbols for each number of extra bits from 1 to `SYMBOL_BITS`, the last one
        also for rows with more; then the plane of low bits.
    """
    capped = np.minimum(extra_bits, SYMBOL_BITS)
    low = extra_bits - capped
    symbols = (codes >> low).astype(np.uint8)
    planes = [symbols[capped == m] for m in range(1, SYMBOL_BITS + 1)]
    return [*planes, bit_fields.pack(codes.astype(np.uint64), low)]


def parse(stream: StoredStream) -> tuple[StepModel, StepModel]:
    """Return the step models of swing and twist; the number of planes is checked.

    Raises
    ------
    FormatError
        ``stream-params``, ``step-model``, ``stream-planes``.
    """
    params = stream.require_params(2 * MODEL_BYTES)
    swing = step_models.unpack(params[:MODEL_BYTES], stream.where)
    twist = step_models.unpack(params[MODEL_BYTES:], stream.where)
    stream.require_planes(3 * COMPONENT_PLANES)
    return swing, twist


def read(stream: StoredStream, out: F32, inputs: Inputs) -> None:
    """Decode a swing_twist stream to unit quaternions, into (rows, 4) float32 `out`.

    Needs `inputs.scales`.

    Raises
    ------
    FormatError
        Codes of `parse`; ``bits-padding``; ``code-range``: a code beyond the levels of its row.
    ValueError
        The inputs have no scales.
    """
    swing, twist = parse(stream)
    columns = extra_bits_of(step_models.require_scales(inputs), swing, twist)
    components = np.empty((stream.rows, 3), np.float32)
    for column, extra_bits in enumerate(columns):
        codes = _read_codes(stream, column * COMPONENT_PLANES, extra_bits)
        if bool((codes > np.left_shift(np.uint32(1), extra_bits.astype(np.uint32))).any()):
            raise FormatError(
                "code-range",
                f"{stream.where}: a code beyond the levels of its row in component {column}",
                clause="6.11",
            )
        components[:, column] = dequantise(codes, extra_bits)
    out[:] = compose(components)


def _read_codes(stream: StoredStream, first: int, extra_bits: U8) -> U32:
    """Return the (rows,) codes of one component.

    Parameters
    ----------
    stream : StoredStream
        Swing_twist stream.
    first : int
        Number of the component's first plane in the stream.
    extra_bits : (rows,) uint8
        Number of extra bits of each row.
    """
    capped = np.minimum(extra_bits, SYMBOL_BITS)
    counts = np.bincount(capped, minlength=SYMBOL_BITS + 1).tolist()
    symbols = [stream.plane(first + m - 1, counts[m]) for m in range(1, SYMBOL_BITS + 1)]
    codes = np.zeros(len(extra_bits), np.uint32)
    # Rows by number of extra bits, in stored order within a number; rows without bits come first.
    order = np.argsort(capped, kind="stable")
    codes[order[counts[0] :]] = np.concatenate(symbols)
    low = extra_bits - capped
    plane = stream.plane(first + SYMBOL_BITS, bit_fields.packed_bytes(low))
    return (codes << low) | bit_fields.unpack(plane, low, stream.where).astype(np.uint32)
