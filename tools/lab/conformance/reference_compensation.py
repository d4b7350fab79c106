"""Compensation in the reference decoder, written from SPEC 5.9 and 8.5 in plain Python."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import msgpack

Pair = tuple[float, float]


def _f32(value: float) -> float:
    """Round a value to float32."""
    found: float = struct.unpack("<f", struct.pack("<f", value))[0]
    return found


class _Layer:
    """One compensation layer, parsed from its payload (SPEC 5.9).

    Parameters
    ----------
    data : bytes
        Payload of the layer.
    before : int
        Number of chunks of the previous layer, 0 for the first layer.
    chunk_splats : sequence of int
        Number of splats in each chunk of the file.
    """

    def __init__(self, data: bytes, before: int, chunk_splats: Sequence[int]) -> None:
        table = msgpack.unpackb(data)
        self.chunks = len(table["scales"])
        self.scales = struct.unpack(f"{self.chunks}b", table["scales"])
        self.opacities = struct.unpack(f"{self.chunks}b", table["opacities"])
        self.strengths = table["strengths"]
        numbers = struct.unpack(f"{len(table['book'])}b", table["book"])
        book = list(zip(numbers[::2], numbers[1::2], strict=True))
        count = sum(chunk_splats[before : self.chunks])
        bits = max(len(book) - 1, 0).bit_length()
        packed = int.from_bytes(table["codes"], "little")
        codes = [packed >> bits * place & (1 << bits) - 1 for place in range(count)]
        self.entries = [book[code] for code in codes] if book else [(0, 0)] * count

    def shift(self, chunk: int, entry: tuple[int, int]) -> Pair:
        """Return the shifts of log scales and logit for a splat, given its chunk and book entry."""
        scale = self.scales[chunk] / 128 + self.strengths[2 * chunk] / 64 * entry[0] / 128
        opacity = self.opacities[chunk] / 16 + self.strengths[2 * chunk + 1] / 64 * entry[1] / 16
        return scale, opacity


def shifts(
    payloads: Sequence[bytes], chunk_splats: Sequence[int], chunks: int
) -> list[Pair] | None:
    """Return the shifts of log scales and logit opacity for each splat of a prefix.

    Parameters
    ----------
    payloads : sequence of bytes
        Payloads of the compensation layers, in order.
    chunk_splats : sequence of int
        Splats of each chunk of the file.
    chunks : int
        Chunks in the prefix, at least 1.

    Returns
    -------
    list of (float, float), or None
        None if the prefix is not compensated.
    """
    layers: list[_Layer] = []
    entries: list[tuple[int, int]] = []
    for data in payloads:
        layers.append(_Layer(data, layers[-1].chunks if layers else 0, chunk_splats))
        entries += layers[-1].entries
    where = [chunk for chunk in range(chunks) for _ in range(chunk_splats[chunk])]
    if not layers or chunks == len(chunk_splats):
        return None

    def at(number: int, place: int) -> Pair:
        if number == len(layers):
            return 0.0, 0.0
        return layers[number].shift(where[place], entries[place])

    above = sum(layer.chunks < chunks for layer in layers)
    reached = above < len(layers) and layers[above].chunks == chunks
    if above == 0 or reached:
        return [at(above, place) for place in range(len(where))]
    below = layers[above - 1].chunks
    end = layers[above].chunks if above < len(layers) else len(chunk_splats)
    part = _f32(sum(chunk_splats[below:chunks]) / sum(chunk_splats[below:end]))
    out = []
    for place, chunk in enumerate(where):
        upper = at(above, place)
        if chunk < below:
            lower = at(above - 1, place)
            out.append(
                (
                    _f32(lower[0] + _f32(_f32(upper[0] - lower[0]) * part)),
                    _f32(lower[1] + _f32(_f32(upper[1] - lower[1]) * part)),
                )
            )
        else:
            out.append(upper)
    return out


def closed_sets(cells: Sequence[int]) -> list[list[int]]:
    """Return the sets of chunks that contain the parent of each member and are not prefixes.

    Parameters
    ----------
    cells : sequence of int
        Cell of each chunk, at least 1 (SPEC 5.4); few chunks, as the number of sets is 2^chunks.
    """
    sets = [
        [chunk for chunk in range(len(cells)) if number >> chunk & 1]
        for number in range(1, 1 << len(cells))
    ]
    return [
        chosen
        for chosen in sets
        if chosen != list(range(len(chosen)))
        and all(parent(cells, chunk) in (None, *chosen) for chunk in chosen)
    ]


def parent(cells: Sequence[int], chunk: int) -> int | None:
    """Return the parent of a chunk: the last earlier one of the same or an enclosing cell (5.4)."""
    around = [cells[chunk] >> k for k in range(32)]
    return next((c for c in range(chunk - 1, -1, -1) if cells[c] in around), None)


def equivalent_prefix(
    cells: Sequence[int], sizes: Sequence[int], chosen: Sequence[int], chunk: int
) -> int:
    """Return the length of the prefix whose shifts a chunk of a set uses (SPEC 8.5)."""

    def descends(other: int | None) -> bool:
        while other is not None and other != chunk:
            other = parent(cells, other)
        return other == chunk

    held = sum(sizes[other] for other in chosen if descends(other))
    lengths = range(max(chosen) + 1, 0, -1)
    return next(
        m for m in lengths if sum(sizes[other] for other in range(m) if descends(other)) <= held
    )


def add_shift(values: Sequence[float], shift: float) -> list[float]:
    """Return float32 values with a shift added."""
    return [_f32(value + shift) for value in values]
