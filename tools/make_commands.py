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


def commands(group: click.Group, path: str) -> Iterator[tuple[str, click.Command, click.Context]]:
    """Yield the full name of each command below a group, the command and its context."""
    context = click.Context(group, info_name=path)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        full = f"{path} {name}"
        if isinstance(command, click.Group):
            yield from commands(command, full)
        else:
            yield full, command, click.Context(command, info_name=full, max_content_width=_WIDTH)


def page() -> str:
    """Return the reference as Markdown."""
    parts = [_TOP]
    for name, command, context in commands(cli, "cogsplat"):
        context.meta[HELP_ALL] = True
        context.terminal_width = _WIDTH
        parts.append(f"## {name}\n\n```text\n{command.get_help(context).rstrip()}\n```\n")
    return "\n".join(parts)


def main() -> int:
    """Write the reference; return the exit code."""
    (ROOT / PAGE).write_text(page(), encoding="utf-8", newline="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
