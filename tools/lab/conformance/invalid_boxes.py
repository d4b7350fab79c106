"""Must-reject vectors: chunk boxes around refined means, and attributes too large to decode."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from cogsplat.formats.cogs.canonical_msgpack import Value, pack, unpack

from . import handmade_streams as handmade
from . import reference_decoder, worked_example
from .attribute_vectors import store_planes, with_attributes
from .file_builder import build, one_chunk, pack_streams, split_root, table, with_root
from .invalid import Invalid
from .refinement_vectors import valid as refinement_vectors


def _bounds(rows: Sequence[Sequence[float]]) -> tuple[float, ...]:
    """Return the bounding box of points: three minima, then three maxima."""
    columns = list(zip(*rows, strict=True))
    return (*(min(column) for column in columns), *(max(column) for column in columns))


def _with_box(data: bytes, box: Sequence[float]) -> bytes:
    """Return a file of one chunk with the box in its chunk table replaced."""
    root, behind = split_root(data)
    index = unpack(root, "root")
    table(index, "chunks")["box"] = struct.pack("<6f", *box)
    return with_root(pack(index), behind)


def boxes() -> list[Invalid]:
    """Return vectors whose chunk box bounds only the refined, or only the unrefined, means."""

    def bad(name: str, note: str, *, refine: bool) -> Invalid:
        """Return a vector whose chunk box bounds only the refined, or only the unrefined, means.

        The file is the first valid vector of one chunk in which the two bounding boxes differ.
        """
        for vector in (*refinement_vectors(), worked_example.valid()):
            decoded = reference_decoder.decode(vector.data, refine=refine)
            held = _bounds(decoded.rows["means"])
            others = _bounds(reference_decoder.decode(vector.data, refine=not refine).rows["means"])
            beyond = any(a < b for a, b in zip(others[:3], held[:3], strict=True))
            beyond |= any(a > b for a, b in zip(others[3:], held[3:], strict=True))
            if beyond and len(decoded.chunk_splats) == 1:
                return Invalid(
                    name, _with_box(vector.data, held), "chunk-box", "5.4", note, "verify"
                )
        raise ValueError(f"no valid vector of refined means from which to make {name}")

    return [
        bad("chunk-box-coarse", "a box of the refined means alone", refine=True),
        bad("chunk-box-refined", "a box of the coarse means alone", refine=False),
    ]


def decoded_sizes() -> list[Invalid]:
    """Return the vector whose extra attributes alone exceed the decoded-size limit (SPEC 9.2)."""
    rows, attributes, components = 1 << 18, 2, 16
    entries: list[Value] = [
        {"name": f"wide {i}", "type": "f8", "components": components} for i in range(attributes)
    ]
    head = pack_streams(handmade.uniform_head(rows))
    columns = [bytes(rows)] * (8 * components * attributes)
    data = build(with_attributes(one_chunk(head, rows), entries, [store_planes(columns)]))
    note = "attributes of 256 bytes a splat, in a file of a few kilobytes"
    return [Invalid("decoded-size-attributes", data, "decoded-size", "9.2", note, "decode")]
