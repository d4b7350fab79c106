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
I64 = NDArray[np.int64]

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
        if not 0 <= chunks <= len(self.chunk_splats):
            raise ValueError(
                f"{len(splats)} splats of {chunks} chunks, expected up to {len(self.chunk_splats)}"
            )
        held = np.arange(chunks) if drawn is None else np.asarray(drawn, np.int64)
        return self.apply_per_chunk(splats, held, np.full(len(held), chunks, np.int64))

    def apply_per_chunk(self, splats: Splats, chunks: I64, prefixes: I64) -> Splats:
        """Return some chunks of a scene, each shifted as in a prefix of its own.

        Parameters
        ----------
        splats : Splats
            Of these chunks, one behind the other.
        chunks : (k,) int64
            Their numbers.
        prefixes : (k,) int64
            Chunks of each one's prefix, more than its number; nothing is added to chunks whose
            prefix is the whole scene.

        Returns
        -------
        Splats
            With other scales and opacities; the same object where nothing is added.

        Raises
        ------
        ValueError
            The splats are not as many as these chunks hold.
        """
        counts = self.chunk_splats[chunks]
        if len(splats) != int(counts.sum()):
            raise ValueError(
                f"{len(splats)} splats of {len(chunks)} chunks, expected the {int(counts.sum())} "
                "that these hold"
            )
        is_part = prefixes < len(self.chunk_splats)
        if not self.layers or not is_part.any():
            return splats
        shifts = self.shifts_of(chunks[is_part], prefixes[is_part])
        if is_part.all():
            scales: F32 = splats.scales + shifts[:, :1]
            opacities: F32 = splats.opacities + shifts[:, 1]
            return replace(splats, scales=scales, opacities=opacities)
        # Rows to which nothing is added keep their bits, -0 among them.
        rows = np.repeat(is_part, counts)
        scales, opacities = splats.scales.copy(), splats.opacities.copy()
        scales[rows] += shifts[:, :1]
        opacities[rows] += shifts[:, 1]
        return replace(splats, scales=scales, opacities=opacities)

    def shifts_of(self, chunks: I64, prefixes: I64) -> F32:
        """Return what is added to the log scales and the logits of chunks, each as in a prefix.

        Parameters
        ----------
        chunks : (k,) int64
            Their numbers.
        prefixes : (k,) int64
            Chunks of each one's prefix: more than its number, less than all.

        Returns
        -------
        (n, 2) float32
            Of the splats of these chunks, one behind the other.
        """
        counts = self.chunk_splats[chunks]
        entries = self._entries(chunks)
        if len(prefixes) and (prefixes == prefixes[0]).all():
            return self._in_prefix(int(prefixes[0]), chunks, entries)
        out = np.zeros((int(counts.sum()), 2), np.float32)
        for prefix in np.unique(prefixes).tolist():
            are_of = prefixes == prefix
            rows = np.repeat(are_of, counts)
            out[rows] = self._in_prefix(prefix, chunks[are_of], entries[rows])
        return out

    def _in_prefix(self, prefix: int, chunks: I64, entries: NDArray[np.int8]) -> F32:
        """Return the shifts of some chunks' splats in one prefix."""
        ends = np.concatenate([[0], np.cumsum(self.chunk_splats)])
        above = next(
            (k for k, layer in enumerate(self.layers) if layer.chunks >= prefix), len(self.layers)
        )
        upper = self._of_layer(above, chunks, entries)
        if above == 0 or (above < len(self.layers) and self.layers[above].chunks == prefix):
            return upper
        # Between two layers, from one to the other in proportion to the splats that are there.
        # Behind the last layer comes the whole scene, whose shifts are 0.
        below = self.layers[above - 1].chunks
        stop = self.layers[above].chunks if above < len(self.layers) else len(self.chunk_splats)
        part = np.float32(
            float(ends[prefix] - ends[below]) / max(float(ends[stop] - ends[below]), 1.0)
        )
        in_both = chunks < below
        rows = np.repeat(in_both, self.chunk_splats[chunks])
        lower = self._of_layer(above - 1, chunks[in_both], entries[rows])
        upper[rows] = lower + (upper[rows] - lower) * part
        return upper

    def _of_layer(self, number: int, chunks: I64, entries: NDArray[np.int8]) -> F32:
        """Return the shifts of a layer for the splats of some of its chunks."""
        out = np.zeros((len(entries), 2), np.float32)
        if number == len(self.layers):
            return out
        layer = self.layers[number]
        per_chunk = np.stack([layer.scales[chunks], layer.opacities[chunks]], axis=1)
        strengths = layer.strengths[chunks].astype(np.int32)
        chunk = np.repeat(np.arange(len(chunks)), self.chunk_splats[chunks])
        # Integers up to 2^15 + 2^15 in units of a step and 1/64 of it.
        units = per_chunk.astype(np.int32)[chunk] * 64 + strengths[chunk] * entries.astype(np.int32)
        out[:, 0] = units[:, 0].astype(np.float32) * np.float32(SCALE_STEP * STRENGTH_STEP)
        out[:, 1] = units[:, 1].astype(np.float32) * np.float32(OPACITY_STEP * STRENGTH_STEP)
        return out

    def _entries(self, chunks: I64) -> NDArray[np.int8]:
        """Return the books' entries of the splats of some chunks, (n, 2)."""
        counts = self.chunk_splats[chunks]
        out = np.zeros((int(counts.sum()), 2), np.int8)
        first = 0
        for layer in self.layers:
            own = (first <= chunks) & (chunks < layer.chunks)
            if len(layer.book) and own.any():
                starts = np.concatenate([[0], np.cumsum(self.chunk_splats[first : layer.chunks])])
                codes = np.concatenate(
                    [
                        layer.codes[starts[chunk] : starts[chunk + 1]]
                        for chunk in (chunks[own] - first).tolist()
                    ]
                )
                out[np.repeat(own, counts)] = layer.book[codes]
            first = layer.chunks
        return out


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
