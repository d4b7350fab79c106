"""Output of a scene in any format, COGS included, chosen by file name or ``--format``."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import click

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.geometry.baked_thickness import bake_thickness
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.capture_choice import choose_capture
from cogsplat.formats.scenes.registry import WRITABLE
from cogsplat.formats.storage.atomic import storage_errors
from cogsplat.tools.terminal.output import display_name, size_text
from cogsplat.tools.terminal.output_names import scene_format, written_bytes
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.scene_writing import SceneWriting
from cogsplat.tools.terminal.standard_streams import is_standard_output

from .descriptions import SceneNotes

COGS_NAME: Final = "cogs"
"""Value of ``--format`` for COGS."""

OUTPUT_FORMATS: Final = (COGS_NAME, *WRITABLE)
"""Values of ``--format``."""


@dataclass(frozen=True)
class WrittenScene:
    """A scene that was written.

    Parameters
    ----------
    format : str
        Name of the format.
    size_bytes : int
        Bytes of all files of the scene.
    splats : int
        Splats in the file; encoding to COGS may prune some.
    """

    format: str
    size_bytes: int
    splats: int

    def report(self, out: Path) -> dict[str, object]:
        """Return the keys of a JSON object about the written file."""
        return {
            "output": display_name(out),
            "format": self.format,
            "bytes": self.size_bytes,
            "splats": self.splats,
        }

    def line(self, out: Path) -> str:
        """Return the first line of a summary: path, format and size."""
        return f"{out}: {self.format}, {size_text(self.size_bytes)}"


def output_format(out: Path, writing: SceneWriting) -> str:
    """Return the name of the format to write.

    Raises
    ------
    click.UsageError
        The name or extension is unknown, the format is only read, or it lacks a chosen option.
    """
    named = writing.format_name
    if named is None and is_standard_output(out):
        raise click.UsageError("standard output without --format, expected the name of a format")
    to_cogs = named == COGS_NAME if named else out.name.lower().endswith(".cogs")
    name = COGS_NAME if to_cogs else scene_format(out, named).name
    writing.require(out, name)
    return name


def require_cogs_for_cameras(
    cameras: Path | None, out: Path, name: str, *, baked: bool = False
) -> None:
    """Refuse cameras for an output that does not use cameras.

    Raises
    ------
    click.UsageError
        There are cameras, `name` is another format than COGS, and no kernel is baked.
    """
    if cameras is not None and name != COGS_NAME and not baked:
        raise click.UsageError(
            f"--cameras with {out}, expected an output that ends in .cogs, or --bake-kernel"
        )


def write_any(
    splats: Splats,
    out: Path,
    name: str,
    *,
    force: bool,
    cameras: Sequence[Camera] | None,
    threads: int,
    stages: Stages,
    writing: SceneWriting | None = None,
    by_object: bool = False,
    notes: SceneNotes | None = None,
) -> WrittenScene:
    """Write a scene in a format.

    Parameters
    ----------
    splats : Splats
    out : Path
    name : str
        Name of the format (`output_format`).
    force : bool
        Whether an existing file may be replaced.
    cameras : sequence of Camera or None
        Cameras that a COGS file is scored in, or that tell the thickness to bake; None to plan
        views.
    threads : int
    stages : Stages
        Receives the stages of encoding and writing.
    writing : SceneWriting, optional
        Options of single formats, and whether extra attributes are written.
    by_object : bool
        Whether each chunk of a COGS file holds splats of one object only.
    notes : SceneNotes, optional
        Description, up direction and first view of a COGS file; a warning says where another
        format has no place for the description.

    Raises
    ------
    CogsplatError
        The scene cannot be encoded or written.
    """
    writing = writing or SceneWriting()
    notes = notes or SceneNotes()
    if not writing.extras:
        splats = splats.without_extras()
    if writing.bake_kernel:
        splats = bake_thickness(splats.with_capture(choose_capture(splats, cameras or ())))
    if name == COGS_NAME:
        from cogsplat.codec.encode.config import EncodeConfig
        from cogsplat.codec.encode.request import EncodeRequest
        from cogsplat.codec.encode.stage_costs import stage_costs
        from cogsplat.codec.order.orders import OrderConfig

        config = EncodeConfig(ordering=OrderConfig(by_object=by_object), threads=threads)
        request = EncodeRequest(cameras=cameras, config=config)
        request = request.with_stored_look(notes.up, notes.view)
        stages.plan(stage_costs(len(splats), request))
        cogsplat.encode(
            splats,
            out,
            request=request,
            description=notes.description,
            force=force,
            progress=stages,
        )
        stages("write", 1, 1)
        with cogsplat.open(out) as file:
            stored = int(file.root.splats)
        with storage_errors(out):
            return WrittenScene(name, out.stat().st_size, stored)
    if notes.description is not None:
        warnings.warn(
            f"{out}: the description is left out, which {name} has no place for; `cogsplat "
            "describe SCENE settings.json` writes what the SuperSplat viewer shows of it",
            CogsplatWarning,
            stacklevel=2,
        )
    with stages.stage("write"):
        cogsplat.write(
            splats,
            out,
            force=force,
            format_name=name,
            absolute=writing.absolute,
            spz_precision=writing.spz_precision,
            spz_version=writing.spz_version,
        )
    return WrittenScene(name, written_bytes(out, scene_format(out, name)), len(splats))
