"""Rows of the tables of an index: taken from one, and of several behind each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .index_tables import ChunkTable, SegmentTable

Table = TypeVar("Table", SegmentTable, ChunkTable)


def take(table: Table, rows: slice | Sequence[int] | NDArray[np.integer]) -> Table:
    """Return rows of a segment or chunk table.

    Examples
    --------
    >>> from cogsplat.formats.cogs.index_tables import no_segments
    >>> len(take(no_segments(), slice(0, 0)))
    0
    """
    return type(table)(**{each.name: getattr(table, each.name)[rows] for each in fields(table)})


def concatenate(tables: Sequence[Table]) -> Table:
    """Return the rows of one or more tables behind each other."""
    names = [each.name for each in fields(tables[0])]
    columns = {name: np.concatenate([getattr(table, name) for table in tables]) for name in names}
    return type(tables[0])(**columns)
