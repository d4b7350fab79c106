"""Index of Streamed SOG version 1: a scene in levels of detail, in several SOG files.

The format is PlayCanvas' (developer.playcanvas.com, "The Streamed SOG Format"). Its
``lod-meta.json`` has a tree of boxes. Each leaf names one run of splats per level, in one of the
SOG files.
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
_MAX_INTEGER: Final = 1 << 31
# PlayCanvas' writer halves the splats from level to level; after 64 levels none are left.
_MAX_LEVELS: Final = 64


@dataclass(frozen=True, eq=False)
class StreamedSog:
    """The contents of a ``lod-meta.json`` with n leaves and k levels; level 0 is the finest.

    Parameters
    ----------
    files : list of Path
        Path of the ``meta.json`` of each SOG file.
    environment : Path, optional
        Path of the ``meta.json`` of splats that are drawn at every level.
    boxes : (n, 6) float64
        Minimum x, y, z and maximum x, y, z of each leaf, in scene units.
    file : (n, k) int64
        Index into `files` of the run of each leaf and level; -1 for an empty run.
    start : (n, k) int64
        Index of the run's first splat in its file.
    count : (n, k) int64
        Number of splats in the run.
    size_bytes : int
        Size of ``lod-meta.json``, bytes.
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
        Path of the ``lod-meta.json``.
    limits : Limits, optional
        Limits; `Limits.small_bytes` limits the size of the index.

    Raises
    ------
    FormatError
        ``sog-bad-levels``; ``sog-file-name``: a file lies outside the folder.
    UnsupportedError
        ``sog-version``.
    LimitError
        ``sog-file-too-large``, ``json-too-long``.
    StorageError
        See `open_for_read`.
    """
    where, limits = os.fspath(path), limits or Limits()
    with storage_errors(path), open_for_read(path) as file:
        data = file.read(limits.small_bytes + 1)
    if len(data) > limits.small_bytes:
        raise LimitError(
            "sog-file-too-large",
            f"{where} has more bytes than the limit, expected at most {limits.small_bytes}",
        )
    root = parse_object(data, where, _CODE, limits=limits)
    version = root.integer("version", 0, _MAX_INTEGER)
    if version != _VERSION:
        raise UnsupportedError(
            "sog-version", f"{where}: Streamed SOG version {version}, expected {_VERSION}"
        )
    levels = root.integer("lodLevels", 1, _MAX_LEVELS)
    folder = Path(path).parent

    def file_path(name: str) -> Path:
        return sibling(folder, name, where, "sog-file-name")

    files = [file_path(name) for name in root.texts("filenames")]
    if not files:
        raise root.wrong("filenames", "at least one file")
    boxes, runs = [], []
    for leaf in _leaves(root.child("tree")):
        bound = leaf.child("bound")
        boxes.append([*bound.numbers("min", 3), *bound.numbers("max", 3)])
        runs.append(_runs(leaf.child("lods"), levels, len(files)))
    if not runs:
        raise FormatError(_CODE, f"{where}: a tree without leaves, expected at least one")
    table = np.array(runs, np.int64)
    return StreamedSog(
        files,
        file_path(root.text("environment")) if "environment" in root else None,
        np.array(boxes, np.float64),
        table[:, :, 0],
        table[:, :, 1],
        table[:, :, 2],
        len(data),
    )


def _leaves(tree: JsonObject) -> Iterator[JsonObject]:
    """Yield the leaves of a tree, depth first."""
    stack = [tree]
    while stack:
        node = stack.pop()
        if "lods" in node:
            yield node
        elif "children" in node:
            stack += reversed(node.children("children"))
        else:
            raise FormatError(_CODE, f"{node.where}: no key, expected lods or children")


def _runs(lods: JsonObject, levels: int, files: int) -> list[tuple[int, int, int]]:
    """Return the file index, first splat and splat count of each level of a leaf."""
    found = []
    for level in range(levels):
        run = (-1, 0, 0)
        if str(level) in lods:
            node = lods.child(str(level))
            count = node.integer("count", 0, _MAX_INTEGER)
            if count:
                file = node.integer("file", 0, files - 1)
                run = (file, node.integer("offset", 0, _MAX_INTEGER), count)
        found.append(run)
    return found
