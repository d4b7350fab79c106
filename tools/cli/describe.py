"""``cogsplat describe``: show and change the description of a scene, without encoding it."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Final

import click

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.views.view_text import unit_up
from cogsplat.formats.cogs.describing import Described
from cogsplat.formats.cogs.description import Description, Picture
from cogsplat.formats.cogs.description_json import (
    from_json,
    read_object,
    read_picture_file,
    to_json,
)
from cogsplat.formats.cogs.description_segment import UNITS
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.formats.network.urls import is_url
from cogsplat.formats.scenes.supersplat_settings import (
    is_settings,
    parse_settings,
    write_settings,
)
from cogsplat.tools.pictures.png import to_image
from cogsplat.tools.pictures.posters import write_poster
from cogsplat.tools.terminal.limits_option import current_limits, limits_option
from cogsplat.tools.terminal.options import force_option, json_option, quiet_option
from cogsplat.tools.terminal.output import (
    display_name,
    print_facts,
    print_json,
    print_line,
    size_text,
)
from cogsplat.tools.terminal.partial import partial_accepted, partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import (
    INPUT_BY_RANGES,
    PATH,
    WRITTEN_PATH,
    fetch_if_url,
    unfetched_url,
)
from cogsplat.tools.terminal.values import Colour, FiniteNumber, colour
from cogsplat.tools.workflow.description_facts import description_facts
from cogsplat.tools.workflow.inputs import input_source
from cogsplat.tools.workflow.output_files import check_outputs

from .render import fitted

_KEYS: Final = tuple(field.name for field in fields(Description))

_SETTINGS_SUFFIX: Final = ".json"
"""Extension of an output that is written as settings of the SuperSplat viewer."""

_FIRST_VIEW: Final = "first-view"
"""Value of ``--poster`` for a picture of the first view."""

# Size of a rendered poster, px: a full-width picture on a phone, and enough behind a play button.
_POSTER_SIZE: Final = (1280, 720)


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat describe scene.cogs\n"
    "  cogsplat describe scene.cogs new.cogs --title Garden --licence CC-BY-4.0\n"
    "  cogsplat describe folder/ --force --from about.json --poster first-view\n"
    "  cogsplat describe scene.cogs settings.json"
)
@click.argument("scene", type=INPUT_BY_RANGES, metavar="SCENE")
@click.argument("out", type=WRITTEN_PATH, metavar="[OUT]", required=False)
@click.option(
    "--from",
    "json_file",
    type=PATH,
    metavar="FILE.json",
    help="Set every key that a JSON file has, such as the output of --json; views, a camera path "
    "and annotations among them. Pictures are paths relative to FILE.json. Settings of the "
    "SuperSplat viewer are read as well.",
)
@click.option("--title", metavar="TEXT", help="Name of the scene.")
@click.option("--text", metavar="TEXT", help="Longer text about the scene.")
@click.option("--licence", metavar="TEXT", help="Licence, such as CC-BY-4.0.")
@click.option("--credits", metavar="TEXT", help="People and projects to credit.")
@click.option("--date", metavar="DATE", help="Date of the capture, such as 2026-05.")
@click.option(
    "--metres-per-unit",
    type=FiniteNumber(0, min_open=True),
    metavar="M",
    help="Length of a unit of the scene, metres.",
)
@click.option("--unit", type=click.Choice(UNITS), help="Unit in which viewers show lengths.")
@click.option(
    "--background",
    type=colour,
    metavar="COLOUR",
    help="Colour behind the splats: #rrggbb, R,G,B from 0 to 1, black or white.",
)
@click.option(
    "--up", metavar="X,Y,Z|AXIS", help="Direction against gravity: x,y,z, or an axis such as -y."
)
@click.option(
    "--view",
    metavar="X,Y,Z,TX,TY,TZ,FOV",
    help="View where viewers start: position, target and vertical field of view in degrees, as "
    "the viewer copies it.",
)
@click.option(
    "--add-view",
    "named",
    type=str,
    multiple=True,
    metavar="NAME=X,Y,Z,TX,TY,TZ,FOV",
    help="Add a named view, or replace the one of that name. Repeatable.",
)
@click.option(
    "--poster",
    metavar=f"FILE|{_FIRST_VIEW}",
    help="Picture to show while the scene loads: a JPEG or WebP, or a render of the first view.",
)
@click.option(
    "--sky",
    type=PATH,
    metavar="FILE",
    help="Picture behind the splats: an equirectangular JPEG or WebP, twice as wide as high.",
)
@click.option(
    "--clear",
    type=click.Choice((*_KEYS, "all")),
    multiple=True,
    metavar="KEY",
    help="Remove a key of the description, or all. Repeatable.",
)
@partial_option
@limits_option
@force_option
@quiet_option
@json_option
def describe(
    scene: Path,
    out: Path | None,
    json_file: Path | None,
    up: str | None,
    view: str | None,
    named: tuple[str, ...],
    poster: str | None,
    sky: Path | None,
    clear: tuple[str, ...],
    force: bool,
    quiet: bool,
    as_json: bool,
    **given: Any,
) -> None:
    """Show or change the description of a COGS file or folder.

    Without options, the description is printed. With options, it is changed, and written into OUT,
    or with --force into SCENE itself. Nothing is encoded: all other segments keep their bytes. A
    folder gets a new manifest alone. OUT.json gets the description as settings of the
    SuperSplat viewer.
    """
    values = {key: value for key, value in given.items() if value is not None}
    changes = bool(values or clear or named) or any(
        option is not None for option in (out, json_file, up, view, poster, sky)
    )
    if not changes:
        _show(scene, as_json=as_json)
        return
    if partial_accepted():
        raise click.UsageError("--partial with a change, expected a complete file")
    if out is None and (is_url(str(unfetched_url(scene))) or display_name(scene) != str(scene)):
        raise click.UsageError(f"{display_name(scene)}: is no file to replace, expected OUT")
    path = fetch_if_url(scene)
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"), cogsplat.open(path, limits=current_limits()) as file:
            description = file.description() or Description()
            added = tuple(_named_view(file, text, up) for text in named)
            start = file.first_view(view=view, up=up)
            axes, level = file.root.info.axes, file.up if up is None else unit_up(up)
        if "all" in clear:
            description = Description()
        if json_file is not None:
            value = read_object(json_file, limits=current_limits())
            printed = value.get("description")
            if isinstance(printed, dict):
                value = printed
            if is_settings(value):
                settings = parse_settings(value, str(json_file), axes, level)
                read = settings.description
                start = settings.first_view if view is None else start
            else:
                read = from_json(value, json_file)
            description = description.updated(read)
        names = {camera.name for camera in added}
        kept = tuple(camera for camera in description.views if camera.name not in names)
        description = replace(description, **values, views=(*kept, *added))
        pictures: dict[str, Picture] = {}
        if sky is not None:
            pictures["sky"] = read_picture_file(sky)
        if poster is not None:
            with stages.stage("render"):
                pictures["poster"] = _poster(path, poster, view, up, description.background)
        description = description.with_pictures(pictures)
        cleared = {key: getattr(Description(), key) for key in clear if key != "all"}
        description = replace(description, **cleared)
        with stages.stage("write"):
            if out is not None and out.suffix.lower() == _SETTINGS_SUFFIX:
                check_outputs(out, force=force)
                size = write_settings(out, description, start, axes, level, force=force)
                done = Described(out, size, size, description)
            else:
                done = cogsplat.describe(
                    path, description, out, up=up, view=start, force=force, limits=current_limits()
                )
    shown = Description() if done.description is None else done.description
    if as_json:
        print_json(
            {
                "source": display_name(scene),
                "output": display_name(done.path),
                "bytes": done.size_bytes,
                "bytes_written": done.written_bytes,
                "description": to_json(shown),
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not quiet:
        written = size_text(done.written_bytes)
        print_line(f"{done.path}: {size_text(done.size_bytes)}, {written} written")
        print_facts(*description_facts(shown), ("time", stages.summary()))


def _show(scene: Path, *, as_json: bool) -> None:
    """Print the description of a scene."""
    with cogsplat.open(
        input_source(scene), partial=partial_accepted(), limits=current_limits()
    ) as file:
        description = file.description() or Description()
    if as_json:
        print_json({"source": display_name(scene), "description": to_json(description)})
    elif description.is_empty:
        print_line(f"{display_name(scene)}: no description")
    else:
        print_line(f"{display_name(scene)}:")
        print_facts(*description_facts(description))


def _named_view(file: CogsFile, text: str, up: str | None) -> Camera:
    """Return the view of a text ``NAME=POSE``."""
    name, _, pose = text.rpartition("=")
    if not name:
        raise click.UsageError(f"--add-view {text!r}, expected NAME=X,Y,Z,TX,TY,TZ,FOV")
    camera = file.first_view(view=pose, up=up)
    assert camera is not None
    return replace(camera, name=name)


def _poster(
    scene: Path, poster: str, view: str | None, up: str | None, background: Colour | None
) -> Picture:
    """Return the poster of a file, or a render of the first view of a scene."""
    if poster != _FIRST_VIEW:
        return read_picture_file(Path(poster))
    with cogsplat.open(scene, limits=current_limits()) as file:
        camera = file.first_view(view=view, up=up)
        if camera is None:
            raise DataError(
                "bad-description",
                f"{scene}: no first view to render, expected --view or a picture's file",
            )
        splats = file.decode()
    camera = fitted(camera, *_POSTER_SIZE)
    pixels = cogsplat.render(splats, camera, background=background or (0.0, 0.0, 0.0))
    return write_poster(to_image(pixels))
