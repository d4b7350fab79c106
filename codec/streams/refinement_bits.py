"""Bits streams: more bits of the values of a stream with an adaptive step (SPEC 6.17)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from . import bit_fields
from .adaptive_step import MAX_COEFFICIENT, StepModel
from .records import Attribute, Kind, StoredStream, Stream

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
U64 = NDArray[np.uint64]
I64 = NDArray[np.int64]

_CONSTANT: Final = struct.Struct("<f")


@dataclass(frozen=True, eq=False)
class Finer:
    """A bits stream, which adds extra_bits to the rows of a stream that has some (SPEC 6.17).

    Parameters
    ----------
    stream : StoredStream
    scales : (rows, 3) float32
        The same rows' scales, refined.
    """

    stream: StoredStream
    scales: F32

    def step_models(self, coarse: Sequence[StepModel]) -> list[StepModel]:
        """Return the finer step_models that belong to those of the head."""
        params = self.stream.require_params(len(coarse) * _CONSTANT.size)
        constants = [value for (value,) in _CONSTANT.iter_unpack(params)]
        if not all(abs(value) <= MAX_COEFFICIENT for value in constants):
            raise FormatError(
                "resolution-value",
                f"{self.stream.where}: constants {constants}, "
                f"expected magnitudes to {MAX_COEFFICIENT:g}",
                clause="6.17",
            )
        return [with_constant(one, c) for one, c in zip(coarse, constants, strict=True)]

    def extra(self, coarse: Sequence[StepModel], extra_bits: Sequence[U8]) -> list[U8]:
        """Return how many extra_bits the rows gain, for each model of the head."""
        finer = self.step_models(coarse)
        return [gained(f, self.scales, h) for f, h in zip(finer, extra_bits, strict=True)]

    def plane(self, index: int, widths: U8) -> U8:
        """Return a plane of the rows' bits, its padding checked."""
        plane = self.stream.plane(index, bit_fields.packed_bytes(widths))
        bit_fields.require_padding(plane, widths, self.stream.where)
        return plane

    def fields(self, index: int, widths: U8) -> U64:
        """Return the rows' bits in a plane."""
        return bit_fields.unpack(self.plane(index, widths), widths, self.stream.where)

    def refuse(self) -> FormatError:
        """Return what to raise for a code that a row does not have."""
        return FormatError(
            "code-range",
            f"{self.stream.where}: a code beyond what the extra_bits of its row allow",
            clause="6.17",
        )


def with_constant(model: StepModel, constant: float) -> StepModel:
    """Return a model with another first coefficient."""
    return replace(model, coefficients=(constant, *model.coefficients[1:]))


def gained(finer: StepModel, scales: F32, extra_bits: U8) -> U8:
    """Return how many extra_bits a finer model adds to those that rows have."""
    wanted = finer.extra_bits(scales)
    return np.maximum(wanted, extra_bits) - extra_bits


def coarse_of(codes: U32, extra: U8) -> tuple[U32, U64]:
    """Split codes at finer extra_bits into the nearest codes at coarser ones and what is below.

    Parameters
    ----------
    codes : uint32
    extra : uint8
        Halvings between the two, broadcast against the codes.

    Returns
    -------
    coarse : uint32
    fields : uint64
        In `extra` bits.
    """
    wide = codes.astype(np.int64)
    half = half_of(extra)
    shift = extra.astype(np.int64)
    coarse = (wide + half) >> shift
    return coarse.astype(np.uint32), (wide + half - (coarse << shift)).astype(np.uint64)


def half_of(extra: U8) -> I64:
    """Return half of what one coarse level is worth in fine ones, 0 without extra extra_bits."""
    half: I64 = (np.int64(1) << extra.astype(np.int64)) >> 1
    return half


def bits_stream(
    attribute: Attribute, constants: Sequence[float], planes: Sequence[U8], rows: int
) -> Stream:
    """Return a bits stream of planes as SPEC 6.17 has them."""
    params = b"".join(_CONSTANT.pack(value) for value in constants)
    return Stream(attribute, Kind.BITS, rows, params, planes)
