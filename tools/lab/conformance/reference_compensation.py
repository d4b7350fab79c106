"""Compensation in the reference decoder, written from SPEC 5.9 and 8.5 in plain Python."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence

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


def closed_sets(parents: Sequence[int | None]) -> list[list[int]]:
    """Return the sets of chunks that contain the parent of each member and are not prefixes.

    Parameters
    ----------
    parents : sequence of (int or None)
        Parent of each chunk (SPEC 5.4); few chunks, as the number of sets is 2^chunks.
    """
    sets = [
        [chunk for chunk in range(len(parents)) if number >> chunk & 1]
        for number in range(1, 1 << len(parents))
    ]
    return [
        chosen
        for chosen in sets
        if chosen != list(range(len(chosen)))
        and all(parents[chunk] in (None, *chosen) for chunk in chosen)
    ]


def set_shifts(
    payloads: Sequence[bytes],
    sizes: Sequence[int],
    parents: Sequence[int | None],
    chosen: Sequence[int],
    chunk: int,
) -> list[Pair] | None:
    """Return the shifts of the splats of a file, of which those of a chunk of a set are right.

    Parameters
    ----------
    payloads : sequence of bytes
        Payloads of the compensation layers, in order.
    sizes : sequence of int
        Splats of each chunk of the file.
    parents : sequence of (int or None)
        Parent of each chunk.
    chosen : sequence of int
        Chunks of the set, ascending.
    chunk : int
        Chunk of the set.

    Returns
    -------
    list of (float, float), or None
        None if the chunk is not compensated.
    """

    def splats(chunks: Iterable[int]) -> int:
        """Return the splats of the chunk's descendants among some chunks."""
        return sum(sizes[other] for other in chunks if descends(other))

    def descends(other: int | None) -> bool:
        while other is not None and other != chunk:
            other = parents[other]
        return other == chunk

    held, every = splats(chosen), range(len(sizes))
    lengths = range(max(chosen) + 1, 0, -1)
    prefix = next(m for m in lengths if splats(range(m)) <= held)
    last = len(msgpack.unpackb(payloads[-1])["scales"])
    if prefix <= last:
        return shifts(payloads, sizes, prefix)
    if held == splats(every):
        return None
    before = splats(range(last))
    part = _f32((held - before) / (splats(every) - before))
    # From the shifts of the last layer to none.
    whole = shifts(payloads, sizes, last) or []
    fading = [
        (_f32(s + _f32(_f32(0.0 - s) * part)), _f32(o + _f32(_f32(0.0 - o) * part)))
        for s, o in whole
    ]
    return fading + [(0.0, 0.0)] * (sum(sizes) - len(fading))


def add_shift(values: Sequence[float], shift: float) -> list[float]:
    """Return float32 values with a shift added."""
    return [_f32(value + shift) for value in values]
