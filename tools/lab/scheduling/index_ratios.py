"""Ratios of chunks and places of segments below a tree of pages (docs/streaming.md, 4, 7)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.segments.view_shares import ViewTable
from cogsplat.formats.cogs.page_tree import Index

from .chunk_ratios import MIN_RATIO, PoseRatios, ratios_from_boxes, ratios_from_view_table
from .poses import Pose

F64 = NDArray[np.float64]

# Least share of a page in the contribution of all pages of its index.
_LEAST_SHARE: Final = 1e-12


def index_ratios(
    indices: Sequence[Index], tables: Mapping[tuple[int, ...], ViewTable]
) -> PoseRatios:
    """Return the ratio function of the chunks of all indices of a file.

    Parameters
    ----------
    indices : sequence of Index
        All indices in file order.
    tables : mapping of tuple of int to ViewTable
        View table of each index that has one, by its path.

    Returns
    -------
    PoseRatios
        Ratio of each chunk: in its index, relative to all chunks and pages that the index lists,
        times the ratio of the page.
    """
    own = [_ratios_of(index, tables.get(index.path)) for index in indices]

    def ratios(pose: Pose) -> F64:
        found: list[F64] = []
        of_pages: dict[tuple[int, ...], float] = {}
        for index, ratios_at in zip(indices, own, strict=True):
            values = ratios_at(pose)
            if index.path:
                values = np.maximum(of_pages[index.path] * values, MIN_RATIO)
            chunks = len(index.tables.chunks)
            found.append(values[:chunks])
            for row, value in enumerate(values[chunks:].tolist()):
                of_pages[(*index.path, row)] = value
        return np.concatenate(found)

    return ratios


def _ratios_of(index: Index, table: ViewTable | None) -> PoseRatios:
    """Return the ratio function of the chunks and then the pages that an index lists."""
    chunks, pages = index.tables.chunks, index.tables.pages
    boxes = np.concatenate([chunks.box, pages.box]).astype(np.float64)
    contribution = np.concatenate([chunks.contribution, pages.contribution])
    if table is None:
        return ratios_from_boxes(boxes, contribution)
    return ratios_from_view_table(table, boxes, contribution)


def segment_places(indices: Sequence[Index]) -> F64:
    """Return the place of each segment: where it would end if pages arrived side by side.

    Parameters
    ----------
    indices : sequence of Index
        All indices in file order.

    Returns
    -------
    (s,) float64
        Bytes; of segments that the root lists, the offset behind the segment.
    """
    found: list[F64] = []
    # Place of each page's beginning, and the place that one of its bytes takes.
    frames: dict[tuple[int, ...], tuple[float, float]] = {(): (0.0, 1.0)}
    for index in indices:
        place, weight = frames[index.path]
        lengths = index.tables.segments.length.astype(np.float64)
        ends = float(index.end - index.start) + np.cumsum(lengths)
        found.append(place + weight * ends)
        behind = place + weight * float(index.segments_end - index.start)
        contributions = index.tables.pages.contribution.tolist()
        whole = sum(contributions)
        for row, contribution in enumerate(contributions):
            # Pages without contributions share alike.
            share = max(contribution, _LEAST_SHARE * whole)
            times = whole / share if whole > 0.0 else float(len(contributions))
            frames[(*index.path, row)] = behind, weight * times
    return np.concatenate(found)
