"""Help of a command with many options: in groups, those that matter most first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import click

_REST: Final = "Input, output and progress"


class GroupedCommand(click.Command):
    """A command whose help lists its options in groups.

    Parameters
    ----------
    groups : mapping of str to sequence of str
        Headings, and the options under each, such as ``--quality``, in the order of the help.
        Options that are in no group follow under a heading of their own.
    """

    def __init__(self, *args: Any, groups: Mapping[str, Sequence[str]], **given: Any) -> None:
        super().__init__(*args, **given)
        self._groups = groups

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the groups."""
        records = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                records[parameter.opts[0]] = record
        for title, names in self._groups.items():
            with formatter.section(title):
                formatter.write_dl([records.pop(name) for name in names])
        if records:
            with formatter.section(_REST):
                formatter.write_dl(list(records.values()))
