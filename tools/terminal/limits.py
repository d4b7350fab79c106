"""``--limits``: what reading may cost, for every command that reads."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Final, TypeVar

import click

from cogsplat.formats.storage.limits import Limits

from .values import number_of_bytes

Command = TypeVar("Command", bound=Callable[..., object])

_KEY: Final = "cogsplat.limits"

_COUNT: Final = re.compile(r"([0-9]{1,12})\s*([kmg]?)", re.IGNORECASE)
_THOUSANDS: Final = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9}

_EXPECTED: Final = "expected some of memory=2GiB, splats=10M, cameras=100k, expansion=256"


def limits_option(command: Command) -> Command:
    """Add ``--limits``, whose value `current_limits` returns."""
    return click.option(
        "--limits",
        callback=_keep,
        expose_value=False,
        metavar="NAME=N,…",
        help="What reading may cost: memory=2GiB, splats=10M, cameras=100k, and expansion=256, "
        "bytes of memory for a byte of the file. Beyond them exit status 5.",
    )(command)


def current_limits() -> Limits:
    """Return the limits that the running command was given, or the defaults."""
    context = click.get_current_context(silent=True)
    found = context.meta.get(_KEY) if context else None
    return found if isinstance(found, Limits) else Limits()


def limits_of(text: str) -> Limits:
    """Read ``memory=2GiB,splats=10M``; what is not named keeps its default.

    Raises
    ------
    click.BadParameter
        A name that is no limit, one given twice, or a value that is no number.
    """
    limits = Limits()
    seen: set[str] = set()
    for part in text.split(","):
        name, _, value = (piece.strip() for piece in part.partition("="))
        if name in seen:
            raise click.BadParameter(f"{name} twice, expected it once")
        seen.add(name)
        if name == "memory":
            limits = replace(limits, decoded_bytes=number_of_bytes(value))
        elif name == "expansion":
            limits = replace(limits, expansion=_count(value), foreign_expansion=_count(value))
        elif name == "splats":
            limits = replace(limits, splats=_count(value))
        elif name == "cameras":
            limits = replace(limits, cameras=_count(value))
        else:
            raise click.BadParameter(f"{part.strip()!r}, {_EXPECTED}")
    return limits


def _keep(context: click.Context, parameter: click.Parameter, value: str | None) -> None:
    if value is not None:
        context.meta[_KEY] = limits_of(value)


def _count(text: str) -> int:
    match = _COUNT.fullmatch(text)
    if not match:
        raise click.BadParameter(f"{text!r}, {_EXPECTED}")
    return int(match[1]) * _THOUSANDS[match[2].lower()]
