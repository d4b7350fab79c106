"""Descriptions and first looks stored in files, for commands that write edited scenes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.formats.cogs.description import Description
from cogsplat.formats.cogs.moved_description import move_description
from cogsplat.formats.scenes.gltf.file import read_copyright
from cogsplat.formats.scenes.registry import format_of, is_cogs
from cogsplat.tools.terminal.limits_option import current_limits
from cogsplat.tools.terminal.partial import partial_accepted

from .scene_edits import SceneEdits


@dataclass(frozen=True, eq=False)
class SceneNotes:
    """Description, up direction and first view that a scene's file stores.

    Parameters
    ----------
    description : Description or None
        Description with the files of its pictures.
    up : (3,) float64 or None
        Unit vector against gravity in the frame of the means.
    view : Camera or None
        View where viewers start.
    """

    description: Description | None = None
    up: NDArray[np.float64] | None = None
    view: Camera | None = None


def notes_of(scene: Path, edits: SceneEdits | None = None) -> SceneNotes:
    """Return description, up direction and first view of a scene's file, moved with its edits.

    Parameters
    ----------
    scene : Path
        Scene of any format.
    edits : SceneEdits, optional
        Edits of the scene, applied to views, places and sky as well.

    Raises
    ------
    CogsplatError
        The description cannot be read, or breaks SPEC.
    """
    if not is_cogs(scene):
        return SceneNotes(_of_other_format(scene))
    with cogsplat.open(scene, partial=partial_accepted(), limits=current_limits()) as file:
        row = file.description_row
        description = None
        if row is not None and file.is_present(row):
            description = file.description(pictures=not file.missing_bytes)
            # The pictures of a file that is cut short stand at its end.
            if description is not None and file.missing_bytes:
                description = description.without_pictures()
        axes, up, view = file.root.info.axes, file.root.up, file.root.first_view
    if edits is None or not edits.moves:
        return SceneNotes(description, up, view)
    if description is not None:
        description = move_description(
            description, axes, edits.scale, edits.rotation, edits.translate
        )
    return SceneNotes(
        description,
        None if up is None else edits.rotation @ up,
        None if view is None else edits.camera(view),
    )


def _of_other_format(scene: Path) -> Description | None:
    """Return the description that a scene of another format has: the copyright of a glTF asset."""
    if format_of(scene).name != "gltf":
        return None
    holder = read_copyright(scene, limits=current_limits())
    return Description(credits=holder) if holder else None
