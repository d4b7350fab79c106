"""Ratios of rows and places of units below a tree of pages (docs/streaming.md, 4, 7)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.segments.view_shares import ViewTable
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.page_tree import Index

from .chunk_ratios import (
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

# Least share of a page in the contribution of all pages of its index.
_LEAST_SHARE: Final = 1e-12


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


def unit_places(indices: Sequence[Index]) -> tuple[F64, F64]:
    """Return the places of all segments and pages: where they would end if pages came in parallel.

    Parameters
    ----------
    indices : sequence of Index
        All indices in file order.

    Returns
    -------
    segments, pages : (s,) float64, (p,) float64
        Place of each segment and of each page, bytes, in the order of the file. The place of a
        segment that the root lists is the offset behind it. The place of a view table is its
        length, so that it is fetched first. Pages come before the segments of the index that lists
        them, because they may list most of what a picture shows.
    """
    segments: list[F64] = []
    pages: list[float] = []
    # Place of each page's beginning, and the place that one of its bytes takes.
    frames: dict[Path, tuple[float, float]] = {(): (0.0, 1.0)}
    for index in indices:
        place, weight = frames[index.path]
        lengths = index.tables.segments.length.astype(np.float64)
        ends = float(index.end - index.start) + np.cumsum(lengths)
        is_table = index.tables.segments.kind == SegmentKind.VIEW_TABLE
        segments.append(np.where(is_table, lengths, place + weight * ends))
        behind = place + weight * float(index.segments_end - index.start)
        table = index.tables.pages
        contributions = table.contribution.tolist()
        # Not `sum`, which compensates for rounding since Python 3.12.
        whole = ordered_sum(table.contribution.astype(np.float64))
        for row, contribution in enumerate(contributions):
            # Pages without contributions share alike.
            share = max(contribution, _LEAST_SHARE * whole)
            times = whole / share if whole > 0.0 else float(len(contributions))
            frames[(*index.path, row)] = behind, weight * times
            pages.append(place + weight * times * float(table.length[row]))
    return np.concatenate(segments), np.array(pages, np.float64)
