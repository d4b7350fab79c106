"""A group of commands whose modules are imported only when a command is used."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any, Final

import click

_USAGE_STATUS: Final = 2

_KEY: Final = "cogsplat.command"


class LazyGroup(click.Group):
    """A group that imports the module of a command when that command is asked for.

    Importing all commands takes longer than some of them run.

    Parameters
    ----------
    modules : mapping of str to str
        Module and attribute of each command by the command's name, such as
        ``cogsplat.tools.cli.info.info``, in the order of the help.
    """

    def __init__(
        self, *args: Any, modules: Mapping[str, str] | None = None, **settings: Any
    ) -> None:
        super().__init__(*args, **settings)
        self._modules = dict(modules or {})

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands in the order of the help."""
        return [*self._modules, *(name for name in self.commands if name not in self._modules)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the command of a name, or None where the group has no such command."""
        known = cmd_name in self._modules or cmd_name in self.commands
        # An unknown name needs all commands: click suggests those with similar names.
        for name in [cmd_name] if known else self._modules:
            if name not in self.commands:
                module, attribute = self._modules[name].rsplit(".", 1)
                self.add_command(getattr(importlib.import_module(module), attribute), name)
        return super().get_command(ctx, cmd_name)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the name, the command and its arguments; remember it for `invoked_command`."""
        name, command, rest = super().resolve_command(ctx, args)
        ctx.meta[_KEY] = command
        return name, command, rest

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the group's own options; without any argument, show the help."""
        if not args and not ctx.resilient_parsing:
            click.echo(ctx.get_help(), err=True)
            ctx.exit(_USAGE_STATUS)
        return super().parse_args(ctx, args)


def invoked_command(ctx: click.Context) -> click.Command | None:
    """Return the innermost command that was resolved under a context, None before that."""
    found = ctx.meta.get(_KEY)
    return found if isinstance(found, click.Command) else None
