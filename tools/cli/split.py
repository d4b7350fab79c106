"""``cogsplat split``: cut a PLY into parts, for a scene too large to encode at once."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import click

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import StorageError
from cogsplat.codec.partition.scene_parts import part_cameras
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.formats.scenes.ply.splitting import plan_parts, write_parts
from cogsplat.formats.storage.atomic import atomic_write, is_folder, storage_errors
from cogsplat.tools.terminal.limits_option import limits_option
from cogsplat.tools.terminal.options import cameras_option, force_option, json_option, quiet_option
from cogsplat.tools.terminal.output import (
    count_text,
    display_name,
    print_facts,
    print_json,
    print_line,
)
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import INPUT, WRITTEN_PATH
from cogsplat.tools.workflow.inputs import load_cameras
from cogsplat.tools.workflow.output_files import check_outputs

_MANIFEST: Final = "parts.toml"

# An encode takes 0.3 GB of memory and 0.9 kB per splat with `--preset fast`, so 2 GB of a part.
_PART_SPLATS: Final = 2_000_000

# Least digits of a part's number.
_DIGITS: Final = 3

_OF_A_PART: Final = re.compile(rf"([0-9]{{{_DIGITS},}})\.(ply|cogs)")


@dataclass(frozen=True)
class _Part:
    """A part: its name without extension, number of splats, and cameras."""

    name: str
    splats: int
    cameras: Sequence[Camera]

    @property
    def cameras_name(self) -> str:
        """Name of the file of its cameras."""
        return f"{self.name}.cameras.json"


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat split city.ply city --cameras city.cameras.json\n"
    "  cogsplat batch city/parts.toml"
)
@click.argument("path", type=INPUT, metavar="SCENE.ply")
@click.argument("folder", type=WRITTEN_PATH, metavar="FOLDER")
@click.option(
    "--splats",
    type=click.IntRange(min=1),
    default=_PART_SPLATS,
    show_default=True,
    metavar="N",
    help="Splats of a part. Some parts may have up to a quarter more.",
)
@cameras_option("Each part gets those that show it. Without it, views of each part are planned.")
@partial_option
@limits_option
@force_option
@quiet_option
@json_option
def split(
    path: Path,
    folder: Path,
    splats: int,
    cameras: Path | None,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Cut a PLY into parts that are encoded one by one.

    Planes halve space until parts have about --splats splats; hills and sky far around the scene
    are a part of their own. FOLDER gets the rows of each part, unchanged, as 000.ply, 001.ply and
    so on, its cameras as 000.cameras.json, and a manifest for `cogsplat batch`, parts.toml. Options
    of encode for all parts can be added to its table [options]: profile transform, no preview. A
    scene of any size takes about 0.2 GB of memory.
    """
    manifest = folder / _MANIFEST
    if is_folder(folder):
        check_outputs(manifest, force=force)
    with Stages(shown=not (quiet or as_json)) as stages:
        views = [] if cameras is None else load_cameras(cameras)
        planned = plan_parts(path, splats, progress=stages)
        digits = max(_DIGITS, len(str(len(planned.counts) - 1)))
        parts = [
            _Part(f"{number:0{digits}}", count, part_cameras(sample, views))
            for number, (count, sample) in enumerate(
                zip(planned.counts, planned.samples, strict=True)
            )
        ]
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        _require_no_others(folder, [part.name for part in parts])
        rows = [folder / f"{part.name}.ply" for part in parts]
        seen = [folder / part.cameras_name for part in parts if part.cameras]
        check_outputs(*rows, *seen, manifest, force=force)
        write_parts(path, planned, rows, force=force, progress=stages)
        with stages.stage("write"):
            for part in parts:
                if part.cameras:
                    write_cameras_json(part.cameras, folder / part.cameras_name, force=force)
            # Last: a folder with a manifest is complete.
            with atomic_write(manifest, force) as file:
                file.write(_manifest(parts, has_basis=planned.has_sh).encode())
    place = shlex.quote(display_name(folder))
    following = [
        f"cogsplat batch {place}/{_MANIFEST}",
        f"cogsplat merge {place}/*.cogs OUT.cogs --parts",
    ]
    if as_json:
        print_json(
            {
                "source": display_name(path),
                "source_splats": sum(planned.counts),
                "output": display_name(folder),
                "manifest": display_name(manifest),
                "parts": [
                    {
                        "output": f"{part.name}.ply",
                        "splats": part.splats,
                        "cameras": part.cameras_name if part.cameras else None,
                        "views": len(part.cameras),
                    }
                    for part in parts
                ],
                "next": following,
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not quiet:
        print_line(f"{display_name(folder)}: {count_text(len(parts), 'part')}")
        print_facts(
            ("splats", _range_text([part.splats for part in parts])),
            ("cameras", _range_text([len(part.cameras) for part in parts]) if views else ""),
            ("time", stages.summary()),
            *(("next", command) for command in following),
        )


def _manifest(parts: Sequence[_Part], *, has_basis: bool) -> str:
    """Return the manifest for `cogsplat batch`.

    All parts use the basis of the first one, so that their files can be joined.
    """
    lines = ["# Options of `cogsplat encode` for all parts.", "[options]", "cells = true", ""]
    for number, part in enumerate(parts):
        lines += ["[[scene]]", f'input = "{part.name}.ply"', f'output = "{part.name}.cogs"']
        if part.cameras:
            lines.append(f'options.cameras = "{part.cameras_name}"')
        if has_basis and number:
            lines.append(f'options.basis-of = "{parts[0].name}.cogs"')
        lines.append("")
    return "\n".join(lines)


def _require_no_others(folder: Path, names: Sequence[str]) -> None:
    """Refuse a folder with parts of another split, which `merge` would add to the new parts.

    Raises
    ------
    StorageError
        ``other-parts``.
    """
    with storage_errors(folder):
        found = sorted(path.name for path in folder.iterdir())
    for name in found:
        match = _OF_A_PART.fullmatch(name)
        if match and match[1] not in names:
            raise StorageError(
                "other-parts",
                f"{folder / name}: is a part of another split, expected no parts besides "
                f"{names[0]} to {names[-1]}",
            )


def _range_text(counts: Sequence[int]) -> str:
    """Return the least and the largest count of a part as text."""
    least, most = min(counts), max(counts)
    return f"{least:,} a part" if least == most else f"{least:,} to {most:,} a part"
