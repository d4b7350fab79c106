"""COGS and PLY files for the viewer, converted from foreign formats where needed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cogsplat
from cogsplat.formats.cogs.folder_source import names_folder
from cogsplat.formats.cogs.folder_writer import pack_cogs
from cogsplat.formats.scenes.registry import is_cogs
from cogsplat.formats.storage.scratch_folder import scratch_folder
from cogsplat.tools.delivery.viewer_pages import SCENE_NAME
from cogsplat.tools.terminal.limits_option import current_limits
from cogsplat.tools.terminal.output import print_error_line
from cogsplat.tools.terminal.partial import partial_accepted
from cogsplat.tools.terminal.progress_bars import Stages

from .inputs import drop_invalid_splats, read_any

PRESET = "fast"
"""Preset for encoding scenes of other formats before they are shown."""


@dataclass(frozen=True)
class Viewable:
    """A file that the viewer can show.

    Parameters
    ----------
    path : Path
    splats : int
        Splats in the file.
    encoded : bool
        Whether the file is a temporary copy in another format: COGS by `viewable`, PLY by
        `drawable`. False for a complete COGS file or folder.
    """

    path: Path
    splats: int
    encoded: bool


@contextmanager
def viewable(scene: Path, *, threads: int, shown: bool) -> Iterator[Viewable]:
    """Provide a COGS file of a scene for the duration of the block.

    Parameters
    ----------
    scene : Path
        Scene of any format. Another format than COGS is encoded into a temporary folder. With
        ``--partial``, so are the complete chunks of a truncated COGS file.
    threads : int
    shown : bool
        Whether progress of the encode is printed to standard error.

    Raises
    ------
    CogsplatError
        The scene cannot be read.
    """
    with _whole_cogs(scene) as whole:
        if whole is not None:
            yield whole
            return
    if shown:
        why = "is truncated" if is_cogs(scene) else "is no COGS file"
        print_error_line(f"{scene} {why}: encoding it first, preset {PRESET}")
    with scratch_folder() as folder:
        path = folder / SCENE_NAME
        with Stages(shown=shown) as stages:
            with stages.stage("read"):
                found = drop_invalid_splats(read_any(scene, threads=threads).splats, scene)
            from cogsplat.codec.encode.config import EncodeConfig
            from cogsplat.codec.encode.request import EncodeRequest
            from cogsplat.codec.encode.stage_costs import stage_costs

            request = EncodeRequest(config=EncodeConfig(threads=threads), preset=PRESET)
            stages.plan(stage_costs(len(found), request))
            cogsplat.encode(found, path, request=request, progress=stages)
            stages("write", 1, 1)
        yield Viewable(path, _splat_count(path), encoded=True)


@contextmanager
def drawable(scene: Path, *, threads: int, shown: bool) -> Iterator[Viewable]:
    """Provide a COGS or PLY file of a scene for the duration of the block, without encoding.

    Parameters
    ----------
    scene : Path
        Scene of any format. A complete COGS file is provided as it is, a COGS folder is packed
        into a file, and any other scene is written as PLY. Writing takes a hundredth of the time
        of an encode. PLY may be large because the file never leaves this machine.
    threads : int
    shown : bool
        Whether progress is printed to standard error.

    Raises
    ------
    CogsplatError
        The scene cannot be read.
    """
    with _whole_cogs(scene) as whole:
        if whole is not None:
            yield whole
            return
    with scratch_folder() as folder:
        path = folder / "scene.ply"
        with Stages(shown=shown) as stages:
            with stages.stage("read"):
                found = drop_invalid_splats(read_any(scene, threads=threads).splats, scene)
            with stages.stage("write"):
                cogsplat.write(found, path)
        count = len(found)
        # Free the arrays, which are as large as the file, while the file is served.
        del found
        yield Viewable(path, count, encoded=True)


@contextmanager
def _whole_cogs(scene: Path) -> Iterator[Viewable | None]:
    """Provide a complete COGS file, or a COGS folder packed into a file, else None."""
    if not is_cogs(scene):
        yield None
        return
    with (
        cogsplat.open(scene, partial=partial_accepted(), limits=current_limits()) as file,
        scratch_folder() as folder,
    ):
        if file.missing_bytes:
            yield None
            return
        path = scene
        if names_folder(scene):
            path = folder / SCENE_NAME
            pack_cogs(file, path)
        yield Viewable(path, file.root.splats, encoded=False)


def _splat_count(path: Path) -> int:
    """Return the number of splats in a COGS file."""
    with cogsplat.open(path) as file:
        return file.root.splats
