"""Rows of each chunk's and codebook's segments in the segment table, with the checks of SPEC 5.

In all functions `source` is the file, named in messages; `table` holds the segments of the root and
of the pages that were read; `heads` holds the row of each chunk's head, -1 where its page was not
read.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError
from cogsplat.formats.storage.source import Source

from . import layout
from .description import PICTURES
from .drawn_chunks import later_levels
from .layout import SegmentKind
from .root import ChunkTable, Root, SegmentTable

I64 = NDArray[np.int64]


def codebook_kinds(attribute: str, degree: int) -> tuple[SegmentKind, ...]:
    """Return the segment kinds of a codebook up to an SH degree (SPEC 5.5).

    Parameters
    ----------
    attribute : str
        ``shape`` or ``colour``.
    degree : int
        SH degree, 0 to 3.
    """
    return (SegmentKind.SHAPE_CODEBOOK,) if attribute == "shape" else layout.COLOUR_BANDS[:degree]


def head_rows(source: Source, table: SegmentTable, known: NDArray[np.bool_]) -> I64:
    """Return the segment row of each chunk's head (SPEC 5.4); -1 if its page was not read."""
    heads = np.flatnonzero(table.kind == SegmentKind.HEAD).astype(np.int64)
    if not np.array_equal(table.owner[heads], np.flatnonzero(known)):
        raise FormatError(
            "chunk-heads",
            f"{source.name}: heads of chunks {table.owner[heads].tolist()[:8]} …, expected those "
            "of all chunks in order",
            clause="5.4",
        )
    found = np.full(len(known), -1, np.int64)
    found[known] = heads
    return found


def tail_rows(source: Source, root: Root, table: SegmentTable, heads: I64) -> I64:
    """Return the segment row of each chunk's tail (SPEC 5.4); -1 for none."""
    if root.sh_degree == 0 and bool((table.kind == SegmentKind.TAIL).any()):
        raise FormatError(
            "chunk-tails",
            f"{source.name}: a tail in a scene of SH degree 0, expected none",
            clause="5.4",
        )
    return _rows_by_chunk(
        source,
        table,
        heads,
        SegmentKind.TAIL,
        lambda message: FormatError("chunk-tails", message, clause="5.4"),
    )


def refinement_rows(source: Source, table: SegmentTable, heads: I64) -> I64:
    """Return the segment row of each chunk's refinement (SPEC 5.4); -1 for none."""
    return _rows_by_chunk(
        source,
        table,
        heads,
        SegmentKind.REFINEMENT,
        lambda message: FormatError("chunk-refinements", message, clause="5.4"),
    )


def opacity_rows(
    source: Source, root: Root, table: SegmentTable, chunks: ChunkTable, heads: I64
) -> dict[int, list[int]]:
    """Return the rows of each chunk's opacity segments (SPEC 5.11)."""
    rows = np.flatnonzero(table.kind == SegmentKind.OPACITIES)
    owners = table.owner[rows].astype(np.int64)
    known = bool((owners < len(heads)).all()) and bool((heads[owners] < rows).all())
    if known and len(rows):
        later = later_levels(root.levels, chunks)
        known = bool((np.bincount(owners, minlength=len(heads)) <= later).all())
    if not known:
        raise FormatError(
            "chunk-opacities",
            f"{source.name}: opacity segments of chunks {owners.tolist()[:8]}, expected at most "
            f"one per later level that draws one of {len(heads)} chunks, behind its head",
            clause="5.11",
        )
    found: dict[int, list[int]] = {}
    for row, owner in zip(rows.tolist(), owners.tolist(), strict=True):
        found.setdefault(owner, []).append(row)
    return found


def attribute_rows(source: Source, root: Root, table: SegmentTable, heads: I64) -> I64:
    """Return the segment row of each chunk's extra attributes (SPEC 5.7); -1 for none."""
    if not root.attributes and bool((table.kind == SegmentKind.ATTRIBUTES).any()):
        raise FormatError(
            "attribute-segments",
            f"{source.name}: a segment of attributes, expected none: the root lists no attributes",
            clause="5.7",
        )
    return _rows_by_chunk(
        source,
        table,
        heads,
        SegmentKind.ATTRIBUTES,
        lambda message: FormatError("attribute-segments", message, clause="5.7"),
    )


def _rows_by_chunk(
    source: Source,
    table: SegmentTable,
    heads: I64,
    kind: SegmentKind,
    refusal: Callable[[str], FormatError],
) -> I64:
    """Return the row of each chunk's segment of a kind, -1 for none; raise the error if misplaced.

    `refusal` returns the error to raise, from a description.
    """
    rows = np.flatnonzero(table.kind == kind)
    owners = table.owner[rows]
    # The head comes first, so a chunk whose page was not read has no segment before that page.
    once = len(np.unique(owners)) == len(owners) and bool((owners < len(heads)).all())
    if not once or bool((heads[owners] > rows).any()):
        raise refusal(
            f"{source.name}: {kind.name.lower()} segments of chunks {owners.tolist()[:8]}, "
            f"expected at most one for each of {len(heads)} chunks, behind its head"
        )
    found = np.full(len(heads), -1, np.int64)
    found[owners] = rows
    return found


def camera_row(source: Source, table: SegmentTable) -> int:
    """Return the row of the cameras' segment (SPEC 5.8); -1 for none."""
    row, owners = _single_row(table, SegmentKind.CAMERAS)
    if owners:
        raise FormatError(
            "camera-segments",
            f"{source.name}: cameras with owners {owners}, expected at most one segment, with "
            "owner 0",
            clause="5.8",
        )
    return row


def view_table_row(source: Source, table: SegmentTable) -> int:
    """Return the row of the view table's segment (SPEC 5.12); -1 for none."""
    row, owners = _single_row(table, SegmentKind.VIEW_TABLE)
    if owners:
        raise FormatError(
            "view-table-segments",
            f"{source.name}: view tables with owners {owners}, expected at most one segment, with "
            "owner 0",
            clause="5.12",
        )
    return row


def _single_row(table: SegmentTable, kind: SegmentKind) -> tuple[int, list[int]]:
    """Return the row of the only segment of a kind, -1 for none, and its owners if misplaced.

    The list of owners is empty if there is at most one such segment, with owner 0.
    """
    rows = np.flatnonzero(table.kind == kind)
    owners = table.owner[rows]
    strange = owners.tolist()[:8] if len(rows) > 1 or owners.any() else []
    return (int(rows[0]) if len(rows) else -1), strange


def description_row(source: Source, root: Root, table: SegmentTable) -> int:
    """Return the row of the description's segment (SPEC 5.13); -1 for none."""
    row, owners = _single_row(table, SegmentKind.DESCRIPTION)
    if owners or row >= len(root.segments):
        raise _description_error(source, f"descriptions with owners {owners}, in a page or twice")
    if row >= 0 and table.length[row] > layout.MAX_DESCRIPTION_BYTES:
        raise _description_error(source, f"a description of {table.length[row]} bytes")
    return row


def picture_rows(source: Source, root: Root, table: SegmentTable) -> dict[str, int]:
    """Return the rows of the pictures' segments by name (SPEC 5.14)."""
    rows = np.flatnonzero(table.kind == SegmentKind.PICTURE)
    owners = table.owner[rows].tolist()
    # Rows of the last index, of which a partial file may lack all.
    earlier = [len(root.segments), *(page.segments for page in root.pages)][:-1]
    described = SegmentKind.DESCRIPTION in root.segments.kind
    strange = len(set(owners)) < len(owners) or any(x >= len(PICTURES) for x in owners)
    if strange or (len(rows) and (int(rows[0]) < sum(earlier) or not described)):
        raise _description_error(source, f"pictures with owners {owners[:8]}")
    if len(rows) and int(table.length[rows].max()) > layout.MAX_PICTURE_BYTES:
        raise _description_error(source, f"a picture of {table.length[rows].max()} bytes")
    return {PICTURES[owner]: row for row, owner in sorted(zip(rows.tolist(), owners, strict=True))}


def _description_error(source: Source, found: str) -> FormatError:
    """Return the error for a misplaced description or picture."""
    return FormatError(
        "description-segments",
        f"{source.name}: {found}, expected at most one description of owner 0 in the root, of at "
        f"most {layout.MAX_DESCRIPTION_BYTES} bytes, and with it one poster and one sky in the "
        f"last index, of at most {layout.MAX_PICTURE_BYTES} bytes",
        clause="5.13",
    )


def layer_rows(source: Source, table: SegmentTable) -> list[int]:
    """Return the rows of the compensation layers' segments (SPEC 5.9)."""
    rows = np.flatnonzero(table.kind == SegmentKind.COMPENSATION)
    owners = table.owner[rows]
    if not np.array_equal(owners, np.arange(len(rows))):
        raise FormatError(
            "compensation-segments",
            f"{source.name}: layers {owners.tolist()[:8]}, expected each once, in order",
            clause="5.9",
        )
    return [int(row) for row in rows]


def codebook_rows_by_kind(
    source: Source, root: Root, table: SegmentTable, *, whole: bool
) -> list[dict[SegmentKind, int]]:
    """Return the rows of each codebook's segments by kind (SPEC 5.5)."""
    found: list[dict[SegmentKind, int]] = [{} for _ in root.codebooks]

    def refuse(message: str) -> FormatError:
        return FormatError("codebook-segments", f"{source.name}: {message}", clause="5.5")

    expected = [codebook_kinds(entry.attribute, root.sh_degree) for entry in root.codebooks]
    for row in np.flatnonzero(np.isin(table.kind, layout.CODEBOOK_KINDS)).tolist():
        kind, owner = SegmentKind(int(table.kind[row])), int(table.owner[row])
        label = f"segment {row}, {kind.name.lower()} of codebook {owner}"
        if owner >= len(found):
            raise refuse(f"{label}: expected a codebook below {len(found)}")
        if kind not in expected[owner]:
            raise refuse(
                f"{label}: expected {[k.name.lower() for k in expected[owner]]} "
                f"for {root.codebooks[owner].attribute}"
            )
        if kind in found[owner]:
            raise refuse(f"{label}: a second one, expected one")
        found[owner][kind] = row
    for number, kinds in enumerate(expected):
        missing = [kind.name.lower() for kind in kinds if kind not in found[number]]
        if whole and missing:
            raise refuse(f"codebook {number}: no {missing}, expected one each")
    return found
