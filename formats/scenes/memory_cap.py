"""The workspace of an encode under a memory cap: in memory, or in files beside the output."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.memory import memory_need
from cogsplat.codec.errors import UnsupportedError
from cogsplat.codec.splats import Splats
from cogsplat.codec.workspace import IN_MEMORY, Workspace
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.cogs.sources import cogs_source
from cogsplat.formats.scenes.ply.header import is_ply
from cogsplat.formats.scenes.ply.ply_scene import ply_rows
from cogsplat.formats.storage.atomic import StrPath, open_for_read, storage_errors
from cogsplat.formats.storage.scratch_files import ScratchFiles

from .registry import is_cogs


@dataclass(frozen=True)
class _Rows:
    """What of a scene decides on memory: rows, SH degree, and bytes of a row's extras."""

    splats: int
    sh_degree: int
    extra_bytes: int
    # Whether the scene is in memory whatever is mapped.
    is_held: bool


@contextmanager
def working_memory(
    scene: Splats | StrPath,
    config: EncodeConfig,
    cap: int | None,
    folder: Path,
    *,
    copied: bool = False,
) -> Iterator[Workspace]:
    """Give the workspace that keeps an encode below a cap.

    Parameters
    ----------
    scene : Splats or path
        What will be encoded. A PLY that is read with `Workspace.zeros` is mapped; other scenes are
        in memory.
    config : EncodeConfig
    cap : int or None
        Most resident memory of the process, bytes; None for no cap.
    folder : Path
        Where mapped files are made: the output's folder. They take up to 0.9 kB a splat of SH
        degree 3.
    copied : bool
        Whether the scene is edited after reading, which makes a copy in memory.

    Yields
    ------
    Workspace

    Raises
    ------
    LimitError
        ``memory-cap``: the cap is too small; the message says what is needed.
    UnsupportedError
        ``memory-cap-format``: a scene of which only reading it tells how large it is.
    CogsplatError
        The scene's header cannot be read.
    """
    if cap is None:
        yield IN_MEMORY
        return
    rows = _rows_of(scene)
    row_bytes = memory_need(1, rows.sh_degree, config, extra_bytes=rows.extra_bytes).scene
    need = memory_need(
        rows.splats,
        rows.sh_degree,
        config,
        extra_bytes=rows.extra_bytes,
        held_bytes=rows.splats * row_bytes if rows.is_held or copied else 0,
    )
    resident = need.resident_bytes(cap)
    if resident is None:
        yield IN_MEMORY
        return
    with ScratchFiles(folder, resident) as files:
        yield Workspace(files.zeros, views_at_once=False, settle=files.settle)


def _rows_of(scene: Splats | StrPath) -> _Rows:
    if isinstance(scene, Splats):
        extras = sum(values.nbytes for values in scene.extras.values()) // max(len(scene), 1)
        return _Rows(len(scene), scene.sh_degree, extras, is_held=True)
    if is_cogs(scene):
        with open_cogs(cogs_source(scene)) as file:
            kinds = sum(kind.row_bytes for kind in file.root.attributes)
            return _Rows(file.root.splats, file.root.sh_degree, kinds, is_held=True)
    with storage_errors(scene), open_for_read(scene) as file:
        head = file.read(16)
    if not is_ply(head):
        raise UnsupportedError(
            "memory-cap-format",
            f"{scene}: a memory cap for this format, expected a PLY or COGS file, which say how "
            "many splats they hold",
        )
    rows = ply_rows(scene)
    return _Rows(rows.splats, rows.sh_degree, rows.extra_bytes, is_held=False)
