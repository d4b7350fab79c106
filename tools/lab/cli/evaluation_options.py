"""Parsers of the option values of ``cogsplat lab evaluate``."""

from __future__ import annotations

import click

from cogsplat.formats.scenes.registry import WRITABLE
from cogsplat.formats.storage.byte_counts import ByteCount
from cogsplat.tools.terminal.values import byte_count, object_labels


def shares(text: str) -> tuple[float, ...]:
    """Parse shares of the splats in percent, such as ``1,5,20``, or ``none``.

    Raises
    ------
    click.BadParameter
        The text has another form.
    """
    if text.strip().lower() == "none":
        return ()
    try:
        values = sorted({float(part) / 100 for part in text.split(",")})
    except ValueError:
        values = []
    if not values or not all(0 < value <= 1 for value in values):
        raise click.BadParameter(f"{text!r}, expected percents such as 1,5,20, or none")
    return tuple(values)


def sizes(text: str) -> tuple[ByteCount, ...]:
    """Parse prefix lengths such as ``32KiB,64KiB,10%``, or ``none``.

    Raises
    ------
    click.BadParameter
        The text has another form.
    """
    if text.strip().lower() == "none":
        return ()
    return tuple(byte_count(part) for part in text.split(","))


def codecs(text: str) -> tuple[str, ...]:
    """Parse formats such as ``spz,splat``.

    Raises
    ------
    click.BadParameter
        A format is unknown or only read.
    """
    names = tuple(dict.fromkeys(part.strip() for part in text.split(",")))
    unknown = [name for name in names if name not in WRITABLE]
    if unknown:
        raise click.BadParameter(f"{unknown[0]!r}, expected some of {', '.join(WRITABLE)}")
    return names


def objects(text: str) -> tuple[int, ...]:
    """Parse labels of objects such as ``1,4``; ``all`` gives an empty tuple.

    Raises
    ------
    click.BadParameter
        The text is neither.
    """
    return () if text.strip().lower() == "all" else object_labels(text)
