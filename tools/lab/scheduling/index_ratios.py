"""Ratios of rows and gains of units below a tree of pages (docs/streaming.md, 4, 7)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.segments.view_shares import ViewTable
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.page_tree import Index

from .chunk_ratios import (
    MIN_AVERAGE_SHARE,
    MIN_RATIO,
    PoseValues,
    ordered_sum,
    ratios_of_sums,
    visibility_of_boxes,
    visibility_of_view_table,
)
from .poses import Pose

F64 = NDArray[np.float64]

Path = tuple[int, ...]


class IndexRatios:
    """Ratios of the chunks and pages of all indices of a file.

    Parameters
    ----------
    indices : sequence of Index
        All indices in file order.
    tables : mapping of tuple of int to ViewTable
        View table of each index that has one, by its path.
    """

    def __init__(self, indices: Sequence[Index], tables: Mapping[Path, ViewTable]) -> None:
        self._indices, self._tables = indices, tables
        # Contributions of the chunks and then the pages that each index lists.
        self._contributions: list[F64] = [
            np.concatenate([index.tables.chunks.contribution, index.tables.pages.contribution])
            for index in indices
        ]
        self._known: dict[tuple[Path, bool], PoseValues] = {}

    def at(
        self,
        pose: Pose,
        arrived: Collection[Path] | None = None,
        read: Collection[Path] | None = None,
    ) -> F64:
        """Return the ratio of each row of `scene_rows.SceneRows` at a pose, (r,) float64.

        Shares are among the chunks of the indices that are read and the pages that are not.

        Parameters
        ----------
        pose : Pose
        arrived : collection of tuple of int, optional
            Indices whose tables have arrived; for others, boxes are used. By default all.
        read : collection of tuple of int, optional
            Indices that the client has read; rows that others list have `MIN_RATIO`. By default
            all.
        """
        known_rows = [self._known_rows(index, read) for index in self._indices]
        whole = 0.0
        for contribution, known in zip(self._contributions, known_rows, strict=True):
            if known is not None:
                whole += ordered_sum(contribution[known])
        visible: list[F64 | None] = []
        all_visible = 0.0
        for index, contribution, known in zip(
            self._indices, self._contributions, known_rows, strict=True
        ):
            if known is None:
                visible.append(None)
                continue
            has_table = index.path in self._tables and (arrived is None or index.path in arrived)
            values = self._visibility(index, contribution, has_table)(pose)
            if not has_table:
                # Contributions, as shares like those of view tables.
                values = values / (whole or 1.0)
            all_visible += ordered_sum(values[known])
            visible.append(values)
        chunks: list[F64] = []
        pages: list[F64] = []
        for index, contribution, seen in zip(
            self._indices, self._contributions, visible, strict=True
        ):
            ratios = (
                np.full(len(contribution), MIN_RATIO)
                if seen is None
                else ratios_of_sums(seen, contribution, all_visible, whole)
            )
            chunks.append(ratios[: len(index.tables.chunks)])
            pages.append(ratios[len(index.tables.chunks) :])
        return np.concatenate([*chunks, *pages])

    @staticmethod
    def _known_rows(index: Index, read: Collection[Path] | None) -> NDArray[np.bool_] | None:
        """Return the mask of the chunks and unread pages of an index; None for an unread index.

        The rows of read pages are left out of sums: what such a page lists is counted instead.
        """
        if read is not None and index.path not in read:
            return None
        known = np.ones(len(index.tables.chunks) + len(index.tables.pages), np.bool_)
        for row in range(len(index.tables.pages)):
            known[len(index.tables.chunks) + row] = (
                read is not None and (*index.path, row) not in read
            )
        return known

    def _visibility(self, index: Index, contribution: F64, has_table: bool) -> PoseValues:
        """Return the visibility function of the chunks and then the pages that an index lists."""
        key = index.path, has_table
        if key not in self._known:
            chunks, pages = index.tables.chunks, index.tables.pages
            boxes = np.concatenate([chunks.box, pages.box]).astype(np.float64)
            self._known[key] = (
                visibility_of_view_table(self._tables[index.path], boxes, contribution)
                if has_table
                else visibility_of_boxes(boxes, contribution)
            )
        return self._known[key]


def unit_gains(indices: Sequence[Index]) -> tuple[F64, F64]:
    """Return the gain of each segment and of each page (docs/streaming.md, 7).

    Parameters
    ----------
    indices : sequence of Index
        All indices in file order.

    Returns
    -------
    segments, pages : (s,) float64, (p,) float64
        Gain of each segment and of each page, in the order of the file, in the unit of
        contributions.
    """
    root = indices[0].tables
    contributions = np.concatenate([root.chunks.contribution, root.pages.contribution])
    picture = ordered_sum(contributions) or 1.0
    segments = [_segment_gains(index, picture) for index in indices]
    pages = [
        np.maximum(index.tables.pages.contribution, MIN_AVERAGE_SHARE * picture)
        for index in indices
    ]
    return np.concatenate(segments), np.concatenate(pages)


def _segment_gains(index: Index, picture: float) -> F64:
    """Return the gains of the segments of an index; `picture` is the contribution of the root."""
    table = index.tables.segments
    lengths = table.length.astype(np.float64)
    begin = float(index.end - index.start)
    ends = begin + np.cumsum(lengths)
    gains = (
        _gains_in_page(index, ends, picture)
        if index.path
        else picture * (begin / ends) * (lengths / ends)
    )
    gains[table.kind == SegmentKind.VIEW_TABLE] = picture
    return gains


def _gains_in_page(index: Index, ends: F64, picture: float) -> F64:
    """Return the gains of the segments of a page, which end at `ends`, but for view tables."""
    contribution = np.maximum(index.tables.chunks.contribution, MIN_AVERAGE_SHARE * picture)
    table = index.tables.segments
    lengths = table.length.astype(np.float64)
    numbers = np.arange(len(table))
    is_head = table.kind == SegmentKind.HEAD
    heads = np.flatnonzero(is_head)
    chunk = table.owner.astype(np.int64) - index.first_chunk
    head_of = np.full(len(index.tables.chunks), -1)
    head_of[chunk[heads]] = heads
    of_chunk = np.isin(table.kind, (SegmentKind.REFINEMENT, SegmentKind.TAIL))
    # Segments of no chunk count like the chunk whose head precedes them.
    head = np.maximum.accumulate(np.where(is_head, numbers, -1))
    head[of_chunk] = head_of[chunk[of_chunk]]
    followers = np.flatnonzero(head >= 0)
    head = head[followers]
    closeness = ends[head] / ends[followers]
    sizes = lengths[followers] / lengths[head]
    gains = np.zeros(len(table))
    gains[followers] = contribution[chunk[head]] * sizes * (closeness * closeness)
    return gains
