"""``cogsplat lab synth``: a synthetic test scene and its cameras."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import click
import numpy as np
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.order.objects import with_labels
from cogsplat.codec.splats import MAX_SH_DEGREE, Splats
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.formats.scenes.ply.ply_scene import write_ply_parts
from cogsplat.formats.storage.atomic import storage_errors
from cogsplat.tools.lab.synthetic.floor_plan import MOST_ROOMS, SPLATS_PER_ROOM
from cogsplat.tools.terminal.options import (
    force_option,
    json_option,
    quiet_option,
)
from cogsplat.tools.terminal.output import (
    display_name,
    print_facts,
    print_json,
    print_line,
    size_text,
)
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import WRITTEN_PATH
from cogsplat.tools.workflow.output_files import check_outputs

_SPLATS: Final = 120_000
MOST_SPLATS: Final = 20_000_000
"""Largest scene that the generators make in memory, in splats."""

_CITY_SPLATS: Final = 1_000_000
_MOST_CITY_SPLATS: Final = 2_000_000_000


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat lab synth scene.ply\n"
    "  cogsplat encode scene.ply scene.cogs --cameras scene.cameras.json"
)
@click.argument("out", type=WRITTEN_PATH, metavar="OUT.ply")
@click.option(
    "--splats",
    type=click.IntRange(1, _MOST_CITY_SPLATS),
    metavar="N",
    help="Number of splats; with fewer than about 10,000, or 20,000 a room, surfaces have gaps.  "
    f"[default: {_SPLATS}, {SPLATS_PER_ROOM} a room, or {_CITY_SPLATS} with --city]",
)
@click.option(
    "--rooms",
    type=click.IntRange(1, MOST_ROOMS),
    metavar="N",
    help="Make a house of N furnished rooms instead; each view shows a part of it.",
)
@click.option(
    "--city",
    is_flag=True,
    help="Make a city instead, a block for every 150,000 splats; it is written block by block, so "
    "that any number of splats fits into memory.",
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=7,
    show_default=True,
    metavar="N",
    help="Seed of the random parts of the scene.",
)
@click.option(
    "--sh",
    "sh_degree",
    type=click.IntRange(0, MAX_SH_DEGREE),
    default=MAX_SH_DEGREE,
    show_default=True,
    metavar="0..3",
    help="SH degree.",
)
@click.option(
    "--cameras",
    type=WRITTEN_PATH,
    metavar="PATH",
    help="File for the cameras.  [default: OUT.cameras.json]",
)
@click.option(
    "--walk",
    type=WRITTEN_PATH,
    metavar="PATH",
    help="With --rooms or --city: file for the cameras of a walk through all rooms, or of a walk "
    "and a flight through the city.  [default: OUT.walk.json]",
)
@click.option(
    "--objects",
    is_flag=True,
    help="Label three objects with 1 to 3 in the attribute 'object', all else with 0.",
)
@click.option(
    "--masks",
    type=WRITTEN_PATH,
    metavar="DIR",
    help="Folder for masks of the three objects, a PNG for each camera.",
)
@force_option
@quiet_option
@json_option
def synth(
    out: Path,
    splats: int | None,
    rooms: int | None,
    city: bool,
    seed: int,
    sh_degree: int,
    cameras: Path | None,
    walk: Path | None,
    objects: bool,
    masks: Path | None,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Make a synthetic test scene and its cameras.

    The scene has glossy objects and clutter on a terrace, and 48 cameras. With --rooms it is a
    house with eight cameras in each room, and the cameras of a walk through all rooms. With --city
    it is a city with six cameras for each block, at least 48: 60 % of them in the streets, 25 %
    over the roofs, 15 % from far. The same options give the same bytes.
    """
    from cogsplat.tools.lab.synthetic import city_paths
    from cogsplat.tools.lab.synthetic import rooms as houses
    from cogsplat.tools.lab.synthetic import terrace as scenes

    if city and rooms is not None:
        raise click.UsageError("--city with --rooms, expected one of them")
    if (city or rooms is not None) and (objects or masks is not None):
        other = "--city" if city else "--rooms"
        raise click.UsageError(f"--objects and --masks with {other}, expected them without")
    if rooms is None and not city and walk is not None:
        raise click.UsageError("--walk without --rooms or --city, expected one of them")
    if city and out.suffix.lower() != ".ply":
        raise click.UsageError(f"--city with {display_name(out)}, expected a name in .ply")
    if not city and (splats or 0) > MOST_SPLATS:
        raise click.UsageError(f"{splats} splats without --city, expected at most {MOST_SPLATS}")
    usual = _CITY_SPLATS if city else _SPLATS
    splats = splats or (usual if rooms is None else min(rooms * SPLATS_PER_ROOM, MOST_SPLATS))
    cameras = cameras or out.with_suffix(".cameras.json")
    walked: list[Camera] = []
    if rooms is not None or city:
        walk = walk or out.with_suffix(".walk.json")
    if city:
        views, walked = city_paths.city_cameras(splats, seed), city_paths.city_walk(splats, seed)
    elif rooms is not None:
        views, walked = houses.rooms_cameras(rooms, seed), houses.rooms_walk(rooms, seed)
    else:
        views = scenes.synth_cameras()
    if masks is not None:
        with storage_errors(masks):
            masks.mkdir(parents=True, exist_ok=True)
    pictures = [] if masks is None else [_mask_path(masks, camera) for camera in views]
    check_outputs(out, cameras, walk, *pictures, force=force)
    with Stages(shown=not (quiet or as_json)) as stages:
        if city:
            _write_city(out, splats, seed, sh_degree, stages, force=force)
        else:
            with stages.stage("synth"):
                if rooms is None:
                    scene = scenes.synth(splats, seed=seed, sh_degree=sh_degree)
                    labels = scenes.synth_objects(splats, seed)
                else:
                    scene = houses.synth_rooms(rooms, splats, seed=seed, sh_degree=sh_degree)
            written = with_labels(scene, labels) if objects else scene
        with stages.stage("write"):
            if not city:
                cogsplat.write(written, out, force=force)
            write_cameras_json(views, cameras, force=force)
            if walk is not None:
                write_cameras_json(walked, walk, force=force)
        if masks is not None:
            with stages.stage("masks"):
                _write_masks(masks, scene, labels, views, force=force)
    with storage_errors(out):
        size = out.stat().st_size
    if as_json:
        print_json(
            {
                "output": display_name(out),
                "bytes": size,
                "splats": splats,
                "sh_degree": sh_degree,
                "seed": seed,
                "cameras": display_name(cameras),
                "views": len(views),
                "rooms": rooms or 0,
                "city": city,
                "walk": None if walk is None else display_name(walk),
                "walk_poses": len(walked),
                "objects": list(scenes.OBJECTS) if objects else [],
                "masks": None if masks is None else display_name(masks),
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not quiet:
        print_line(f"{out}: {splats:,} splats at SH degree {sh_degree}, {size_text(size)}")
        named = [f"{number} {name}" for number, name in enumerate(scenes.OBJECTS, start=1)]
        print_facts(
            ("cameras", f"{cameras}, {len(views)} views"),
            ("walk", f"{walk}, {len(walked)} poses" if walk else ""),
            ("objects", ", ".join(named) if objects else ""),
            ("masks", str(masks) if masks else ""),
            ("time", stages.summary()),
        )


def _write_city(
    out: Path, splats: int, seed: int, sh_degree: int, stages: Stages, *, force: bool
) -> None:
    """Write a city block by block, with one block in memory at a time."""
    from cogsplat.tools.lab.synthetic.city import city_parts

    def parts() -> Iterator[Splats]:
        made = 0
        stages("synth", made, splats)
        for part in city_parts(splats, seed, sh_degree):
            made += len(part)
            yield part
            stages("synth", made, splats)

    write_ply_parts(parts(), splats, out, force=force)


def _write_masks(
    folder: Path,
    scene: Splats,
    labels: NDArray[np.uint8],
    views: Sequence[Camera],
    *,
    force: bool,
) -> None:
    """Write a mask of the objects for each camera."""
    from PIL import Image

    from cogsplat.tools.lab.synthetic.object_masks import synth_masks
    from cogsplat.tools.pictures.png import write_png

    for camera, mask in zip(views, synth_masks(scene, labels, views), strict=True):
        write_png(Image.fromarray(mask), _mask_path(folder, camera), force=force)


def _mask_path(folder: Path, camera: Camera) -> Path:
    """Return the path of the mask of a camera."""
    return folder / f"{camera.name}.png"
