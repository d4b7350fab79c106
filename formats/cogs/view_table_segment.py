"""The view table in a COGS file: one segment, a msgpack map of columns (SPEC 5.12)."""

from __future__ import annotations

import numpy as np

from cogsplat.codec.errors import LimitError
from cogsplat.codec.segments.view_shares import MAX_VIEWS, ViewTable, pack_codes, unpack_codes
from cogsplat.codec.streams.byte_planes import LENGTH_MASK

from . import canonical_msgpack
from .msgpack_map import CheckedMap

# Bytes of the word in front of the plane of codes (SPEC 6.3).
_WORD_BYTES = 4


def pack_view_table(table: ViewTable) -> bytes:
    """Return the payload of a view table's segment."""
    value: dict[str, canonical_msgpack.Value] = {
        "position": table.positions.astype("<f4").tobytes(),
        "direction": table.directions.astype("i1").tobytes(),
        "codes": pack_codes(table.codes),
    }
    return canonical_msgpack.pack(value)


def unpack_view_table(payload: bytes, where: str, chunks: int, allowed_bytes: int) -> ViewTable:
    """Return the view table of a segment.

    Parameters
    ----------
    payload : bytes
        The segment's bytes, its CRC already checked.
    where : str
        Names the segment in messages.
    chunks : int
        Chunks of the whole file.
    allowed_bytes : int
        What the codes may take in memory, one byte each.

    Raises
    ------
    FormatError
        ``msgpack-``…, ``root-missing``, ``root-type``, ``root-columns``, ``root-value``, or of the
        codes ``plane-``…, ``zstd-``….
    UnsupportedError
        ``root-must-understand``.
    LimitError
        ``decoded-size``: more than `allowed_bytes`.
    """
    table = CheckedMap(canonical_msgpack.unpack(payload, where), where, "5.12")
    positions = table.column("position", "<f4", None, 3).astype(np.float32)
    views = len(positions)
    directions = table.column("direction", "i1", views, 3).astype(np.int8)
    packed = table.take("codes", bytes)
    stored = int.from_bytes(packed[:_WORD_BYTES], "little") & LENGTH_MASK
    if len(packed) != _WORD_BYTES + stored:
        raise table.error(
            "codes",
            f"{len(packed)} bytes, expected a word and the {stored} bytes that it states",
            "root-columns",
        )
    table.finish()
    if not 1 <= views <= MAX_VIEWS:
        raise table.error("position", f"{views} views, expected 1 to {MAX_VIEWS}")
    if not np.isfinite(positions).all():
        raise table.error("position", "expected finite numbers")
    if not directions.any(axis=1).all():
        raise table.error("direction", "0, 0, 0, expected a direction")
    if views * chunks > allowed_bytes:
        raise LimitError(
            "decoded-size",
            f"{where}: {views * chunks} codes, expected at most {allowed_bytes} bytes of them "
            "(SPEC 9.2)",
        )
    return ViewTable(positions, directions, unpack_codes(packed, views, chunks, where))
