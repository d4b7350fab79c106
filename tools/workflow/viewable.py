"""The file that a browser is given: the user's own, or one made of another format."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cogsplat
from cogsplat.formats.cogs.folder_source import names_folder
from cogsplat.formats.cogs.folder_writer import pack_cogs
from cogsplat.formats.scenes.registry import is_cogs
from cogsplat.tools.delivery.viewer_pages import SCENE_NAME
from cogsplat.tools.terminal.limits import current_limits
from cogsplat.tools.terminal.output import note
from cogsplat.tools.terminal.partial import partial_accepted
from cogsplat.tools.terminal.progress import Stages

from .inputs import read_any, usable_rows

PRESET = "fast"
"""The preset that scenes of other formats are encoded with before they are shown."""


@dataclass(frozen=True)
class Viewable:
    """A file to show, of so many splats; `encoded` where it was made for this."""

    path: Path
    splats: int
    encoded: bool


@contextmanager
def viewable(scene: Path, *, threads: int, shown: bool) -> Iterator[Viewable]:
    """Give a COGS file that holds a scene for as long as the block lasts.

    Parameters
    ----------
    scene : Path
        Of any format that is read. One that is not COGS is encoded into a temporary folder, and so
        are the complete chunks of one that has not arrived whole, where ``--partial`` takes it.
    threads : int
    shown : bool
        Whether standard error says that the scene is encoded first, and how far that is.

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
        why = "has not arrived whole" if is_cogs(scene) else "is no COGS file"
        note(f"{scene} {why}: encoding it first, preset {PRESET}")
    with tempfile.TemporaryDirectory(prefix="cogsplat-") as folder:
        path = Path(folder) / SCENE_NAME
        with Stages(shown=shown) as stages:
            with stages.stage("read"):
                found = usable_rows(read_any(scene, threads=threads).splats, scene)
            from cogsplat.codec.encode.config import EncodeConfig
            from cogsplat.codec.encode.request import EncodeRequest
            from cogsplat.codec.encode.stage_costs import stage_costs

            request = EncodeRequest(config=EncodeConfig(threads=threads), preset=PRESET)
            stages.plan(stage_costs(len(found), request))
            cogsplat.encode(found, path, request=request, progress=stages)
            stages("write", 1, 1)
        yield Viewable(path, _splats_of(path), encoded=True)


@contextmanager
def drawable(scene: Path, *, threads: int, shown: bool) -> Iterator[Viewable]:
    """Give a file that the viewer draws for as long as the block lasts, without encoding anything.

    Parameters
    ----------
    scene : Path
        Of any format that is read. One that is not a whole COGS file is written as a PLY into a
        temporary folder, in a hundredth of the time that encoding it takes: nothing is sent over
        a network, so that its size does not matter.
    threads : int
    shown : bool
        Whether standard error says how far that is.

    Raises
    ------
    CogsplatError
        The scene cannot be read.
    """
    with _whole_cogs(scene) as whole:
        if whole is not None:
            yield whole
            return
    with tempfile.TemporaryDirectory(prefix="cogsplat-") as folder:
        path = Path(folder) / "scene.ply"
        with Stages(shown=shown) as stages:
            with stages.stage("read"):
                found = usable_rows(read_any(scene, threads=threads).splats, scene)
            with stages.stage("write"):
                cogsplat.write(found, path)
        count = len(found)
        # The arrays are as large as the file; nothing needs them while it is served.
        del found
        yield Viewable(path, count, encoded=True)


@contextmanager
def _whole_cogs(scene: Path) -> Iterator[Viewable | None]:
    """Give a COGS file that has arrived whole as it is, a folder packed; None for any other."""
    if not is_cogs(scene):
        yield None
        return
    with (
        cogsplat.open(scene, partial=partial_accepted(), limits=current_limits()) as file,
        tempfile.TemporaryDirectory(prefix="cogsplat-") as folder,
    ):
        if file.missing_bytes:
            yield None
            return
        path = scene
        if names_folder(scene):
            path = Path(folder) / SCENE_NAME
            pack_cogs(file, path)
        yield Viewable(path, file.root.splats, encoded=False)


def _splats_of(path: Path) -> int:
    with cogsplat.open(path) as file:
        return file.root.splats
