"""``--partial``: accept a truncated COGS file, for every command that reads one."""

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
        callback=_store,
        expose_value=False,
        help="Accept a COGS file of which only the first bytes are there, and read its complete "
        "chunks.",
    )(command)


def partial_accepted() -> bool:
    """Whether the running command accepts truncated files."""
    context = click.get_current_context(silent=True)
    return bool(context and context.meta.get(_KEY))


def _store(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    """Store the flag with the running command."""
    context.meta[_KEY] = value
