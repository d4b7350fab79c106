"""Options of commands that write a scene: what of it, and those that one format alone knows."""

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
    """How a scene is written.

    Parameters
    ----------
    format_name : str or None
        As ``--format`` names it; None where the name of the output says which.
    absolute : bool
        For PLY: centres as doubles, the origin added.
    spz_precision : str or None
        For SPZ: one of `PRECISIONS`; None where nothing was asked for.
    spz_version : int or None
        For SPZ: one of `VERSIONS`; None where nothing was asked for.
    extras : bool
        Whether attributes are written that nothing draws.
    """

    format_name: str | None = None
    absolute: bool = False
    spz_precision: str | None = None
    spz_version: int | None = None
    extras: bool = True

    def require(self, out: Path, name: str) -> None:
        """Refuse what the format to be written does not know.

        Raises
        ------
        click.UsageError
            ``--absolute`` and `name` is not PLY, which alone holds doubles; ``--spz-precision`` or
            ``--spz-version`` and `name` is not SPZ.
        """
        if self.absolute and name != "ply":
            raise click.UsageError(f"--absolute with {out} as {name}, expected a PLY")
        if self.spz_precision is not None and name != "spz":
            raise click.UsageError(f"--spz-precision with {out} as {name}, expected an SPZ")
        if self.spz_version is not None and name != "spz":
            raise click.UsageError(f"--spz-version with {out} as {name}, expected an SPZ")


def no_extras_option(command: Command) -> Command:
    """Add ``--no-extras``."""
    return click.option(
        "--no-extras",
        is_flag=True,
        help="Leave out what the splats carry beside what is drawn: labels, normals and so on.",
    )(command)


def writing_options(
    names: Sequence[str], what: str
) -> Callable[[Callable[..., object]], Callable[..., object]]:
    """Add ``--format``, ``--no-extras`` and what one format knows, given as `writing`.

    Parameters
    ----------
    names : sequence of str
        Formats that ``--format`` may name.
    what : str
        What the name of the output decides without it.
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
            **others: object,
        ) -> object:
            version = None if spz_version is None else int(spz_version)
            chosen = SceneWriting(format_name, absolute, spz_precision, version, not no_extras)
            return command(writing=chosen, **others)

        options = [
            format_option(names, what),
            click.option(
                "--absolute",
                is_flag=True,
                help="For a PLY: centres as doubles in world coordinates, the scene's origin "
                "added.",
            ),
            click.option(
                "--spz-precision",
                type=click.Choice(PRECISIONS),
                help="For an SPZ: fine (default) stores the centres of small scenes in finer steps "
                "than other programs do; usual stores them in the same, for a smaller file.",
            ),
            click.option(
                "--spz-version",
                type=click.Choice([str(version) for version in VERSIONS]),
                help="For an SPZ: 4 (default), or 3 or 2 for programs that read no newer ones. "
                "Version 2 stores rotations more coarsely.",
            ),
            no_extras_option,
        ]
        decorated: Callable[..., object] = writing
        for option in reversed(options):
            decorated = option(decorated)
        return decorated

    return decorate
