"""``--partial``: take a COGS file that has not arrived whole, for every command that reads one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., object])

_KEY: Final = "cogsplat.partial"


def partial_option(command: Command) -> Command:
    """Add ``--partial``, whose value `partial_accepted` returns."""
    return click.option(
        "--partial",
        is_flag=True,
        callback=_keep,
        expose_value=False,
        help="Take a COGS file of which only the first bytes are there, as while it is being "
        "downloaded: the chunks that are complete.",
    )(command)


def partial_accepted() -> bool:
    """Whether the running command was told to take files that have not arrived whole."""
    context = click.get_current_context(silent=True)
    return bool(context and context.meta.get(_KEY))


def _keep(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    context.meta[_KEY] = value
