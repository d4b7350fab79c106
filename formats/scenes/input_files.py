"""Files that a scene, cameras or photos consist of, which no output may overwrite."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from cogsplat.codec.errors import CogsplatError
from cogsplat.formats.cogs.folder_source import names_folder
from cogsplat.formats.cogs.packing import folder_files
from cogsplat.formats.storage.atomic import exists, is_file, is_folder

from .registry import is_cogs, scene_files


def input_files(path: Path) -> Iterator[Path]:
    """Yield an input and the files that are read with it, existing ones only.

    Parameters
    ----------
    path : Path
        Scene, cameras or other file, or a folder, all files of which are yielded.
    """
    if not exists(path):
        return
    yield path
    if is_folder(path):
        yield from (inner for inner in path.rglob("*") if is_file(inner))
        return
    try:
        if names_folder(path):
            yield from folder_files(path)
        elif not is_cogs(path):
            yield from (part for part in scene_files(path) if exists(part))
    except CogsplatError:
        # Not a scene; its own reader reports damage.
        return
