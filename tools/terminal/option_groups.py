"""Help of a command with many options: the most used options, or all options in groups."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import click

from .config_file import config_option

_OTHERS: Final = "Input, output and progress"

HELP_ALL: Final = "cogsplat.help_all"


class GroupedCommand(click.Command):
    """A command whose ``--help`` shows the most used options, and ``--help-all`` every option.

    The command also gets the option ``--config``, so that the other options can stand in a file.

    Parameters
    ----------
    groups : mapping of str to sequence of str
        Headings, and the options under each, such as ``--quality``, in the order of the help.
        ``--help`` shows the first group. Options that are in no group follow under a heading of
        their own.
    """

    def __init__(self, *args: Any, groups: Mapping[str, Sequence[str]], **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.params = [*self.params, config_option(), _help_all_option()]
        self._groups = groups

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the first group, or all groups after ``--help-all``."""
        records = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None and isinstance(parameter, click.Option):
                records[_long_name(parameter)] = record
        first, *others = self._groups
        _write_group(formatter, first, [records.pop(name) for name in self._groups[first]])
        if not ctx.meta.get(HELP_ALL):
            if records:
                formatter.write_paragraph()
                formatter.write_text(
                    f"{ctx.command_path} --help-all shows {len(records)} more options."
                )
            return
        for title in others:
            _write_group(formatter, title, [records.pop(name) for name in self._groups[title]])
        if records:
            _write_group(formatter, _OTHERS, list(records.values()))


def _long_name(option: click.Option) -> str:
    """Return the long name of an option, such as ``--json``; without one, its first name."""
    return next((name for name in option.opts if name.startswith("--")), option.opts[0])


def _write_group(
    formatter: click.HelpFormatter, title: str, records: Sequence[tuple[str, str]]
) -> None:
    """Write a heading and the options under it."""
    with formatter.section(title):
        formatter.write_dl(records)


def _help_all_option() -> click.Option:
    """Return the option ``--help-all``, which prints the help with all groups and exits."""

    def show(context: click.Context, parameter: click.Parameter, value: bool) -> None:
        if value and not context.resilient_parsing:
            context.meta[HELP_ALL] = True
            click.echo(context.get_help(), color=context.color)
            context.exit()

    return click.Option(
        ["--help-all"],
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=show,
        help="Show all options and exit.",
    )
