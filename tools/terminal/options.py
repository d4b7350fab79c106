"""Command-line options that several commands share."""

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

from .standard_streams import PATH
from .values import byte_count, chunk_range, colour, object_labels

Command = TypeVar("Command", bound=Callable[..., object])

# Beyond any machine's cores; systems refuse to start tens of thousands.
_MOST_THREADS: Final = 1024


def json_option(command: Command) -> Command:
    """Add ``--json``."""
    return click.option(
        "--json", "as_json", is_flag=True, help="Print one JSON object, errors included."
    )(command)


def force_option(command: Command) -> Command:
    """Add ``--force``; `standard_streams.OutputPath` asks for it, so that it is read first."""
    return click.option("--force", is_flag=True, is_eager=True, help="Replace what exists.")(
        command
    )


def quiet_option(command: Command) -> Command:
    """Add ``--quiet``; `standard_streams.InputPath` asks for it, so that it is read first."""
    return click.option(
        "--quiet",
        "-q",
        is_flag=True,
        is_eager=True,
        help="Neither progress nor summary; errors and warnings.",
    )(command)


def threads_option(command: Command) -> Command:
    """Add ``--threads``."""
    return click.option(
        "--threads",
        type=click.IntRange(0, _MOST_THREADS),
        default=0,
        metavar="N",
        help="Threads; 0 (default) takes all cores. The result does not depend on it.",
    )(command)


def device_option(what: str) -> Callable[[Command], Command]:
    """Add ``--device``; `what` begins its help text. Without the device, the command ends here."""

    def there(context: click.Context, parameter: click.Parameter, device: str) -> str:
        if device == "cuda":
            cuda_device()
        return device

    return click.option(
        "--device",
        type=click.Choice(DEVICES),
        default=DEVICES[0],
        show_default=True,
        callback=there,
        help=f"{what} cuda takes a CUDA device and the extra train (gsplat); results differ by "
        "rounding, from run to run too.",
    )


def scheduler_option(command: Command) -> Command:
    """Add ``--scheduler``."""
    return click.option(
        "--scheduler",
        metavar="ADDRESS|local",
        help="Have the workers of this Dask scheduler do the work, such as tcp://10.0.0.1:8786; "
        "local starts --threads processes here. The result does not depend on it.",
    )(command)


def cameras_option(without: str) -> Callable[[Command], Command]:
    """Add ``--cameras``; `without` is the help text on what happens without it."""
    return click.option(
        "--cameras",
        type=PATH,
        metavar="PATH",
        help="A cameras.json or transforms.json, a COLMAP folder, or a .cogs that cameras were "
        f"stored in. {without}",
    )


def eval_every_option(default: int, verb: str) -> Callable[[Command], Command]:
    """Add ``--eval-every``; `verb` begins its help text."""
    return click.option(
        "--eval-every",
        type=click.IntRange(min=0),
        default=default,
        metavar="N",
        show_default=True,
        help=f"{verb} cameras with index % N == 0.",
    )


def ssim_border_option(command: Command) -> Command:
    """Add ``--ssim-border``."""
    return click.option(
        "--ssim-border",
        type=click.Choice(SSIM_BORDERS),
        default=SSIM_BORDERS[0],
        show_default=True,
        help="SSIM over the pixels whose window lies inside the picture (Wang et al. 2004), or "
        "over all, padded with zeros, as 3DGS measures it.",
    )(command)


def background_option(command: Command) -> Command:
    """Add ``--background``."""
    return click.option(
        "--background",
        type=colour,
        default="black",
        show_default=True,
        metavar="R,G,B",
        help="Colour behind the splats, each 0 to 1; black and white are known.",
    )(command)


def quality_option(what: str) -> Callable[[Command], Command]:
    """Add ``--quality``; `what` is the help text."""
    return click.option(
        "--quality",
        type=click.FloatRange(MIN_QUALITY_DB, MAX_QUALITY_DB),
        default=EncodeConfig().quality_db,
        show_default=True,
        metavar="DB",
        help=what,
    )


def target_psnr_option(what: str) -> Callable[[Command], Command]:
    """Add ``--target-psnr``; `what` is the help text."""
    return click.option(
        "--target-psnr",
        type=click.FloatRange(MIN_PSNR_DB, MAX_QUALITY_DB),
        metavar="DB",
        help=what,
    )


def taught_by_option(command: Command) -> Command:
    """Add ``--images`` of commands that train."""
    return click.option(
        "--images",
        type=PATH,
        metavar="DIR",
        help="Photos named as the cameras are: train against them. Without it the renders of "
        "SCENE teach.",
    )(command)


def training_seed_option(command: Command) -> Command:
    """Add ``--seed`` of commands that train."""
    return click.option(
        "--seed",
        type=click.IntRange(0),
        default=0,
        show_default=True,
        metavar="N",
        help="Decides in which order the views teach.",
    )(command)


def preview_option(command: Command) -> Command:
    """Add ``--preview``."""
    return click.option(
        "--preview",
        type=click.FloatRange(0, 0.5, min_open=True),
        metavar="SHARE",
        help="Share of the file, such as 0.02, spent on preview splats: few trained splats at the "
        "front that show the whole scene until more of it has loaded.",
    )(command)


def jitter_option(command: Command) -> Command:
    """Add ``--no-jitter``."""
    return click.option(
        "--no-jitter",
        is_flag=True,
        help="Score the cameras as they are, without copies that step back and turn.",
    )(command)


def top_k_option(default: int | None) -> Callable[[Command], Command]:
    """Return what adds ``--top-k``.

    Parameters
    ----------
    default : int or None
        None where all weights of at least `contribution.LEAST_WEIGHT` count without it.
    """
    return click.option(
        "--top-k",
        type=click.IntRange(min=0),
        default=default,
        show_default="all of at least 0.01" if default is None else True,
        metavar="K",
        help="Weights that count in a pixel, the largest ones; 0 for all.",
    )


def compensate_option(command: Command) -> Command:
    """Add ``--compensate``."""
    return click.option(
        "--compensate",
        is_flag=True,
        help="Make up for chunks that are not there: larger, more opaque splats, as the file says.",
    )(command)


def part_options(command: Command) -> Command:
    """Add ``--chunks --splats --bytes --object --sh``, which select a part of a COGS file."""
    options = [
        click.option(
            "--chunks", type=chunk_range, metavar="A:B", help="Chunks A to B-1 of a COGS file."
        ),
        click.option(
            "--splats",
            "least_splats",
            type=click.IntRange(min=0),
            metavar="N",
            help="Whole chunks until there are at least N splats.",
        ),
        click.option(
            "--bytes",
            "size",
            type=byte_count,
            metavar="N|P%",
            help="What is complete in the first bytes: 65536, 64KiB, 1.5MB or 20%.",
        ),
        click.option(
            "--object",
            "objects",
            type=object_labels,
            metavar="N,…",
            help="Chunks of these objects alone; 0 is what belongs to none.",
        ),
        click.option(
            "--sh",
            "sh_degree",
            type=click.IntRange(0, MAX_SH_DEGREE),
            metavar="0..3",
            help="Highest SH degree.",
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return command
