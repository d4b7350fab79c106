"""Compensation: splats of a prefix are larger and more opaque while other splats are missing.

SPEC 5.9, 8.5. Applying takes numpy alone; `compensation_fit` finds what is applied.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import Splats

F32 = NDArray[np.float32]

MAX_CODE_BITS: Final = 8
"""Bits of a splat's code, at most (SPEC 5.9)."""

# SPEC 8.5: units of the shifts and of the book, then of the strengths. Powers of two, so that a
# shift is an integer below 2^16 times a power of two: exact in float32.
SCALE_STEP: Final = 2.0**-7
OPACITY_STEP: Final = 2.0**-4
STRENGTH_STEP: Final = 2.0**-6


@dataclass(frozen=True, eq=False)
class Layer:
    """The shifts of log scales and logits for one prefix of whole chunks.

    Parameters
    ----------
    scales, opacities : (m,) int8
        Added to the log scales and the logits of every splat of each of the prefix's m chunks, in
        `SCALE_STEP` and `OPACITY_STEP`.
    strengths : (m, 2) uint8
        By what the book's entries are multiplied for the splats of each chunk, for scales and for
        opacities, in `STRENGTH_STEP`.
    book : (k, 2) int8
        Shifts that the codes of this layer's own chunks stand for, in `SCALE_STEP` and
        `OPACITY_STEP`. Without rows, its own chunks have no codes.
    codes : (n,) uint8
        Row of the book for each splat of the chunks that the layer before does not have, in stored
        order.
    """

    scales: NDArray[np.int8]
    opacities: NDArray[np.int8]
    strengths: NDArray[np.uint8]
    book: NDArray[np.int8]
    codes: NDArray[np.uint8]

    @property
    def chunks(self) -> int:
        """Chunks of the prefix."""
        return len(self.scales)


@dataclass(frozen=True, eq=False)
class Compensation:
    """The layers of a scene: shifts for some of its prefixes, from which those of others follow.

    Parameters
    ----------
    layers : sequence of Layer
        Of more and more chunks, at least one each and at most all.
    chunk_splats : (c,) int64
        Splats of every chunk of the scene.
    """

    layers: Sequence[Layer]
    chunk_splats: NDArray[np.int64]

    def apply(self, splats: Splats, chunks: int, drawn: Sequence[int] | None = None) -> Splats:
        """Return the first chunks of a scene with their log scales and logits shifted.

        Parameters
        ----------
        splats : Splats
            Of the first `chunks` chunks in stored order, all of them or those that are `drawn`.
        chunks : int
        drawn : sequence of int, optional
            Numbers of the chunks that `splats` hold: those that have not ended (SPEC 5.10).

        Returns
        -------
        Splats
            With other scales and opacities; the same object where nothing is added.

        Raises
        ------
        ValueError
            The splats are not as many as these chunks hold.
        """
        counts = self.chunk_splats[:chunks]
        expected = int((counts if drawn is None else counts[list(drawn)]).sum())
        if not 0 <= chunks <= len(self.chunk_splats) or len(splats) != expected:
            raise ValueError(
                f"{len(splats)} splats of {chunks} chunks, expected the {expected} of the first "
                f"{min(chunks, len(self.chunk_splats))}"
            )
        if not self.layers or chunks in (0, len(self.chunk_splats)):
            return splats
        shifts = self.shifts(chunks)
        if drawn is not None:
            shifts = shifts[np.repeat(np.isin(np.arange(chunks), drawn), counts)]
        scales: F32 = splats.scales + shifts[:, :1]
        opacities: F32 = splats.opacities + shifts[:, 1]
        return replace(splats, scales=scales, opacities=opacities)

    def shifts(self, chunks: int) -> F32:
        """Return what is added to the log scales and the logits of the first chunks' splats.

        Parameters
        ----------
        chunks : int
            From 1 to one less than all.

        Returns
        -------
        (n, 2) float32
        """
        ends = np.concatenate([[0], np.cumsum(self.chunk_splats)])
        above = next(
            (k for k, layer in enumerate(self.layers) if layer.chunks >= chunks), len(self.layers)
        )
        upper = self._of_layer(above, chunks)
        if above == 0 or (above < len(self.layers) and self.layers[above].chunks == chunks):
            return upper
        # Between two layers, from one to the other in proportion to the splats that are there.
        # Behind the last layer comes the whole scene, whose shifts are 0.
        below = self.layers[above - 1].chunks
        stop = self.layers[above].chunks if above < len(self.layers) else len(self.chunk_splats)
        part = np.float32(
            float(ends[chunks] - ends[below]) / max(float(ends[stop] - ends[below]), 1.0)
        )
        known = int(ends[below])
        lower = self._of_layer(above - 1, below)
        upper[:known] = lower + (upper[:known] - lower) * part
        return upper

    def _of_layer(self, number: int, chunks: int) -> F32:
        """Return the shifts of a layer for the splats of the first `chunks` chunks."""
        counts = self.chunk_splats[:chunks]
        out = np.zeros((int(counts.sum()), 2), np.float32)
        if number == len(self.layers):
            return out
        layer = self.layers[number]
        per_chunk = np.stack([layer.scales, layer.opacities], axis=1)[:chunks].astype(np.int32)
        strengths = layer.strengths[:chunks].astype(np.int32)
        own = self._entries(number, chunks).astype(np.int32)
        chunk = np.repeat(np.arange(chunks), counts)
        # Integers up to 2^15 + 2^15 in units of a step and 1/64 of it.
        units = per_chunk[chunk] * 64 + strengths[chunk] * own
        out[:, 0] = units[:, 0].astype(np.float32) * np.float32(SCALE_STEP * STRENGTH_STEP)
        out[:, 1] = units[:, 1].astype(np.float32) * np.float32(OPACITY_STEP * STRENGTH_STEP)
        return out

    def _entries(self, last: int, chunks: int) -> NDArray[np.int8]:
        """Return the books' entries of the splats of the first chunks, up to a layer's: (n, 2)."""
        parts: list[NDArray[np.int8]] = []
        first = 0
        for layer in self.layers[: last + 1]:
            stop = min(layer.chunks, chunks)
            count = int(self.chunk_splats[first:stop].sum()) if stop > first else 0
            if len(layer.book):
                parts.append(layer.book[layer.codes[:count]])
            else:
                parts.append(np.zeros((count, 2), np.int8))
            first = max(first, stop)
        return np.concatenate(parts)


def code_bits(rows: int) -> int:
    """Return the bits of a code for a book of so many rows (SPEC 5.9)."""
    return max(rows - 1, 0).bit_length()


def pack_codes(codes: NDArray[np.uint8], bits: int) -> bytes:
    """Return codes of `bits` bits each, lowest bit first, the last byte filled with zeros."""
    if bits == 0:
        return b""
    each = np.unpackbits(codes[:, None], axis=1, bitorder="little")[:, :bits]
    return np.packbits(each.reshape(-1), bitorder="little").tobytes()


def unpack_codes(packed: bytes, bits: int, count: int) -> NDArray[np.uint8]:
    """Return `count` codes; the caller has checked that the bytes are as many as they take."""
    if bits == 0:
        # One byte for all: so many may be a number that a file states and no bytes stand for.
        return np.broadcast_to(np.uint8(0), (count,))
    codes = np.empty(count, np.uint8)
    octets = np.frombuffer(packed, np.uint8)
    # Unpacked bits take 8 to 64 times the room of what they come from: a piece at a time. A piece
    # of 2^16 codes ends at a whole byte, whatever the bits of a code.
    piece = 1 << 16
    for start in range(0, count, piece):
        stop = min(start + piece, count)
        part = octets[start * bits // 8 : packed_bytes(stop, bits)]
        flat = np.unpackbits(part, bitorder="little")[: (stop - start) * bits]
        each = np.zeros((stop - start, 8), np.uint8)
        each[:, :bits] = flat.reshape(stop - start, bits)
        codes[start:stop] = np.packbits(each, axis=1, bitorder="little")[:, 0]
    return codes


def packed_bytes(count: int, bits: int) -> int:
    """Return the bytes that so many codes take."""
    return (count * bits + 7) // 8
