"""Streamed SOG version 1: scenes in levels of detail, cut into SOG scenes that are fetched alone.

The format is PlayCanvas' (developer.playcanvas.com, "The Streamed SOG Format"): a ``lod-meta.json``
with a tree of boxes, whose leaves name runs of splats in the files beside it, one of each level.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError, LimitError, UnsupportedError
from cogsplat.formats.storage.atomic import StrPath, open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.siblings import sibling
from cogsplat.formats.storage.strict_json import JsonObject, parse_object

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_VERSION: Final = 1
_CODE: Final = "sog-bad-levels"
_MOST: Final = 1 << 31
# Each level of the format's writer has half the splats of the one before; 64 halvings leave none.
_MOST_LEVELS: Final = 64


@dataclass(frozen=True, eq=False)
class StreamedSog:
    """What ``lod-meta.json`` says.

    Parameters
    ----------
    files : list of Path
        The ``meta.json`` of each SOG scene.
    environment : Path, optional
        That of splats which are always drawn.
    boxes : (n, 6) float64
        Least and largest x, y and z of each leaf, in scene units.
    file : (n, k) int64
        Of each leaf and level, which of `files` has its splats; -1 where there are none. Level 0 is
        the finest.
    start, count : (n, k) int64
        Of its first splat in that file, and how many follow each other.
    size_bytes : int
        Of ``lod-meta.json``.
    """

    files: list[Path]
    environment: Path | None
    boxes: F64
    file: I64
    start: I64
    count: I64
    size_bytes: int


def read_lod_meta(path: StrPath, *, limits: Limits | None = None) -> StreamedSog:
    """Read the index of a Streamed SOG scene, without its splats.

    Parameters
    ----------
    path : path
        A ``lod-meta.json``.
    limits : Limits, optional
        `Limits.small_bytes` is the most that the index may take.

    Raises
    ------
    FormatError
        ``sog-bad-levels``; ``sog-file-name``: a file outside its folder.
    UnsupportedError
        ``sog-version``.
    LimitError
        ``sog-file-too-large``, ``json-too-long``.
    StorageError
        As `open_for_read`.
    """
    where, limits = os.fspath(path), limits or Limits()
    with storage_errors(path), open_for_read(path) as file:
        data = file.read(limits.small_bytes + 1)
    if len(data) > limits.small_bytes:
        raise LimitError(
            "sog-file-too-large",
            f"{where} has more than {limits.small_bytes} bytes, expected at most so many",
        )
    root = parse_object(data, where, _CODE, limits=limits)
    version = root.integer("version", 0, _MOST)
    if version != _VERSION:
        raise UnsupportedError(
            "sog-version", f"{where}: Streamed SOG version {version}, expected {_VERSION}"
        )
    levels = root.integer("lodLevels", 1, _MOST_LEVELS)
    folder = Path(path).parent

    def beside(name: str) -> Path:
        return sibling(folder, name, where, "sog-file-name")

    files = [beside(name) for name in root.texts("filenames")]
    if not files:
        raise root.wrong("filenames", "one file at least")
    boxes, runs = [], []
    for leaf in _leaves(root.child("tree")):
        bound = leaf.child("bound")
        boxes.append([*bound.numbers("min", 3), *bound.numbers("max", 3)])
        runs.append(_runs(leaf.child("lods"), levels, len(files)))
    if not runs:
        raise FormatError(_CODE, f"{where}: a tree without leaves, expected one at least")
    of_leaves = np.array(runs, np.int64)
    return StreamedSog(
        files,
        beside(root.text("environment")) if "environment" in root else None,
        np.array(boxes, np.float64),
        of_leaves[:, :, 0],
        of_leaves[:, :, 1],
        of_leaves[:, :, 2],
        len(data),
    )


def _leaves(tree: JsonObject) -> Iterator[JsonObject]:
    """Yield the nodes that have splats, from the first branch to the last."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if "lods" in node:
            yield node
        elif "children" in node:
            waiting += reversed(node.children("children"))
        else:
            raise FormatError(_CODE, f"{node.where}: neither lods nor children, expected one")


def _runs(lods: JsonObject, levels: int, files: int) -> list[tuple[int, int, int]]:
    """Return file, first splat and number of splats of each level of a leaf."""
    found = []
    for level in range(levels):
        run = (-1, 0, 0)
        if str(level) in lods:
            node = lods.child(str(level))
            count = node.integer("count", 0, _MOST)
            if count:
                run = (node.integer("file", 0, files - 1), node.integer("offset", 0, _MOST), count)
        found.append(run)
    return found
