"""Descriptions that scenes bring, for commands that write them again."""

from __future__ import annotations

from pathlib import Path

import cogsplat
from cogsplat.formats.cogs.description import Description
from cogsplat.formats.cogs.moved_description import move_description
from cogsplat.formats.scenes.gltf.file import read_copyright
from cogsplat.formats.scenes.registry import format_of, is_cogs
from cogsplat.tools.terminal.limits_option import current_limits
from cogsplat.tools.terminal.partial import partial_accepted

from .scene_edits import SceneEdits


def description_of(scene: Path, edits: SceneEdits | None = None) -> Description | None:
    """Return the description of a scene with the files of its pictures; None for none.

    Parameters
    ----------
    scene : Path
        Scene of any format.
    edits : SceneEdits, optional
        Edits of the scene, with which views, places and sky move.

    Raises
    ------
    CogsplatError
        The description cannot be read, or breaks SPEC.
    """
    if not is_cogs(scene):
        return _of_other_format(scene)
    with cogsplat.open(scene, partial=partial_accepted(), limits=current_limits()) as file:
        row = file.description_row
        if row is None or not file.is_present(row):
            return None
        description = file.description(pictures=not file.missing_bytes)
        axes = file.root.info.axes
    if description is not None and file.missing_bytes:
        # The pictures of a file that is cut short stand at its end.
        description = description.without_pictures()
    if description is None or edits is None or not edits.moves:
        return description
    return move_description(description, axes, edits.scale, edits.rotation, edits.translate)


def _of_other_format(scene: Path) -> Description | None:
    """Return the description that a scene of another format has: the copyright of a glTF asset."""
    if format_of(scene).name != "gltf":
        return None
    holder = read_copyright(scene, limits=current_limits())
    return Description(credits=holder) if holder else None
