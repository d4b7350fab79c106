"""Encode and decode the segment of a compensation layer: a msgpack map of columns (SPEC 5.9)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cogsplat.codec.errors import LimitError
from cogsplat.codec.segments.prefix_compensation import (
    MAX_CODE_BITS,
    Layer,
    code_bits,
    pack_codes,
    packed_bytes,
    unpack_codes,
)

from . import canonical_msgpack
from .msgpack_map import CheckedMap

_CLAUSE = "5.9"


def pack_layer(layer: Layer) -> bytes:
    """Encode a compensation layer as the payload of its segment."""
    value: dict[str, canonical_msgpack.Value] = {
        "scales": layer.scales.astype("i1").tobytes(),
        "opacities": layer.opacities.astype("i1").tobytes(),
        "strengths": layer.strengths.astype("u1").tobytes(),
        "book": layer.book.astype("i1").tobytes(),
        "codes": pack_codes(layer.codes, code_bits(len(layer.book))),
    }
    return canonical_msgpack.pack(value)


def unpack_layer(
    payload: bytes,
    where: str,
    before: int,
    chunk_splats: Sequence[int],
    all_chunks: int,
    allowed_bytes: int,
) -> Layer | None:
    """Decode the segment of a compensation layer; None if pages of its chunks are missing.

    Parameters
    ----------
    payload : bytes
        Bytes of the segment, whose CRC was checked.
    where : str
        Name of the segment in messages.
    before : int
        Number of chunks up to the end of the previous layer; 0 for the first.
    chunk_splats : sequence of int
        Splats per chunk, for the chunks listed so far.
    all_chunks : int
        Number of chunks of the whole file.
    allowed_bytes : int
        Memory limit of the layer's codes, bytes, at one byte each.

    Raises
    ------
    FormatError
        ``msgpack-``…, or ``root-missing``, ``root-type``, ``root-columns``, ``root-value``.
    UnsupportedError
        ``root-must-understand``.
    LimitError
        ``decoded-size``: the codes exceed `allowed_bytes`.
    """
    table = CheckedMap(canonical_msgpack.unpack(payload, where), where, _CLAUSE)
    scales = table.column("scales", "i1", None).astype(np.int8)
    chunks = len(scales)
    opacities = table.column("opacities", "i1", chunks).astype(np.int8)
    strengths = table.column("strengths", "u1", chunks, 2).astype(np.uint8)
    book = table.column("book", "i1", None, 2).astype(np.int8)
    packed = table.pop("codes", bytes)
    table.finish()
    if not before < chunks <= all_chunks:
        raise table.error("scales", f"{chunks} chunks, expected {before + 1} to {all_chunks}")
    if chunks > len(chunk_splats):
        return None
    if len(book) > 1 << MAX_CODE_BITS:
        raise table.error("book", f"{len(book)} rows, expected at most {1 << MAX_CODE_BITS}")
    count = sum(chunk_splats[before:chunks]) if len(book) else 0
    bits = code_bits(len(book))
    if len(packed) != packed_bytes(count, bits):
        raise table.error(
            "codes",
            f"{len(packed)} bytes, expected {packed_bytes(count, bits)} for {count} codes of "
            f"{bits} bits",
            "root-columns",
        )
    if bits and count > allowed_bytes:
        raise LimitError(
            "decoded-size",
            f"{where}: {count} codes of a byte each, expected at most {allowed_bytes} (SPEC 9.2)",
        )
    codes = unpack_codes(packed, bits, count)
    spare = 8 * len(packed) - count * bits
    if spare and packed[-1] >> (8 - spare):
        raise table.error("codes", "padding bits behind the last code are set, expected zeros")
    if bits and len(codes) and int(codes.max()) >= len(book):
        raise table.error("codes", f"code {int(codes.max())}, expected below {len(book)}")
    return Layer(scales, opacities, strengths, book, codes)
