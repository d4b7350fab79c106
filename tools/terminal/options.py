"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar

import click

from cogsplat.codec.encode.config import (
    MAX_QUALITY_DB,
    MIN_PSNR_DB,
    MIN_QUALITY_DB,
    EncodeConfig,
)
from cogsplat.codec.metrics import SSIM_BORDERS
from cogsplat.codec.render.cuda_device import DEVICES, cuda_device
from cogsplat.codec.splats import MAX_SH_DEGREE
from cogsplat.codec.views.trained_at import parse_trained_at
from cogsplat.codec.views.view_text import parse_up
from cogsplat.tools.terminal.values import FiniteNumber

from .standard_streams import PATH
from .values import byte_count, chunk_range, colour, object_labels

Command = TypeVar("Command", bound=Callable[..., object])

# More than any machine has cores; operating systems refuse to start tens of thousands.
_MOST_THREADS: Final = 1024
# SSIM needs 11 pixels a side (`metrics.ssim`), also of portraits close up; 8K screens have 7,680.
_LEAST_WIDTH: Final = 16
_MOST_WIDTH: Final = 8192


def json_option(command: Command) -> Command:
    """Add ``--json``."""
    return click.option(
        "--json", "as_json", is_flag=True, help="Print one JSON object, errors included."
    )(command)


def force_option(command: Command) -> Command:
    """Add ``--force``, parsed first because `standard_streams.OutputPath` reads it."""
    return click.option("--force", is_flag=True, is_eager=True, help="Replace existing files.")(
        command
    )


def quiet_option(command: Command) -> Command:
    """Add ``--quiet``, parsed first because `standard_streams.InputPath` reads it."""
    return click.option(
        "--quiet",
        "-q",
        is_flag=True,
        is_eager=True,
        help="Print errors and warnings only.",
    )(command)


def threads_option(command: Command) -> Command:
    """Add ``--threads``."""
    return click.option(
        "--threads",
        type=click.IntRange(0, _MOST_THREADS),
        default=0,
        metavar="N",
        help="Number of threads, 0 (default) for all cores. It does not change the result.",
    )(command)


def device_option(what: str) -> Callable[[Command], Command]:
    """Return the option ``--device``; `what` begins its help. A missing device ends the command."""

    def require_device(context: click.Context, parameter: click.Parameter, device: str) -> str:
        if device == "cuda":
            cuda_device()
        return device

    return click.option(
        "--device",
        type=click.Choice(DEVICES),
        default=DEVICES[0],
        show_default=True,
        callback=require_device,
        help=f"{what} cuda needs a CUDA device and the extra train (gsplat); results differ by "
        "rounding, also between runs.",
    )


def scheduler_option(command: Command) -> Command:
    """Add ``--scheduler``."""
    return click.option(
        "--scheduler",
        metavar="ADDRESS|local",
        help="Dask scheduler whose workers do the work, such as tcp://10.0.0.1:8786; local starts "
        "--threads processes on this machine. It does not change the result.",
    )(command)


def cameras_option(without: str) -> Callable[[Command], Command]:
    """Return the option ``--cameras``; `without` ends its help, on what happens without it."""
    return click.option(
        "--cameras",
        type=PATH,
        metavar="PATH",
        help="Cameras: a cameras.json or transforms.json, a COLMAP folder, or a .cogs with stored "
        f"cameras. {without}",
    )


def eval_every_option(default: int | None, use: str) -> Callable[[Command], Command]:
    """Return the option ``--eval-every``; `use` ends its help, on what held-out cameras are for.

    A default of None stands for the cameras that `view_sets.leave_out` leaves out.
    """
    return click.option(
        "--eval-every",
        type=click.IntRange(min=0),
        default=default,
        metavar="N",
        show_default="as `encode` does" if default is None else True,
        help=f"Hold out every N-th camera, from the first: {use}",
    )


def ssim_border_option(command: Command) -> Command:
    """Add ``--ssim-border``."""
    return click.option(
        "--ssim-border",
        type=click.Choice(SSIM_BORDERS),
        default=SSIM_BORDERS[0],
        show_default=True,
        help="Pixels that SSIM counts: those whose window lies inside the picture (Wang et al. "
        "2004), or all, padded with zeros (3DGS).",
    )(command)


def background_option(command: Command) -> Command:
    """Add ``--background``."""
    return click.option(
        "--background",
        type=colour,
        default="black",
        show_default=True,
        metavar="COLOUR",
        help="Colour behind the splats: #rrggbb, R,G,B from 0 to 1, black or white.",
    )(command)


def quality_option(what: str) -> Callable[[Command], Command]:
    """Return the option ``--quality``; `what` is its help."""
    return click.option(
        "--quality",
        type=FiniteNumber(MIN_QUALITY_DB, MAX_QUALITY_DB),
        default=EncodeConfig().quality_db,
        show_default=True,
        metavar="DB",
        help=what,
    )


def target_psnr_option(what: str) -> Callable[[Command], Command]:
    """Return the option ``--target-psnr``; `what` is its help."""
    return click.option(
        "--target-psnr",
        type=FiniteNumber(MIN_PSNR_DB, MAX_QUALITY_DB),
        metavar="DB",
        help=what,
    )


def training_images_option(command: Command) -> Command:
    """Add ``--images`` of commands that train."""
    return click.option(
        "--images",
        type=PATH,
        metavar="DIR",
        help="Folder of photos named like the cameras: the ground truth of training. Without it, "
        "renders of SCENE are.",
    )(command)


def training_seed_option(command: Command) -> Command:
    """Add ``--seed`` of commands that train."""
    return click.option(
        "--seed",
        type=click.IntRange(0),
        default=0,
        show_default=True,
        metavar="N",
        help="Seed of the order of the training views.",
    )(command)


def preview_option(command: Command) -> Command:
    """Add ``--preview``, the share of the file spent on preview splats."""
    return click.option(
        "--preview",
        type=FiniteNumber(0, 0.5, min_open=True),
        metavar="SHARE",
        help="Share of the file, such as 0.02, spent on preview splats: few trained splats at the "
        "front that show the whole scene until more of it has loaded.",
    )(command)


def jitter_option(command: Command) -> Command:
    """Add ``--no-jitter``."""
    return click.option(
        "--no-jitter",
        is_flag=True,
        help="Score the given cameras only, without copies moved back and turned.",
    )(command)


def top_k_option(default: int | None) -> Callable[[Command], Command]:
    """Return the option ``--top-k``.

    Parameters
    ----------
    default : int or None
        Weights per pixel; None for all weights of at least `contribution.LEAST_WEIGHT`.
    """
    return click.option(
        "--top-k",
        type=click.IntRange(min=0),
        default=default,
        show_default="all of at least 0.01" if default is None else True,
        metavar="K",
        help="Count the K largest weights of each pixel, 0 for all.",
    )


def up_option(command: Command) -> Command:
    """Add ``--up``."""
    return click.option(
        "--up",
        type=_up_text,
        metavar="X,Y,Z|AXIS",
        help="Direction against gravity: x,y,z, or one of +x, -x, +y, -y, +z, -z.  [default: "
        "estimated from the cameras or the splats]",
    )(command)


def trained_at_option(command: Command) -> Command:
    """Add ``--trained-at``."""
    return click.option(
        "--trained-at",
        type=_trained_at_text,
        metavar="W,FOV[,D]",
        help="Pictures of training: width in px, horizontal field of view in degrees, and distance "
        "of the cameras from the scene's middle. Splats are then drawn as thick as in training at "
        "any picture size. unknown: drawn as usual.  [default: as SCENE says, else by the cameras]",
    )(command)


def shown_at_option(command: Command) -> Command:
    """Add ``--shown-at``."""
    return click.option(
        "--shown-at",
        type=_width,
        metavar="WIDTH",
        help="Width of the pictures that people will see, such as 960px. All views get this width; "
        "they show the same.  [default: that of the cameras, or 400px]",
    )(command)


def _width(text: str) -> int:
    """Parse the width of a picture: ``960px`` or ``960``."""
    digits = text.removesuffix("px").strip()
    if not (digits.isascii() and digits.isdigit() and _LEAST_WIDTH <= int(digits) <= _MOST_WIDTH):
        raise click.BadParameter(
            f"{text!r}, expected {_LEAST_WIDTH}px to {_MOST_WIDTH}px, such as 960px"
        )
    return int(digits)


def _trained_at_text(text: str) -> str:
    """Check the text of ``--trained-at``."""
    parse_trained_at(text)
    return text


def _up_text(text: str) -> str:
    """Check the text of an up direction."""
    parse_up(text)
    return text


def compensate_option(command: Command) -> Command:
    """Add ``--compensate``."""
    return click.option(
        "--compensate",
        is_flag=True,
        help="Apply prefix compensation: enlarge splats and raise opacities in place of missing "
        "chunks.",
    )(command)


def part_options(command: Command) -> Command:
    """Add ``--chunks --splats --bytes --object --sh``, which select a part of a scene."""
    options = [
        click.option(
            "--chunks", type=chunk_range, metavar="A:B", help="Chunks A to B-1 of a COGS file."
        ),
        click.option(
            "--splats",
            "least_splats",
            type=click.IntRange(min=0),
            metavar="N",
            help="The first chunks that hold at least N splats.",
        ),
        click.option(
            "--bytes",
            "size",
            type=byte_count,
            metavar="N|P%",
            help="The chunks that are complete in the first bytes: 65536, 64KiB, 1.5MB or 20%.",
        ),
        click.option(
            "--object",
            "objects",
            type=object_labels,
            metavar="N,…",
            help="Chunks of these objects; 0 for splats of no object.",
        ),
        click.option(
            "--sh",
            "sh_degree",
            type=click.IntRange(0, MAX_SH_DEGREE),
            metavar="0..3",
            help="SH degree to read, at most the degree of the scene.",
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return command
