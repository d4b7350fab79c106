"""Extra attributes of a chunk's splats as byte planes, lossless (SPEC 5.7)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError
from cogsplat.codec.splats import Extra
from cogsplat.codec.streams.byte_planes import LENGTH_MASK, pack_plane, unpack_plane

_WORD: Final = np.dtype("<u4")


@dataclass(frozen=True)
class AttributeType:
    """Name and type of an extra attribute (SPEC 5.7).

    Parameters
    ----------
    name : str
        Name of the attribute, such as ``object``.
    dtype : str
        One of `splats.EXTRA_DTYPES`.
    components : int
        Values per splat; 0 for one value per splat in an array of shape (n,).
    """

    name: str
    dtype: str
    components: int = 0

    @property
    def values(self) -> int:
        """Values per splat, at least 1."""
        return max(1, self.components)

    @property
    def row_bytes(self) -> int:
        """Bytes of one splat's values, equal to the number of planes."""
        return self.values * int(self.dtype[1:])

    def allocate(self, rows: int) -> Extra:
        """Return an uninitialised array for `rows` splats."""
        shape = (rows, self.components) if self.components else (rows,)
        return np.empty(shape, self.dtype)


def attribute_types(extras: Mapping[str, Extra]) -> tuple[AttributeType, ...]:
    """Return the types of a scene's extra attributes, in their order."""
    return tuple(
        AttributeType(name, values.dtype.str[1:], values.shape[1] if values.ndim == 2 else 0)
        for name, values in extras.items()
    )


def pack_attributes(extras: Mapping[str, Extra]) -> bytes:
    """Return the payload of one chunk: one plane for each attribute, component and byte.

    Parameters
    ----------
    extras : mapping of str to (n,) or (n, c) array
        Arrays in the order of the chunk's stored splats.
    """
    words: list[int] = []
    bodies: list[bytes] = []
    for values in extras.values():
        little = values.astype(values.dtype.newbyteorder("<"), copy=False)
        octets = np.ascontiguousarray(little).reshape(len(values), -1).view(np.uint8)
        for column in range(octets.shape[1]):
            word, stored = pack_plane(np.ascontiguousarray(octets[:, column]))
            words.append(word)
            bodies.append(stored)
    return b"".join([np.array(words, _WORD).tobytes(), *bodies])


def attribute_bytes(
    payload: memoryview, types: Sequence[AttributeType], where: str
) -> dict[str, int]:
    """Return the stored bytes of each attribute in a payload.

    Parameters
    ----------
    payload, types, where
        See `unpack_attributes`.

    Raises
    ------
    FormatError
        ``attribute-record``: words and planes do not fill the payload exactly.
    """
    words = _words(payload, types, where)
    sizes = {}
    for kind in types:
        own, words = words[: kind.row_bytes], words[kind.row_bytes :]
        sizes[kind.name] = sum(_WORD.itemsize + (word & LENGTH_MASK) for word in own)
    return sizes


def unpack_attributes(
    payload: memoryview, types: Sequence[AttributeType], out: Mapping[str, Extra], where: str
) -> None:
    """Decode a chunk's attributes into the rows of `out`.

    Parameters
    ----------
    payload : memoryview
        Bytes of the segment, its CRC already checked.
    types : sequence of AttributeType
        Types in the order of the root.
    out : mapping of str to (n,) or (n, c) array
        Rows of the chunk, of these types.
    where : str
        Name of the segment in messages.

    Raises
    ------
    FormatError
        ``attribute-record``: words and planes do not fill the payload exactly; or a code of
        `byte_planes.unpack_plane`.
    """
    words = _words(payload, types, where)
    position = len(words) * _WORD.itemsize
    plane = iter(range(len(words)))
    for kind in types:
        values = out[kind.name]
        octets: NDArray[np.uint8] = np.empty((len(values), kind.row_bytes), np.uint8)
        for column in range(kind.row_bytes):
            number = next(plane)
            word = words[number]
            stop = position + (word & LENGTH_MASK)
            label = f"{where}, plane {number}"
            octets[:, column] = unpack_plane(payload[position:stop], word, len(values), label)
            position = stop
        little = octets.view(f"<{kind.dtype}")
        values[...] = little.reshape(values.shape)


def _words(payload: memoryview, types: Sequence[AttributeType], where: str) -> list[int]:
    """Return the words of all planes; check that words and planes fill the payload."""
    count = sum(kind.row_bytes for kind in types)
    end = count * _WORD.itemsize
    words: list[int] = []
    if end <= len(payload):
        words = np.frombuffer(payload, _WORD, count).tolist()
    end += sum(word & LENGTH_MASK for word in words)
    if end != len(payload) or len(words) != count:
        raise FormatError(
            "attribute-record",
            f"{where}: {len(payload)} bytes, expected {end} for {count} planes",
            clause="5.7",
        )
    return words
