"""Join the files of neighbouring parts of a scene into one: `cogsplat.join`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.capture import merged_capture
from cogsplat.codec.errors import DataError
from cogsplat.codec.partition.chunk_tree import ROOT_CHUNKS, chunk_tree
from cogsplat.codec.partition.nested_cells import WHOLE
from cogsplat.codec.partition.part_cells import cell_within, part_cells
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.segments.joined_compensation import join_compensations, layers_of_chunks
from cogsplat.formats.storage.atomic import StrPath, atomic_write, check_output
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.pieced_source import Piece, whole_piece
from cogsplat.formats.storage.source import Source

from . import layout
from .camera_segment import pack_cameras
from .compensation_segment import pack_layer
from .description_segment import pack_segments
from .folder_writer import copy_cogs
from .index_tables import ChunkTable, SegmentTable
from .joined_view_tables import measure_joined_table, part_view_table
from .layout import SegmentKind
from .open_file import open_source
from .packing import folder_files
from .reader import CogsFile, open_cogs
from .root import Root
from .segment_rows import CHUNK_KINDS, codebook_kinds
from .view_table_segment import pack_view_table
from .writer import (
    IndexPlan,
    Segment,
    box_around,
    laid_out_source,
    lay_out_index,
    plan_index,
    segment_table,
    table_of_index,
)

I64 = NDArray[np.int64]

_CODE: Final = "cannot-join"

_BOOK_KINDS: Final = (SegmentKind.SHAPE_CODEBOOK, *layout.COLOUR_BANDS)


@dataclass(frozen=True)
class Joined:
    """Result of `join`.

    Parameters
    ----------
    path : Path
        Written file.
    size_bytes : int
        Its length, bytes.
    parts : int
        Number of parts.
    sh_degree : int
        SH degree of the file.
    splats, chunks : int
        Numbers of its splats and chunks.
    """

    path: Path
    size_bytes: int
    parts: int
    sh_degree: int
    splats: int
    chunks: int


def join(
    paths: Sequence[StrPath],
    output: StrPath,
    *,
    force: bool = False,
    limits: Limits | None = None,
    progress: Progress = silent,
) -> Joined:
    """Join COGS files of neighbouring parts of a scene into one file with a new index.

    Heads, refinements, tails and codebooks keep their bytes; the index is made anew, so that a
    client at one place reads the pages of what is around it. Left out are predicted qualities, and
    layers of compensation that are too long or that not all parts have. To replace a part, encode
    it again and join all files again.

    What parts hide of each other is measured in pictures from up to 64 viewpoints of their view
    tables, of the first chunks of all parts, about half a million splats together. From these come
    the view tables of the root and of pages with chunks of several parts below (SPEC 5.12).

    Parameters
    ----------
    paths : sequence of path
        Files or folders of the parts, with means in one space. First view, direction against
        gravity and description are those of the first.
    output : path
        New file.
    force : bool
        Whether to replace an existing file.
    limits : Limits, optional
        Memory and size limits.
    progress : Progress
        Callback, called with ``("view table", views done, views)`` and ``("pack", segments done,
        segments)``.

    Raises
    ------
    DataError
        ``cannot-join``: the files differ in SH degree, frame, colours, attributes or codebooks
        (encode the others with the codebook of one of them, `EncodeRequest.basis`), or have
        levels or preview splats. ``root-size``, ``too-many-cameras``.
    CogsplatError
        A part cannot be read, or the output cannot be written.
    ValueError
        No path.

    Examples
    --------
    >>> import cogsplat
    >>> cogsplat.join(["scene.cogs", "scene.cogs"], "twice.cogs").parts
    2
    """
    if not paths:
        raise ValueError("no files, expected those of one part or more")
    target = Path(output)
    given = [file for path in paths for file in folder_files(Path(path))]
    check_output(target, force=force, inputs=given)
    with ExitStack() as stack:
        files = [
            stack.enter_context(open_cogs(open_source(Path(path)), limits=limits)) for path in paths
        ]
        source = joined_source(files, target.name, progress=progress)
        with open_cogs(source, limits=limits) as whole:
            chunks, splats = whole.num_chunks, int(whole.root.splats)
            with atomic_write(target, force=force) as out:
                copy_cogs(whole, out, progress=progress)
                # Windows replaces no file that is open.
                stack.close()
    return Joined(target, source.size, len(files), files[0].root.sh_degree, splats, chunks)


def joined_source(files: Sequence[CogsFile], name: str, *, progress: Progress = silent) -> Source:
    """Return the joined file as a source.

    Parameters
    ----------
    files : sequence of CogsFile
        Open files of the parts; keep them open as long as the source.
    name : str
        Name of the source in messages.
    progress : Progress
        Called with the stage ``view table``.

    Raises
    ------
    DataError
        ``cannot-join``, ``root-size``, ``too-many-cameras``.
    """
    joint = _Joint(files)
    plan = plan_index(joint.root, joint.table, joint.parts)
    joint.sort_rows(plan)
    added = [*joint.added, *_add_view_tables(joint, plan, progress)]
    table = SegmentTable.concatenate([joint.table, segment_table(added[len(joint.added) :])])
    kept = len(joint.rows)

    def piece_of(row: int) -> Piece:
        if row >= kept:
            return whole_piece(added[row - kept].payload)
        part, own = joint.rows[row].tolist()
        file = files[part]
        return Piece(file.source, int(file.offsets[own]), int(file.segments.length[own]))

    return laid_out_source(name, lay_out_index(joint.root, table, plan), piece_of)


class _Joint:
    """Root, chunks and segments of the joined file."""

    def __init__(self, files: Sequence[CogsFile]) -> None:
        self.files = files
        _require_alike(files)
        compensations = [file.compensation() for file in files]
        cells = self._cells()
        chunks = ChunkTable.concatenate([self._chunks(file) for file in files])
        ranks = np.concatenate([_ranks(file) for file in files])
        layers = np.concatenate([layers_of_chunks(each) for each in compensations])
        least = min(len(each.layers) for each in compensations)
        density = chunks.contribution / chunks.splats
        # What a first layer shows of every part comes first, then what the next layer adds.
        order = np.lexsort((-density, ranks, np.minimum(layers, least)))
        counts = [file.num_chunks for file in files]
        parts = np.repeat(np.arange(len(files)), counts)
        tree = order[chunk_tree(cells[order], parts[order]).order()]
        numbers = np.empty(len(tree), np.int64)
        numbers[tree] = np.arange(len(tree))
        self.numbers: list[I64] = np.split(numbers, np.cumsum(counts)[:-1])
        # Rank of each chunk in `order`, by its new number.
        self.turns: I64 = np.argsort(order)[tree]
        self.parts: I64 = parts[tree]
        self.chunks: ChunkTable = replace(chunks, cell=cells.astype(np.uint32)).take(tree)
        self.compensation = join_compensations(compensations, self.numbers, ROOT_CHUNKS)
        self.rows, own = self._segments()
        self.added = self._added()
        self.table: SegmentTable = SegmentTable.concatenate([own, segment_table(self.added)])

    @cached_property
    def root(self) -> Root:
        """Root of the joined file, still with segments and pages of the first part."""
        first = self.files[0].root
        capture = merged_capture([file.root.info.capture for file in self.files])
        boxes = np.array([file.root.box for file in self.files if file.root.splats]).reshape(-1, 6)
        splats = sum(int(file.root.splats) for file in self.files)
        if splats > layout.MAX_SPLATS:
            raise DataError(_CODE, f"{splats} splats, expected at most {layout.MAX_SPLATS}")
        cores = [file.root.core_box for file in self.files if file.root.splats]
        known = [core for core in cores if core is not None]
        return replace(
            first,
            splats=splats,
            info=replace(first.info, capture=capture),
            box=box_around(boxes) if len(boxes) else first.box,
            core_box=box_around(np.array(known)) if known and len(known) == len(cores) else None,
            chunks=self.chunks,
        )

    def _cells(self) -> I64:
        """Return the cell of each part's chunks in the joined file."""
        roots = [file.root for file in self.files]
        boxes = [root.box if root.core_box is None else root.core_box for root in roots]
        places = part_cells(np.array(boxes).reshape(-1, 6))
        return np.concatenate(
            [
                [cell_within(place, max(cell, WHOLE)) for cell in file.chunks.cell.tolist()]
                for place, file in zip(places, self.files, strict=True)
            ]
        ).astype(np.int64)

    @staticmethod
    def _chunks(file: CogsFile) -> ChunkTable:
        """Return a part's chunks with comparable contributions and without predictions.

        Parts are scored in views of their own, so contributions are scaled to a mean of 1 for each
        splat. What was predicted for prefixes of the part is not true of the joined file.
        """
        table = file.chunks
        whole = float(table.contribution.sum())
        factor = float(table.splats.sum()) / whole if whole else 1.0
        return replace(
            table,
            contribution=table.contribution * factor,
            quality=np.zeros_like(table.quality),
        )

    def _segments(self) -> tuple[I64, SegmentTable]:
        """Return part and row of each segment that is kept, and their table, part by part."""
        places: list[I64] = []
        tables: list[SegmentTable] = []
        for part, file in enumerate(self.files):
            kinds = _BOOK_KINDS + CHUNK_KINDS if part == 0 else CHUNK_KINDS
            rows = np.flatnonzero(np.isin(file.segments.kind, kinds))
            kept = file.segments.take(rows)
            owner = kept.owner.copy()
            of_chunk = np.isin(kept.kind, CHUNK_KINDS)
            owner[of_chunk] = self.numbers[part][owner[of_chunk]]
            tables.append(replace(kept, owner=owner))
            places.append(np.stack([np.full(len(rows), part), rows], axis=1))
        return np.concatenate(places), SegmentTable.concatenate(tables)

    def sort_rows(self, plan: IndexPlan) -> None:
        """Sort the segments of each index: each behind the head that it follows in its part.

        Codebooks come before the first tail, and a layer of compensation before the head of the
        first chunk that it adds.
        """
        places: list[float] = [0.0] * len(self.table)
        behind = [self.numbers[part][_last_heads(file)] for part, file in enumerate(self.files)]
        kinds, owners = self.table.kind.tolist(), self.table.owner.tolist()
        firsts = [0, *(layer.chunks for layer in self.compensation.layers)]
        for index in plan.every():
            own = index.chunks
            # Greatest turn of the index's chunks up to each of them.
            peaks = np.maximum.accumulate(self.turns[own])
            for row in index.rows:
                kind = kinds[row]
                if kind == SegmentKind.COMPENSATION:
                    places[row] = firsts[owners[row]] - 0.5
                elif kind == SegmentKind.HEAD:
                    places[row] = owners[row]
                elif kind in CHUNK_KINDS:
                    part, segment = self.rows[row].tolist()
                    turn = self.turns[behind[part][segment]]
                    last = own.start + int(np.searchsorted(peaks, turn, side="right")) - 1
                    places[row] = max(last, owners[row]) + 0.5
                elif kind not in _BOOK_KINDS:
                    places[row] = np.inf
            tails = [places[row] for row in index.rows if kinds[row] == SegmentKind.TAIL]
            for row in index.rows:
                if kinds[row] in _BOOK_KINDS:
                    places[row] = min(tails, default=own.start) - 0.25
            index.rows.sort(key=lambda row: (places[row], row))

    def _added(self) -> list[Segment]:
        """Return the new segments: compensation, cameras, description and pictures."""
        added = [
            Segment(SegmentKind.COMPENSATION, number, pack_layer(layer))
            for number, layer in enumerate(self.compensation.layers)
        ]
        cameras: dict[bytes, Camera] = {}
        for file in self.files:
            for camera in file.cameras():
                cameras.setdefault(pack_cameras([camera]), camera)
        if cameras:
            added.append(Segment(SegmentKind.CAMERAS, 0, pack_cameras(list(cameras.values()))))
        return [*added, *pack_segments(self.files[0].description(pictures=True))]


def _add_view_tables(joint: _Joint, plan: IndexPlan, progress: Progress) -> list[Segment]:
    """Add a view table to each index, where the parts below it have any; return the tables.

    An index with a single part below has the viewpoints of that part, others have viewpoints of all
    parts.
    """
    tables = [part_view_table(file) for file in joint.files]
    below = [(index, np.unique(joint.parts[index.chunks_below()])) for index in plan.every()]
    of_all = None
    if any(len(parts) > 1 for _, parts in below):
        contribution = joint.chunks.contribution.astype(np.float64)
        of_all = measure_joined_table(
            joint.files, tables, joint.parts, contribution, progress=progress
        )
    every = np.arange(len(joint.parts))
    in_part = np.empty_like(every)
    for numbers in joint.numbers:
        in_part[numbers] = np.arange(len(numbers))
    segments: list[Segment] = []
    for index, parts in below:
        is_single = len(parts) == 1
        table = tables[parts[0]] if is_single else of_all
        if table is None:
            continue
        index.rows.insert(0, len(joint.table) + len(segments))
        columns = in_part if is_single else every
        pages = [columns[page.chunks_below()] for page in index.pages]
        own = table_of_index(table, columns[index.chunks], pages)
        segments.append(Segment(SegmentKind.VIEW_TABLE, 0, pack_view_table(own)))
    return segments


def _require_alike(files: Sequence[CogsFile]) -> None:
    """Refuse files that one root cannot describe."""
    first, books = files[0].root, _codebooks(files[0])
    for file in files:
        root = file.root
        if file.missing_bytes:
            raise DataError(_CODE, f"{file.name}: {file.missing_bytes} bytes are missing")
        if root.levels or file.chunks.until.any():
            raise DataError(_CODE, f"{file.name}: has levels or preview splats, expected neither")
        for what, one, other in (
            ("SH degree", root.sh_degree, first.sh_degree),
            ("scene", _conventions(root), _conventions(first)),
            ("attributes", _attributes(root), _attributes(first)),
        ):
            if one != other:
                raise DataError(
                    _CODE, f"{file.name}: {what} {one}, expected {other} as in {files[0].name}"
                )
        if _codebooks(file) != books:
            raise DataError(
                _CODE,
                f"{file.name}: has other codebooks than {files[0].name}, expected the same: encode "
                f"it with --basis-of {files[0].name}",
            )


def _conventions(root: Root) -> str:
    """Return the conventions of a scene that all parts share, as text."""
    info = root.info
    kind = "antialiased" if info.antialiased else f"kernel {info.kernel_px:g} px"
    origin = ", ".join(f"{value:.17g}" for value in info.origin)
    return f"with origin {origin}, axes {info.axes}, colours {info.colour_space}, {kind}"


def _attributes(root: Root) -> str:
    """Return names and types of a scene's attributes as text."""
    found = [f"{kind.name} {kind.dtype}×{kind.components}" for kind in root.attributes]
    return ", ".join(found) or "none"


def _codebooks(file: CogsFile) -> list[tuple[str, int, bytes]]:
    """Return attribute, number of rows and hashes of each codebook."""
    found = []
    for number, entry in enumerate(file.root.codebooks):
        kinds = codebook_kinds(entry.attribute, file.root.sh_degree)
        rows = [row for kind in kinds for row in file.segment_rows(kind, number)]
        found.append((entry.attribute, entry.rows, file.segments.hash[rows].tobytes()))
    return found


def _ranks(file: CogsFile) -> I64:
    """Return the number of chunks before each chunk, (c,) int64.

    It counts the chunks of the indices above, and those before the chunk in its own index.
    """
    above: dict[tuple[int, ...], int] = {}
    found: list[I64] = []
    for index in file.indices:
        before = above.get(index.path[:-1], 0) if index.path else 0
        count = len(index.tables.chunks)
        above[index.path] = before + count
        found.append(before + np.arange(count))
    return np.concatenate(found)


def _last_heads(file: CogsFile) -> I64:
    """Return the chunk whose head is the last before each segment, (s,) int64.

    The search is in the index of the segment: before the first head, the index's first chunk.
    """
    found: list[I64] = []
    for index in file.indices:
        heads = np.cumsum(index.tables.segments.kind == SegmentKind.HEAD)
        last = max(index.first_chunk + len(index.tables.chunks) - 1, 0)
        found.append(np.minimum(index.first_chunk + np.maximum(heads - 1, 0), last))
    return np.concatenate(found).astype(np.int64)
