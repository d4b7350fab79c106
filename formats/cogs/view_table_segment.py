"""Encode and decode the segment of the view table: a msgpack map of columns (SPEC 5.12)."""

from __future__ import annotations

import numpy as np

from cogsplat.codec.errors import LimitError
from cogsplat.codec.segments.view_shares import MAX_VIEWS, ViewTable, pack_codes, unpack_codes
from cogsplat.codec.streams.byte_planes import LENGTH_MASK

from . import canonical_msgpack
from .msgpack_map import CheckedMap

# Length of the word before the plane of codes, bytes (SPEC 6.3).
_WORD_BYTES = 4


def pack_view_table(table: ViewTable) -> bytes:
    """Encode a view table as the payload of its segment."""
    value: dict[str, canonical_msgpack.Value] = {
        "position": table.positions.astype("<f4").tobytes(),
        "codes": pack_codes(table.codes),
    }
    return canonical_msgpack.pack(value)


def unpack_view_table(payload: bytes, where: str, chunks: int, allowed_bytes: int) -> ViewTable:
    """Decode the segment of the view table.

    Parameters
    ----------
    payload : bytes
        Bytes of the segment, whose CRC was checked.
    where : str
        Name of the segment in messages.
    chunks : int
        Number of chunks of the whole file.
    allowed_bytes : int
        Memory limit of the codes, bytes, at one byte each.

    Raises
    ------
    FormatError
        ``msgpack-``…, ``root-missing``, ``root-type``, ``root-columns``, ``root-value``; for the
        codes, ``plane-``…, ``zstd-``….
    UnsupportedError
        ``root-must-understand``.
    LimitError
        ``decoded-size``: the codes exceed `allowed_bytes`.
    """
    table = CheckedMap(canonical_msgpack.unpack(payload, where), where, "5.12")
    positions = table.column("position", "<f4", None, 3).astype(np.float32)
    views = len(positions)
    packed = table.pop("codes", bytes)
    stored = int.from_bytes(packed[:_WORD_BYTES], "little") & LENGTH_MASK
    if len(packed) != _WORD_BYTES + stored:
        raise table.error(
            "codes",
            f"{len(packed)} bytes, expected a word of {_WORD_BYTES} bytes and the {stored} bytes "
            "of its plane",
            "root-columns",
        )
    table.finish()
    if not 1 <= views <= MAX_VIEWS:
        raise table.error("position", f"{views} views, expected 1 to {MAX_VIEWS}")
    if not np.isfinite(positions).all():
        raise table.error("position", "NaN or infinity, expected finite numbers")
    if views * chunks > allowed_bytes:
        raise LimitError(
            "decoded-size",
            f"{where}: {views * chunks} codes of a byte each, expected at most {allowed_bytes} "
            "(SPEC 9.2)",
        )
    return ViewTable(positions, unpack_codes(packed, views, chunks, where))
