"""Rows of the segments of one index, by chunk and by kind, with the checks of SPEC 5.

In all functions `name` is the file, named in messages, and `index` the root or page. Rows are
numbers of segments in the whole file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from . import layout
from .description import PICTURES
from .drawn_chunks import later_levels
from .index_tables import SegmentTable
from .layout import SegmentKind
from .page_tree import Index
from .root import Root

I64 = NDArray[np.int64]

CHUNK_KINDS: Final = (
    SegmentKind.HEAD,
    SegmentKind.REFINEMENT,
    SegmentKind.TAIL,
    SegmentKind.OPACITIES,
    SegmentKind.ATTRIBUTES,
)
"""Kinds of segments that belong to one chunk (SPEC 5.2)."""


@dataclass(frozen=True, eq=False)
class IndexRows:
    """Rows of the segments of one index; -1 stands for a segment that the index does not list.

    Parameters
    ----------
    heads, tails, refinements, attributes : (c,) int64
        Row of each chunk's head, tail, refinement and extra attributes, for the index's own chunks.
    opacities : mapping of int to sequence of int
        Rows of the opacity segments by chunk number, in level order.
    codebooks : sequence of mapping of SegmentKind to int
        Rows of each codebook's segments, by kind; empty in a page.
    cameras, view_table, description : int
        Row of the cameras, of the view table and of the description.
    layers : sequence of int
        Rows of the compensation layers, in order.
    pictures : mapping of str to int
        Rows of the pictures, by name.
    """

    heads: I64
    tails: I64
    refinements: I64
    attributes: I64
    opacities: Mapping[int, Sequence[int]]
    codebooks: Sequence[Mapping[SegmentKind, int]]
    cameras: int
    layers: Sequence[int]
    view_table: int
    description: int
    pictures: Mapping[str, int]


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


def find_rows(name: str, root: Root, index: Index) -> IndexRows:
    """Check the segments and chunks of an index in the order of SPEC 8.1, and return their rows.

    Raises
    ------
    FormatError
        ``chunk-heads``, ``chunk-tails``, ``chunk-refinements``, ``chunk-opacities``,
        ``chunk-until``, ``needs-range``, ``codebook-segments``, ``attribute-segments``,
        ``camera-segments``, ``compensation-segments``, ``view-table-segments``,
        ``description-segments``.
    """
    heads = _head_rows(name, index)
    tails = _tail_rows(name, root, index, heads)
    refinements = _refinement_rows(name, index, heads)
    opacities = _opacity_rows(name, root, index, heads)
    _check_ends(name, root, index)
    _check_needs(name, root, index)
    return IndexRows(
        heads=heads,
        tails=tails,
        refinements=refinements,
        opacities=opacities,
        codebooks=_codebook_rows(name, root, index),
        attributes=_attribute_rows(name, root, index, heads),
        cameras=_camera_row(name, index),
        layers=_layer_rows(name, index),
        view_table=_view_table_row(name, index),
        description=_description_row(name, index),
        pictures=_picture_rows(name, root, index),
    )


def _rows_of(index: Index, kind: SegmentKind) -> I64:
    """Return the rows of a kind within the segment table of the index."""
    return np.flatnonzero(index.tables.segments.kind == kind).astype(np.int64)


def _head_rows(name: str, index: Index) -> I64:
    """Return the row of each chunk's head (SPEC 5.4)."""
    rows = _rows_of(index, SegmentKind.HEAD)
    owners = index.tables.segments.owner[rows].astype(np.int64)
    chunks = len(index.tables.chunks)
    if not np.array_equal(owners, index.first_chunk + np.arange(chunks)):
        raise FormatError(
            "chunk-heads",
            f"{name}: an index with heads of chunks {owners.tolist()[:8]} …, expected those of its "
            f"{chunks} chunks from chunk {index.first_chunk} on, in order",
            clause="5.4",
        )
    heads: I64 = rows + index.first_segment
    return heads


def _tail_rows(name: str, root: Root, index: Index, heads: I64) -> I64:
    """Return the row of each chunk's tail (SPEC 5.4); -1 for none."""
    if root.sh_degree == 0 and len(_rows_of(index, SegmentKind.TAIL)):
        raise FormatError(
            "chunk-tails",
            f"{name}: a tail in a scene of SH degree 0, expected none",
            clause="5.4",
        )
    return _rows_by_chunk(
        name,
        index,
        heads,
        SegmentKind.TAIL,
        lambda message: FormatError("chunk-tails", message, clause="5.4"),
    )


def _refinement_rows(name: str, index: Index, heads: I64) -> I64:
    """Return the row of each chunk's refinement (SPEC 5.4); -1 for none."""
    return _rows_by_chunk(
        name,
        index,
        heads,
        SegmentKind.REFINEMENT,
        lambda message: FormatError("chunk-refinements", message, clause="5.4"),
    )


def _opacity_rows(name: str, root: Root, index: Index, heads: I64) -> dict[int, list[int]]:
    """Return the rows of each chunk's opacity segments (SPEC 5.11)."""
    rows = _rows_of(index, SegmentKind.OPACITIES)
    own = _own_chunks(index, rows)
    known = _are_behind_heads(index, rows, own, heads)
    if known and len(rows):
        later = later_levels(root.levels, index.tables.chunks, index.first_chunk)
        known = bool((np.bincount(own, minlength=len(heads)) <= later).all())
    if not known:
        raise FormatError(
            "chunk-opacities",
            f"{name}: opacity segments of chunks {(own + index.first_chunk).tolist()[:8]}, "
            f"expected at most one per later level that draws one of {len(heads)} chunks of the "
            "index, behind its head",
            clause="5.11",
        )
    found: dict[int, list[int]] = {}
    for row, chunk in zip(rows.tolist(), own.tolist(), strict=True):
        found.setdefault(chunk + index.first_chunk, []).append(row + index.first_segment)
    return found


def _attribute_rows(name: str, root: Root, index: Index, heads: I64) -> I64:
    """Return the row of each chunk's extra attributes (SPEC 5.7); -1 for none."""
    if not root.attributes and len(_rows_of(index, SegmentKind.ATTRIBUTES)):
        raise FormatError(
            "attribute-segments",
            f"{name}: a segment of attributes, expected none: the root lists no attributes",
            clause="5.7",
        )
    return _rows_by_chunk(
        name,
        index,
        heads,
        SegmentKind.ATTRIBUTES,
        lambda message: FormatError("attribute-segments", message, clause="5.7"),
    )


def _own_chunks(index: Index, rows: I64) -> I64:
    """Return the owner of each row, counted from the first chunk of the index."""
    own: I64 = index.tables.segments.owner[rows].astype(np.int64) - index.first_chunk
    return own


def _are_behind_heads(index: Index, rows: I64, own: I64, heads: I64) -> bool:
    """Whether each row is one of a chunk of the index, behind the chunk's head."""
    if not ((own >= 0) & (own < len(heads))).all():
        return False
    return bool((heads[own] - index.first_segment < rows).all())


def _rows_by_chunk(
    name: str,
    index: Index,
    heads: I64,
    kind: SegmentKind,
    refusal: Callable[[str], FormatError],
) -> I64:
    """Return the row of each chunk's segment of a kind, -1 for none; raise the error if misplaced.

    `refusal` returns the error to raise, from a description.
    """
    rows = _rows_of(index, kind)
    own = _own_chunks(index, rows)
    if len(np.unique(own)) != len(own) or not _are_behind_heads(index, rows, own, heads):
        raise refusal(
            f"{name}: {kind.name.lower()} segments of chunks "
            f"{(own + index.first_chunk).tolist()[:8]}, expected at most one for each of "
            f"{len(heads)} chunks of the index, behind its head"
        )
    found = np.full(len(heads), -1, np.int64)
    found[own] = rows + index.first_segment
    return found


def _check_ends(name: str, root: Root, index: Index) -> None:
    """Refuse a nonzero `until` outside the chunks behind its own (SPEC 5.10)."""
    all_chunks = root.tables.extent.chunks
    until = index.tables.chunks.until.astype(np.int64)
    numbers = np.arange(len(until)) + index.first_chunk
    wrong = np.flatnonzero((until > 0) & ((until < numbers + 2) | (until > all_chunks)))
    if len(wrong):
        chunk = int(numbers[wrong[0]])
        raise FormatError(
            "chunk-until",
            f"{name}: chunk {chunk}: until is {until[wrong[0]]}, expected 0 or {chunk + 2} to "
            f"{all_chunks}",
            clause="5.10",
        )


def _check_needs(name: str, root: Root, index: Index) -> None:
    """Refuse a segment that needs a codebook which the root does not list (SPEC 5.3)."""
    books = len(root.codebooks)
    needs = index.tables.segments.needs
    if len(needs) and int(needs.max()) >> books:
        raise FormatError(
            "needs-range",
            f"{name}: a segment needs codebook {int(needs.max()).bit_length() - 1}, expected a "
            f"number below {books}",
            clause="5.3",
        )


def _codebook_rows(name: str, root: Root, index: Index) -> list[dict[SegmentKind, int]]:
    """Return the rows of each codebook's segments by kind, which the root lists (SPEC 5.5)."""
    table = index.tables.segments

    def refuse(message: str) -> FormatError:
        return FormatError("codebook-segments", f"{name}: {message}", clause="5.5")

    rows = np.flatnonzero(np.isin(table.kind, layout.CODEBOOK_KINDS)).tolist()
    if index.path:
        if rows:
            raise refuse("a codebook in a page, expected it in the root")
        return []
    found: list[dict[SegmentKind, int]] = [{} for _ in root.codebooks]
    expected = [codebook_kinds(entry.attribute, root.sh_degree) for entry in root.codebooks]
    for row in rows:
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
        if missing:
            raise refuse(f"codebook {number}: no {missing}, expected one each")
    return found


def _camera_row(name: str, index: Index) -> int:
    """Return the row of the cameras' segment, which the root lists (SPEC 5.8); -1 for none."""
    row, owners = _single_row(index, SegmentKind.CAMERAS)
    if owners or (row >= 0 and index.path):
        raise FormatError(
            "camera-segments",
            f"{name}: cameras with owners {owners}, in a page or twice, expected at most one "
            "segment, with owner 0, in the root",
            clause="5.8",
        )
    return row


def _view_table_row(name: str, index: Index) -> int:
    """Return the row of the view table of the index (SPEC 5.12); -1 for none."""
    row, owners = _single_row(index, SegmentKind.VIEW_TABLE)
    if owners:
        raise FormatError(
            "view-table-segments",
            f"{name}: view tables with owners {owners}, expected at most one segment in an index, "
            "with owner 0",
            clause="5.12",
        )
    return row


def _single_row(index: Index, kind: SegmentKind) -> tuple[int, list[int]]:
    """Return the row of the only segment of a kind, -1 for none, and its owners if misplaced.

    The list of owners is empty if there is at most one such segment, with owner 0.
    """
    rows = _rows_of(index, kind)
    owners = index.tables.segments.owner[rows]
    strange = owners.tolist()[:8] if len(rows) > 1 or owners.any() else []
    return (int(rows[0]) + index.first_segment if len(rows) else -1), strange


def _description_row(name: str, index: Index) -> int:
    """Return the row of the description's segment (SPEC 5.13); -1 for none."""
    row, owners = _single_row(index, SegmentKind.DESCRIPTION)
    if owners or (row >= 0 and index.path):
        raise _description_error(name, f"descriptions with owners {owners}, in a page or twice")
    if row >= 0 and _largest(index.tables.segments, row) > layout.MAX_DESCRIPTION_BYTES:
        raise _description_error(name, "a longer description")
    return row


def _picture_rows(name: str, root: Root, index: Index) -> dict[str, int]:
    """Return the rows of the pictures' segments by name (SPEC 5.14)."""
    table = index.tables.segments
    rows = _rows_of(index, SegmentKind.PICTURE)
    owners = table.owner[rows].tolist()
    described = SegmentKind.DESCRIPTION in root.segments.kind
    strange = len(set(owners)) < len(owners) or any(x >= len(PICTURES) for x in owners)
    if strange or (len(rows) and not (index.lists_pictures and described)):
        raise _description_error(name, f"pictures with owners {owners[:8]}")
    if len(rows) and _largest(table, rows) > layout.MAX_PICTURE_BYTES:
        raise _description_error(name, "a longer picture")
    pairs = sorted(zip(owners, rows.tolist(), strict=True))
    return {PICTURES[owner]: row + index.first_segment for owner, row in pairs}


def _largest(table: SegmentTable, rows: I64 | int) -> int:
    """Return the length of the longest of some segments, bytes."""
    return int(np.max(table.length[rows]))


def _description_error(name: str, found: str) -> FormatError:
    """Return the error for a misplaced description or picture."""
    return FormatError(
        "description-segments",
        f"{name}: {found}, expected at most one description of owner 0 in the root, of at "
        f"most {layout.MAX_DESCRIPTION_BYTES} bytes, and with it one poster and one sky in the "
        f"last page of the root, of at most {layout.MAX_PICTURE_BYTES} bytes",
        clause="5.13",
    )


def _layer_rows(name: str, index: Index) -> list[int]:
    """Return the rows of the compensation layers' segments, which the root lists (SPEC 5.9)."""
    rows = _rows_of(index, SegmentKind.COMPENSATION)
    owners = index.tables.segments.owner[rows]
    if not np.array_equal(owners, np.arange(len(rows))) or (len(rows) and index.path):
        raise FormatError(
            "compensation-segments",
            f"{name}: layers {owners.tolist()[:8]}, expected each once, in order, in the root",
            clause="5.9",
        )
    return [int(row) for row in rows]
