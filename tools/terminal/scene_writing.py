"""Options of commands that write a scene: format, extra attributes, and details of formats."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import click

from cogsplat.formats.scenes.spz.spz_scene import VERSIONS
from cogsplat.formats.scenes.spz.spz_values import PRECISIONS

from .output_names import format_option

Command = TypeVar("Command", bound=Callable[..., object])


@dataclass(frozen=True)
class SceneWriting:
    """Values of the options of `writing_options`.

    Parameters
    ----------
    format_name : str or None
        Value of ``--format``; None to choose by the extension of the output.
    absolute : bool
        Whether a PLY holds centres as doubles with the scene's origin added.
    spz_precision : str or None
        One of `PRECISIONS` for an SPZ; None for the default.
    spz_version : int or None
        One of `VERSIONS` for an SPZ; None for the default.
    extras : bool
        Whether attributes without effect on the picture are written.
    bake_kernel : bool
        Whether the trained thickness is added to the scales, and the scene is anti-aliased.
    """

    format_name: str | None = None
    absolute: bool = False
    spz_precision: str | None = None
    spz_version: int | None = None
    extras: bool = True
    bake_kernel: bool = False

    def require(self, out: Path, name: str) -> None:
        """Refuse an option that does not apply to the format of the output.

        Parameters
        ----------
        out : Path
            Path of the output, for messages.
        name : str
            Name of the format of the output.

        Raises
        ------
        click.UsageError
            ``--absolute`` without PLY, ``--spz-precision`` or ``--spz-version`` without SPZ, or
            ``--bake-kernel`` with COGS.
        """
        if self.absolute and name != "ply":
            raise click.UsageError(f"--absolute with {out} as {name}, expected a PLY")
        if self.spz_precision is not None and name != "spz":
            raise click.UsageError(f"--spz-precision with {out} as {name}, expected an SPZ")
        if self.spz_version is not None and name != "spz":
            raise click.UsageError(f"--spz-version with {out} as {name}, expected an SPZ")
        if self.bake_kernel and name == "cogs":
            raise click.UsageError(
                f"--bake-kernel with {out} as COGS, expected another format: a COGS file stores "
                "the viewpoints of training themselves"
            )


def no_extras_option(command: Command) -> Command:
    """Add ``--no-extras``."""
    return click.option(
        "--no-extras",
        is_flag=True,
        help="Leave out attributes that do not affect the picture, such as labels and normals.",
    )(command)


def writing_options(
    names: Sequence[str], without: str
) -> Callable[[Callable[..., object]], Callable[..., object]]:
    """Return the options that `SceneWriting` holds, passed on as ``writing``.

    Parameters
    ----------
    names : sequence of str
        Values of ``--format``.
    without : str
        End of the help of ``--format``, on what happens without it.
    """

    def decorate(command: Callable[..., object]) -> Callable[..., object]:
        @functools.wraps(command)
        def writing(
            *,
            format_name: str | None,
            absolute: bool,
            spz_precision: str | None,
            spz_version: str | None,
            no_extras: bool,
            bake_kernel: bool,
            **others: object,
        ) -> object:
            version = None if spz_version is None else int(spz_version)
            chosen = SceneWriting(
                format_name, absolute, spz_precision, version, not no_extras, bake_kernel
            )
            return command(writing=chosen, **others)

        options = [
            format_option(names, without),
            click.option(
                "--absolute",
                is_flag=True,
                help="For a PLY: store centres as doubles in world coordinates, the scene's "
                "origin added.",
            ),
            click.option(
                "--spz-precision",
                type=click.Choice(PRECISIONS),
                help="For an SPZ: steps of the centres in small scenes. fine (default) is finer "
                "than in other programs; usual is as in other programs, for a smaller file.",
            ),
            click.option(
                "--spz-version",
                type=click.Choice([str(version) for version in VERSIONS]),
                help="For an SPZ: format version. 4 is the default; older programs need 3 or 2, "
                "and 2 stores rotations more coarsely.",
            ),
            no_extras_option,
            click.option(
                "--bake-kernel",
                is_flag=True,
                help="For other viewers: add the thickness that splats were trained with to their "
                "scales, and mark the scene as anti-aliased. Small and far pictures are then "
                "nearly as trained, full-size pictures slightly softer.",
            ),
        ]
        decorated: Callable[..., object] = writing
        for option in reversed(options):
            decorated = option(decorated)
        return decorated

    return decorate
