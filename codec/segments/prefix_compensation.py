"""Compensation: larger and more opaque splats in a prefix, for the splats it lacks (SPEC 5.9, 8.5).

This module applies shifts of scales and opacities; `compensation_fit` fits them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import Splats

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

MAX_CODE_BITS: Final = 8
"""Bits of a splat's code at most (SPEC 5.9)."""

# SPEC 8.5: units of shifts and book entries, and of strengths. All are powers of two: a shift is an
# integer below 2^16 times a power of two, exact in float32.
SCALE_STEP: Final = 2.0**-7
"""Unit of shifts of log scales."""

OPACITY_STEP: Final = 2.0**-4
"""Unit of shifts of logits."""

STRENGTH_STEP: Final = 2.0**-6
"""Unit of strengths."""


@dataclass(frozen=True, eq=False)
class Layer:
    """Shifts of log scales and logits for one prefix of whole chunks.

    The shift of a splat is the shift of its chunk plus the chunk's strength times the splat's entry
    in a small codebook, the book. A splat has its entry from the first layer that includes its
    chunk; all later layers use the same entry.

    Parameters
    ----------
    scales, opacities : (m,) int8
        Shift of the log scales and of the logits of each of the prefix's m chunks, in units of
        `SCALE_STEP` and `OPACITY_STEP`.
    strengths : (m, 2) uint8
        Strength of each chunk for scales and for opacities, in units of `STRENGTH_STEP`.
    book : (k, 2) int8
        Codebook entries of the chunks that the previous layer lacks: shifts of log scales and
        logits, in units of `SCALE_STEP` and `OPACITY_STEP`. Without rows, all entries are 0.
    codes : (n,) uint8
        Row of the book for each splat of the chunks that the previous layer lacks, in stored
        order.
    """

    scales: NDArray[np.int8]
    opacities: NDArray[np.int8]
    strengths: NDArray[np.uint8]
    book: NDArray[np.int8]
    codes: NDArray[np.uint8]

    @property
    def chunks(self) -> int:
        """Number of chunks in the prefix."""
        return len(self.scales)


@dataclass(frozen=True, eq=False)
class Compensation:
    """Shifts of log scales and logits that make a prefix look like the whole scene.

    Each layer holds the shifts for one prefix. Shifts for a prefix between two layers are
    interpolated.

    Parameters
    ----------
    layers : sequence of Layer
        Layers in ascending order of their chunk counts.
    chunk_splats : (c,) int64
        Number of splats in each chunk of the scene.
    """

    layers: Sequence[Layer]
    chunk_splats: NDArray[np.int64]

    def apply(self, splats: Splats, chunks: int, drawn: Sequence[int] | None = None) -> Splats:
        """Return a prefix of a scene with its log scales and logits shifted.

        Parameters
        ----------
        splats : Splats
            Splats of the prefix in stored order; only those of the chunks `drawn` if given.
        chunks : int
            Number of chunks in the prefix.
        drawn : sequence of int, optional
            Numbers of the chunks in `splats`: those that have not ended (SPEC 5.10).

        Returns
        -------
        Splats
            Shifted scales and opacities; the same object if no shift applies.

        Raises
        ------
        ValueError
            The number of splats differs from that of the chunks.
        """
        if not 0 <= chunks <= len(self.chunk_splats):
            raise ValueError(
                f"{len(splats)} splats of {chunks} chunks, expected up to {len(self.chunk_splats)}"
            )
        held = np.arange(chunks) if drawn is None else np.asarray(drawn, np.int64)
        return self.apply_per_chunk(splats, held, np.full(len(held), chunks, np.int64))

    @property
    def last_chunks(self) -> int:
        """Number of chunks of the last layer; 0 without layers."""
        return self.layers[-1].chunks if self.layers else 0

    def apply_per_chunk(
        self, splats: Splats, chunks: I64, prefixes: I64, parts: F64 | None = None
    ) -> Splats:
        """Return the splats of some chunks, each chunk shifted as in its own prefix.

        Parameters
        ----------
        splats : Splats
            Splats of the chunks, concatenated.
        chunks : (k,) int64
            Numbers of the chunks.
        prefixes : (k,) int64
            Length in chunks of the prefix that each chunk is shifted for; the prefix must include
            the chunk. A chunk whose prefix is the whole scene is unchanged.
        parts : (k,) float64, optional
            Position of each chunk, 0 to 1, between the last layer and the whole scene, where its
            prefix is longer than that of the last layer (`chunk_sets.descendant_parts`); a chunk
            at 1 is unchanged. By default the position of its prefix.

        Returns
        -------
        Splats
            Shifted scales and opacities; the same object if no shift applies.

        Raises
        ------
        ValueError
            The number of splats differs from that of the chunks.
        """
        counts = self.chunk_splats[chunks]
        if len(splats) != int(counts.sum()):
            raise ValueError(
                f"{len(splats)} splats of {len(chunks)} chunks, expected the {int(counts.sum())} "
                "that these hold"
            )
        is_part = prefixes < len(self.chunk_splats)
        if parts is not None:
            is_part &= (prefixes <= self.last_chunks) | (parts < 1.0)
        if not self.layers or not is_part.any():
            return splats
        own_parts = None if parts is None else parts[is_part]
        shifts = self.shifts_of(chunks[is_part], prefixes[is_part], own_parts)
        if is_part.all():
            scales: F32 = splats.scales + shifts[:, :1]
            opacities: F32 = splats.opacities + shifts[:, 1]
            return replace(splats, scales=scales, opacities=opacities)
        # Rows without shift keep their bits, including -0.
        rows = np.repeat(is_part, counts)
        scales, opacities = splats.scales.copy(), splats.opacities.copy()
        scales[rows] += shifts[:, :1]
        opacities[rows] += shifts[:, 1]
        return replace(splats, scales=scales, opacities=opacities)

    def shifts_of(self, chunks: I64, prefixes: I64, parts: F64 | None = None) -> F32:
        """Return the shifts of log scales and logits of chunks, each chunk for its own prefix.

        Parameters
        ----------
        chunks : (k,) int64
            Numbers of the chunks.
        prefixes : (k,) int64
            Length in chunks of the prefix that each chunk is shifted for. It includes the chunk,
            and is not the whole scene.
        parts : (k,) float64, optional
            See `apply_per_chunk`.

        Returns
        -------
        (n, 2) float32
            Shifts of the chunks' splats, concatenated.
        """
        counts = self.chunk_splats[chunks]
        entries = self._entries(chunks)
        if parts is not None:
            # Behind the last layer the parts say all.
            prefixes = np.minimum(prefixes, self.last_chunks + 1)
        if len(prefixes) and (prefixes == prefixes[0]).all():
            return self._prefix_shifts(int(prefixes[0]), chunks, entries, parts)
        out = np.zeros((int(counts.sum()), 2), np.float32)
        for prefix in np.unique(prefixes).tolist():
            are_of = prefixes == prefix
            rows = np.repeat(are_of, counts)
            own_parts = None if parts is None else parts[are_of]
            out[rows] = self._prefix_shifts(prefix, chunks[are_of], entries[rows], own_parts)
        return out

    def _prefix_shifts(
        self, prefix: int, chunks: I64, entries: NDArray[np.int8], parts: F64 | None
    ) -> F32:
        """Return each splat's shifts of log scales and logit for one prefix, (n, 2) float32.

        Shifts are interpolated between layers.

        Parameters
        ----------
        prefix : int
            Number of chunks in the prefix.
        chunks : (k,) int64
            Numbers of the chunks.
        entries : (n, 2) int8
            Book entry of each splat of the chunks, concatenated (`_entries`).
        parts : (k,) float64, optional
            See `apply_per_chunk`.
        """
        ends = np.concatenate([[0], np.cumsum(self.chunk_splats)])
        above = next(
            (k for k, layer in enumerate(self.layers) if layer.chunks >= prefix), len(self.layers)
        )
        upper = self._layer_shifts(above, chunks, entries)
        if above == 0 or (above < len(self.layers) and self.layers[above].chunks == prefix):
            return upper
        # Interpolate between two layers in proportion to the splats of the prefix. The whole scene,
        # with shifts of 0, follows the last layer.
        below = self.layers[above - 1].chunks
        stop = self.layers[above].chunks if above < len(self.layers) else len(self.chunk_splats)
        in_both = chunks < below
        rows = np.repeat(in_both, self.chunk_splats[chunks])
        whole = float(ends[prefix] - ends[below]) / max(float(ends[stop] - ends[below]), 1.0)
        part: np.float32 | F32 = np.float32(whole)
        if parts is not None and above == len(self.layers):
            own = parts[in_both].astype(np.float32)
            part = np.repeat(own, self.chunk_splats[chunks[in_both]])[:, None]
        lower = self._layer_shifts(above - 1, chunks[in_both], entries[rows])
        upper[rows] = lower + (upper[rows] - lower) * part
        return upper

    def _layer_shifts(self, number: int, chunks: I64, entries: NDArray[np.int8]) -> F32:
        """Return the shifts of chunks in one layer, (n, 2); 0 in the layer after the last.

        Parameters
        ----------
        number : int
            Number of the layer.
        chunks, entries
            See `_prefix_shifts`.
        """
        out = np.zeros((len(entries), 2), np.float32)
        if number == len(self.layers):
            return out
        layer = self.layers[number]
        per_chunk = np.stack([layer.scales[chunks], layer.opacities[chunks]], axis=1)
        strengths = layer.strengths[chunks].astype(np.int32)
        chunk = np.repeat(np.arange(len(chunks)), self.chunk_splats[chunks])
        # Integers up to 2^15 + 2^15, in units of 1/64 of a step.
        units = per_chunk.astype(np.int32)[chunk] * 64 + strengths[chunk] * entries.astype(np.int32)
        out[:, 0] = units[:, 0].astype(np.float32) * np.float32(SCALE_STEP * STRENGTH_STEP)
        out[:, 1] = units[:, 1].astype(np.float32) * np.float32(OPACITY_STEP * STRENGTH_STEP)
        return out

    def _entries(self, chunks: I64) -> NDArray[np.int8]:
        """Return the book entry of each splat of chunks, (n, 2)."""
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
    """Return the number of bits of a code for a book of `rows` rows (SPEC 5.9)."""
    return max(rows - 1, 0).bit_length()


def pack_codes(codes: NDArray[np.uint8], bits: int) -> bytes:
    """Return codes packed with `bits` bits each, lowest bit first, padded with zeros."""
    if bits == 0:
        return b""
    each = np.unpackbits(codes[:, None], axis=1, bitorder="little")[:, :bits]
    return np.packbits(each.reshape(-1), bitorder="little").tobytes()


def unpack_codes(packed: bytes, bits: int, count: int) -> NDArray[np.uint8]:
    """Return `count` codes of `bits` bits; the caller has checked the number of bytes."""
    if bits == 0:
        # A view of one byte: a file may state a large count that no stored bytes back up.
        return np.broadcast_to(np.uint8(0), (count,))
    codes = np.empty(count, np.uint8)
    octets = np.frombuffer(packed, np.uint8)
    # Unpacked bits take 8 to 64 times the memory of packed ones, hence pieces. A piece of 2^16
    # codes always ends at a whole byte.
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
    """Return the size of `count` packed codes, bytes."""
    return (count * bits + 7) // 8
