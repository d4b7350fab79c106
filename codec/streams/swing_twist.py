"""Swing-twist streams: a swing of the longest axis and a twist about it (SPEC 6.11)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError
from cogsplat.codec.geometry import rotations

from . import adaptive_step as step_models
from . import bit_fields, refinement_bits, sorted_means
from .adaptive_step import MAX_EXTRA_BITS, MODEL_BYTES, StepModel
from .inputs import Inputs
from .records import Attribute, Kind, StoredStream, Stream
from .refinement_bits import Finer

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]

SWINGS: Final = 2

SYMBOL_BITS: Final = 6
"""Halvings up to here are coded as symbols; what is finer are plain bits (SPEC 6.11)."""


STEPS: Final = np.ldexp(np.float32(2), -np.arange(MAX_EXTRA_BITS + 1)).astype(np.float32)
"""What a code is worth after each number of extra_bits, float32."""


def turns(values: F64, scales: F32, tilt: StepModel, spin: StepModel) -> tuple[Stream, F32]:
    """Return a turn stream and the turns it decodes to.

    Parameters
    ----------
    values : (n, 3) float64
        Tilt (a, b) and spin c of `canonical`.
    scales : (n, 3) float32
        As decoded: middle, thin, long.
    tilt, spin : StepModel
        Halvings of the tilts' and the spin's step of 2.
    """
    planes: list[U8] = []
    decoded = np.empty(values.shape, np.float32)
    for column, extra_bits in enumerate(_columns(scales, tilt, spin)):
        codes = quantise(values[:, column], extra_bits)
        symbols, rest = split(codes, extra_bits)
        planes += [*symbols, rest]
        decoded[:, column] = dequantise(codes, extra_bits)
    params = tilt.pack() + spin.pack()
    return Stream(Attribute.QUATS, Kind.SWING_TWIST, len(values), params, planes), decoded


def refined_turns(
    values: F64, scales: F32, tilt: StepModel, spin: StepModel, fine: F32, constants: list[float]
) -> tuple[Stream, Stream, F32]:
    """Return a coarse turn stream, what refines it, and the turns of the first alone.

    Parameters
    ----------
    values, scales, tilt, spin
        As `turns` takes them, of the head alone.
    fine : (n, 3) float32
        The scales, refined.
    constants : list of float
        First coefficients of the finer tilt and spin.
    """
    planes: list[U8] = []
    columns = _columns(scales, tilt, spin)
    finer = [
        refinement_bits.with_constant(one, constant)
        for one, constant in zip((tilt, spin), constants, strict=True)
    ]
    tilts, spins = (
        refinement_bits.gained(one, fine, extra_bits)
        for one, extra_bits in zip(finer, (columns[0], columns[2]), strict=True)
    )
    fields = np.zeros(len(values), np.uint64)
    widths = np.zeros(len(values), np.uint8)
    below: list[U8] = []
    decoded = np.empty(values.shape, np.float32)
    for column, (extra_bits, extra) in enumerate(zip(columns, (tilts, tilts, spins), strict=True)):
        codes = quantise(values[:, column], extra_bits + extra)
        alone, more = _apart(extra_bits, extra)
        symbols, rest = split(np.where(extra_bits == 0, codes, 0), alone)
        below += [*symbols, rest]
        coarse, field = refinement_bits.coarse_of(codes, more)
        coarse = np.where(extra_bits == 0, np.uint32(0), coarse)
        decoded[:, column] = dequantise(coarse, extra_bits)
        symbols, rest = split(coarse, extra_bits)
        planes += [*symbols, rest]
        fields |= np.where(extra_bits == 0, np.uint64(0), field) << widths.astype(np.uint64)
        widths += more
    below.append(bit_fields.pack(fields, widths))
    params = tilt.pack() + spin.pack()
    head = Stream(Attribute.QUATS, Kind.SWING_TWIST, len(values), params, planes)
    refined = refinement_bits.bits_stream(Attribute.QUATS, constants, below, len(values))
    return head, refined, decoded


def _apart(extra_bits: U8, extra: U8) -> tuple[U8, U8]:
    """Return what a refinement adds to rows without extra_bits, and to the others."""
    none = extra_bits == 0
    zero = np.uint8(0)
    return np.where(none, extra, zero), np.where(none, zero, extra)


def parse(stream: StoredStream) -> tuple[StepModel, StepModel]:
    """Return the step models of swing and twist."""
    params = stream.require_params(2 * MODEL_BYTES)
    swing = step_models.unpack(params[:MODEL_BYTES], stream.where)
    return swing, step_models.unpack(params[MODEL_BYTES:], stream.where)


def read(stream: StoredStream, out: F32, inputs: Inputs) -> None:
    """Write the quaternions of a swing_twist stream into (rows, 4) float32 `out`."""
    tilt, spin = parse(stream)
    finer = sorted_means.finer_of(inputs)
    columns = _columns(sorted_means.scales_of(inputs), tilt, spin)
    values = np.empty((stream.rows, 3), np.float32)
    plane = 0
    counts = [group_rows(extra_bits) for extra_bits in columns]
    wanted = sum(len(rows) + 1 for rows in counts)
    if len(stream.words) != wanted:
        raise FormatError(
            "stream-planes",
            f"{stream.where}: {len(stream.words)} planes, expected {wanted}",
            clause="6.11",
        )
    codes: list[U32] = []
    for column, extra_bits in enumerate(columns):
        found, plane = _column(stream, plane, extra_bits, counts[column])
        if bool((found > np.left_shift(np.uint32(1), extra_bits.astype(np.uint32))).any()):
            raise FormatError(
                "code-range",
                f"{stream.where}: a code beyond the levels of its row in component {column}",
                clause="6.11",
            )
        codes.append(found)
    if finer is not None:
        codes, columns = _refined(codes, columns, (tilt, spin), finer)
    for column, extra_bits in enumerate(columns):
        values[:, column] = dequantise(codes[column], extra_bits)
    out[:] = quats_of(values)


def _column(stream: StoredStream, plane: int, extra_bits: U8, counts: list[int]) -> tuple[U32, int]:
    """Return the codes of a component and the number of the plane behind it."""
    symbols = [stream.plane(plane + index, rows) for index, rows in enumerate(counts)]
    plane += len(counts)
    rest = stream.plane(plane, rest_bytes(extra_bits))
    return join(symbols, rest, extra_bits, stream.where), plane + 1


def _refined(
    codes: list[U32], columns: list[U8], coarse: tuple[StepModel, StepModel], finer: Finer
) -> tuple[list[U32], list[U8]]:
    """Return codes and extra_bits with those of a refinement (SPEC 6.17)."""
    tilts, spins = finer.extra(coarse, (columns[0], columns[2]))
    extra = [tilts, tilts, spins]
    parts = [_apart(extra_bits, more) for extra_bits, more in zip(columns, extra, strict=True)]
    counts = [group_rows(alone) for alone, _ in parts]
    finer.stream.require_planes(sum(len(rows) + 1 for rows in counts) + 1)
    out: list[U32] = []
    plane = 0
    for index, (alone, _) in enumerate(parts):
        found, plane = _column(finer.stream, plane, alone, counts[index])
        out.append(found)
    widths = parts[0][1] + parts[1][1] + parts[2][1]
    fields = finer.fields(plane, widths)
    for index, (extra_bits, (_, more)) in enumerate(zip(columns, parts, strict=True)):
        below = fields & ((np.uint64(1) << more.astype(np.uint64)) - np.uint64(1))
        fields >>= more.astype(np.uint64)
        wide = codes[index].astype(np.int64) << more.astype(np.int64)
        wide += below.astype(np.int64) - refinement_bits.half_of(more)
        wide = np.where(extra_bits == 0, out[index].astype(np.int64), wide)
        top = np.int64(1) << (extra_bits + extra[index]).astype(np.int64)
        if bool(((wide < 0) | (wide > top)).any()):
            raise finer.refuse()
        out[index] = wide.astype(np.uint32)
    return out, [extra_bits + more for extra_bits, more in zip(columns, extra, strict=True)]


def _columns(scales: F32, tilt: StepModel, spin: StepModel) -> list[U8]:
    tilts = tilt.extra_bits(scales)
    return [tilts] * SWINGS + [spin.extra_bits(scales)]


def canonical(quats: F32, scales: F32) -> tuple[F64, F32]:
    """Rename axes to (middle, thin, long), tilted by at most 90° and spun by at most 90°.

    Parameters
    ----------
    quats : (n, 4) float32
        Unit, wxyz.
    scales : (n, 3) float32
        Log.

    Returns
    -------
    turns : (n, 3) float64
        Tilt (a, b) and spin c: the quaternion is (1, a, b, 0)·(1, 0, 0, c), normalised; a² + b²
        and |c| are at most 1.
    scales : (n, 3) float32
        Permuted: middle, thin, long.
    """
    order = np.argsort(scales, axis=1, kind="stable")[:, [1, 0, 2]]
    permuted = np.take_along_axis(scales, order, axis=1)
    axes = np.take_along_axis(rotations.matrices(quats), order[:, None, :], axis=2)
    # A permutation may mirror; turning one axis round mends it.
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    # Long axis up (tilt within 90°): turn the long and the middle axis round together.
    down = axes[:, 2, 2] < 0
    axes[down, :, 2] *= -1
    axes[down, :, 0] *= -1
    quat = rotations.from_matrices(axes)
    # Half a turn about the long axis changes nothing: (w, z) becomes (-z, w).
    spun = np.abs(quat[:, 3]) > np.abs(quat[:, 0])
    w, x, y, z = quat[spun].T
    quat[spun] = np.stack([-z, y, -x, w], axis=1)
    quat[quat[:, 0] < 0] *= -1
    w, x, y, z = quat.T
    c = z / w
    scale = 1 + c * c
    a = (x / w - c * y / w) / scale
    b = (y / w + c * x / w) / scale
    return np.stack([a, b, c], axis=1), np.ascontiguousarray(permuted)


def quats_of(turns: F32) -> F32:
    """Return the (n, 4) unit quaternions of (n, 3) float32 turns (SPEC 6.11)."""
    a, b, c = turns.T
    out = np.empty((len(turns), 4), np.float32)
    out[:, 0] = 1
    out[:, 1] = a + b * c
    out[:, 2] = b - a * c
    out[:, 3] = c
    w, x, y, z = out.T
    norm = np.sqrt(((w * w + x * x) + y * y) + z * z)
    out /= norm[:, None]
    return out


def quantise(values: F64, extra_bits: U8) -> U32:
    """Return the codes of values in ±1 on ``2^extra_bits + 1`` levels, 0 without bits."""
    half = np.ldexp(0.5, extra_bits.astype(np.int32))
    codes = np.rint((values + 1) * half)
    codes = np.clip(codes, 0, 2 * half)
    return np.where(extra_bits > 0, codes, 0).astype(np.uint32)


def dequantise(codes: U32, extra_bits: U8) -> F32:
    """Return ``code · 2^(1 - extra_bits) - 1`` in float32, 0 where there are no extra_bits."""
    values = codes.astype(np.float32) * STEPS[extra_bits] - np.float32(1)
    return np.where(extra_bits > 0, values, np.float32(0))


def split(codes: U32, extra_bits: U8) -> tuple[list[U8], U8]:
    """Return symbol planes by extra_bits, the lowest first, and the plane of plain bits.

    Parameters
    ----------
    codes : (n,) uint32
    extra_bits : (n,) uint8

    Returns
    -------
    planes : list of uint8 arrays
        For each 1 ≤ m ≤ `SYMBOL_BITS` that occurs, capped there, the rows' high bits.
    rest : uint8 array
        The low bits of rows with more extra_bits.
    """
    spare = _spare(extra_bits)
    symbols = (codes >> spare).astype(np.uint8)
    planes = [symbols[rows] for rows in groups(extra_bits)]
    rest = bit_fields.pack(codes.astype(np.uint64), spare)
    return planes, rest


def join(planes: list[U8], rest: U8, extra_bits: U8, where: str) -> U32:
    """Return the codes that `split` stored; symbols out of range give codes out of range."""
    codes = np.zeros(len(extra_bits), np.uint32)
    capped = np.minimum(extra_bits, SYMBOL_BITS)
    # Rows by group, in a group as they come.
    order = np.argsort(capped, kind="stable")
    coded = sum(map(len, planes))
    if coded:
        codes[order[len(order) - coded :]] = np.concatenate(planes)
    spare = extra_bits - capped
    low = bit_fields.unpack(rest, spare, where).astype(np.uint32)
    return (codes << spare) | low


def groups(extra_bits: U8) -> list[NDArray[np.bool_]]:
    """Return the rows of each symbol plane: extra_bits 1, 2, … `SYMBOL_BITS` and above."""
    capped = np.minimum(extra_bits, SYMBOL_BITS)
    present = np.bincount(capped, minlength=SYMBOL_BITS + 1)
    return [capped == m for m in range(1, SYMBOL_BITS + 1) if present[m]]


def group_rows(extra_bits: U8) -> list[int]:
    """Return the number of rows of each symbol plane, as `groups` has them."""
    rows = np.bincount(np.minimum(extra_bits, SYMBOL_BITS), minlength=SYMBOL_BITS + 1)
    return [n for n in rows[1:].tolist() if n]


def rest_bytes(extra_bits: U8) -> int:
    """Return the length in bytes of the plane of plain bits."""
    return bit_fields.packed_bytes(_spare(extra_bits))


def _spare(extra_bits: U8) -> U8:
    return extra_bits - np.minimum(extra_bits, SYMBOL_BITS)
