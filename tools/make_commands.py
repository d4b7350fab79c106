"""Write ``docs/reference/commands.md``, the help of every command.

Run ``python -m cogsplat.tools.make_commands`` after a change of an option or a help text.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import click

from cogsplat.tools.main import cli
from cogsplat.tools.terminal.option_groups import HELP_ALL

ROOT: Final = Path(__file__).resolve().parents[1]
PAGE: Final = Path("docs") / "reference" / "commands.md"

_WIDTH: Final = 100
_TOP: Final = """# Commands

The help of every command, with the options that only `--help-all` shows.
`python -m cogsplat.tools.make_commands` writes this page.
"""


def commands(group: click.Context) -> Iterator[click.Context]:
    """Yield the context of each command below the group of a context, as a call of it makes one."""
    assert isinstance(group.command, click.Group)
    for name in group.command.list_commands(group):
        command = group.command.get_command(group, name)
        assert command is not None
        context = click.Context(
            command, parent=group, info_name=name, terminal_width=_WIDTH, **command.context_settings
        )
        if isinstance(command, click.Group):
            yield from commands(context)
        else:
            yield context


def page() -> str:
    """Return the reference as Markdown."""
    parts = [_TOP]
    for context in commands(click.Context(cli, info_name="cogsplat", **cli.context_settings)):
        context.meta[HELP_ALL] = True
        text = context.get_help().rstrip()
        parts.append(f"## {context.command_path}\n\n```text\n{text}\n```\n")
    return "\n".join(parts)


def main() -> int:
    """Write the reference; return the exit code."""
    (ROOT / PAGE).write_text(page(), encoding="utf-8", newline="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
