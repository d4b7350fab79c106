"""``--config``: a TOML file that sets options of a command."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

import click

from cogsplat.formats.storage.atomic import open_for_read

from .standard_streams import PATH, READ_PATHS

# Options that a file cannot set: they say where values come from or how the command answers.
_COMMAND_LINE_ONLY: Final = frozenset({"config", "help", "help-all", "json"})

OptionValue = bool | str | list[str]
"""True or False for a flag, text for other options, a list of texts for a repeatable option."""


def config_option() -> click.Option:
    """Return the option ``--config``, which names a file of default values."""
    return click.Option(
        ["--config"],
        type=PATH,
        is_eager=True,
        expose_value=False,
        callback=_set_defaults,
        metavar="FILE.toml",
        help="Read options from a TOML file: lines such as quality = 38 or cells = true. Options "
        "on the command line win.",
    )


def settable_options(command: click.Command) -> dict[str, click.Option]:
    """Return the options of a command that a file can set, by their names without dashes."""
    return {
        name[2:]: option
        for option in command.params
        if isinstance(option, click.Option)
        for name in option.opts
        if name.startswith("--") and name[2:] not in _COMMAND_LINE_ONLY
    }


def option_values(
    options: Mapping[str, click.Option], table: Mapping[str, object]
) -> dict[str, OptionValue]:
    """Return the values that a table of a file sets, by the names of options.

    Parameters
    ----------
    options : mapping of str to click.Option
        Options that the table may set, as `settable_options` returns them.
    table : mapping of str to object
        Values as TOML or JSON has them.

    Raises
    ------
    ValueError
        A name that is no option, or a value of the wrong type. The message names both.
    """
    return {name: _option_value(options, name, value) for name, value in table.items()}


def _option_value(options: Mapping[str, click.Option], name: str, value: object) -> OptionValue:
    """Return the value of one option."""
    option = options.get(name)
    if option is None:
        raise ValueError(f"option {name!r}, expected {_nearest(name, options)}")
    if option.is_flag:
        if not isinstance(value, bool):
            raise ValueError(f"option {name} of {value!r}, expected true or false")
        return value
    if option.multiple and isinstance(value, list):
        return [_text(name, part) for part in value]
    return [_text(name, value)] if option.multiple else _text(name, value)


def _text(name: str, value: object) -> str:
    """Return a value as the command line would have it."""
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise ValueError(f"option {name} of {value!r}, expected text or a number")
    return str(value)


def _nearest(name: str, known: Iterable[str]) -> str:
    """Return the known name that is nearest to an unknown one, for a message."""
    found = difflib.get_close_matches(name.replace("_", "-"), [*known], n=1)
    return f"{found[0]!r}" if found else "an option of the command without its dashes"


def _set_defaults(context: click.Context, parameter: click.Parameter, path: Path | None) -> None:
    """Make the values of a file the defaults of the command."""
    if path is None:
        return
    context.meta[READ_PATHS] = [path]
    with open_for_read(path) as file:
        data = file.read()
    options = settable_options(context.command)
    try:
        values = option_values(options, tomllib.loads(data.decode()))
    except ValueError as error:
        raise click.UsageError(f"{path}: {error}", context) from None
    defaults = {str(options[name].name): value for name, value in values.items()}
    context.default_map = {**(context.default_map or {}), **defaults}
