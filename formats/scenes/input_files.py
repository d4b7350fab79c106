"""Files that a scene, cameras or photos consist of, which no output may overwrite."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from cogsplat.codec.errors import CogsplatError
from cogsplat.formats.cogs.folder_source import names_folder
from cogsplat.formats.cogs.packing import folder_files

from .registry import is_cogs, scene_files


def input_files(path: Path) -> Iterator[Path]:
    """Yield an input and the files that are read with it, existing ones only.

    Parameters
    ----------
    path : Path
        Scene, cameras or other file, or a folder, all files of which are yielded.
    """
    if not path.exists():
        return
    yield path
    if path.is_dir():
        yield from (inner for inner in path.rglob("*") if inner.is_file())
        return
    try:
        if names_folder(path):
            yield from folder_files(path)
        elif not is_cogs(path):
            yield from (part for part in scene_files(path) if part.exists())
    except CogsplatError:
        # Not a scene; its own reader reports damage.
        return
