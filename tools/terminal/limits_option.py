"""``--limits``: bounds on memory and counts, for every command that reads."""

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
        callback=_store,
        expose_value=False,
        metavar="NAME=N,…",
        help="Limits on what is read: memory=2GiB, splats=10M, cameras=100k, and expansion=256 "
        "bytes of memory per byte of the file. Exit status 5 beyond a limit.",
    )(command)


def current_limits() -> Limits:
    """Return the limits of the running command, or the defaults."""
    context = click.get_current_context(silent=True)
    found = context.meta.get(_KEY) if context else None
    return found if isinstance(found, Limits) else Limits()


def limits_of(text: str) -> Limits:
    """Parse limits such as ``memory=2GiB,splats=10M``; unnamed limits keep their defaults.

    Raises
    ------
    click.BadParameter
        An unknown name, a name given twice, or a value that is no number.
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


def _store(context: click.Context, parameter: click.Parameter, value: str | None) -> None:
    """Store the parsed limits with the running command."""
    if value is not None:
        context.meta[_KEY] = limits_of(value)


def _count(text: str) -> int:
    """Parse a count such as ``10M``."""
    match = _COUNT.fullmatch(text)
    if not match:
        raise click.BadParameter(f"{text!r}, {_EXPECTED}")
    return int(match[1]) * _THOUSANDS[match[2].lower()]
