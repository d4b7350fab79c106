"""Workspace of an encode under a memory cap: arrays in memory, or in mapped scratch files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.memory import burst_bytes, memory_need
from cogsplat.codec.errors import UnsupportedError
from cogsplat.codec.splats import Splats
from cogsplat.codec.workspace import IN_MEMORY, Workspace
from cogsplat.formats.cogs.open_file import open_source
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.scenes.ply.header import is_ply
from cogsplat.formats.scenes.ply.ply_scene import ply_size
from cogsplat.formats.storage.atomic import StrPath, open_for_read, storage_errors
from cogsplat.formats.storage.scratch_files import ScratchFiles

from .registry import is_cogs


@dataclass(frozen=True)
class _SceneSize:
    """Size of a scene: splats, SH degree, and bytes of one splat's extras."""

    splats: int
    sh_degree: int
    extra_bytes: int
    # Whether the scene stays in memory even if the workspace is mapped.
    in_memory: bool


@contextmanager
def working_memory(
    scene: Splats | StrPath,
    config: EncodeConfig,
    cap: int | None,
    folder: Path,
    *,
    copied: bool = False,
) -> Iterator[Workspace]:
    """Choose the workspace of an encode under a memory cap, as a context manager.

    Parameters
    ----------
    scene : Splats or path
        Scene to encode. A PLY is mapped if it is read with `Workspace.zeros`; other scenes stay in
        memory.
    config : EncodeConfig
        Configuration of the encode, which determines its memory need.
    cap : int or None
        Limit on the process's resident memory, bytes; None for no limit.
    folder : Path
        Folder of the scratch files: the output's folder. They take up to 1.3 kB per splat of SH
        degree 3.
    copied : bool
        Whether the scene is edited after reading, which adds a copy in memory.

    Yields
    ------
    Workspace
        Arrays in memory if the encode fits the cap, otherwise in scratch files that are deleted on
        exit.

    Raises
    ------
    LimitError
        ``memory-cap``: the cap is too small; the message states the memory needed.
    UnsupportedError
        ``memory-cap-format``: the format's header does not state the number of splats.
    CogsplatError
        The scene's header cannot be read.
    """
    if cap is None:
        yield IN_MEMORY
        return
    size = _scene_size(scene)
    row_bytes = memory_need(1, size.sh_degree, config, extra_bytes=size.extra_bytes).scene
    need = memory_need(
        size.splats,
        size.sh_degree,
        config,
        extra_bytes=size.extra_bytes,
        held_bytes=size.splats * row_bytes if size.in_memory or copied else 0,
    )
    resident = need.resident_bytes(cap)
    if resident is None:
        yield IN_MEMORY
        return
    with ScratchFiles(folder, resident, cap - burst_bytes(size.splats)) as files:
        yield Workspace(files.zeros, in_files=True, trim=files.evict)


def _scene_size(scene: Splats | StrPath) -> _SceneSize:
    """Return the size of a scene, from its arrays or from the header of its file."""
    if isinstance(scene, Splats):
        extra_bytes = sum(values.nbytes for values in scene.extras.values()) // max(len(scene), 1)
        return _SceneSize(len(scene), scene.sh_degree, extra_bytes, in_memory=True)
    if is_cogs(scene):
        with open_cogs(open_source(scene)) as file:
            extra_bytes = sum(attribute.row_bytes for attribute in file.root.attributes)
            return _SceneSize(file.root.splats, file.root.sh_degree, extra_bytes, in_memory=True)
    with storage_errors(scene), open_for_read(scene) as file:
        head = file.read(16)
    if not is_ply(head):
        raise UnsupportedError(
            "memory-cap-format",
            f"{scene}: a memory cap for this format, expected a PLY or COGS file, whose header "
            "states the number of splats",
        )
    ply = ply_size(scene)
    return _SceneSize(ply.splats, ply.sh_degree, ply.extra_bytes, in_memory=False)
