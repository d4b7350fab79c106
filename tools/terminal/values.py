"""Parsers of option values: byte and splat counts, ranges, colours, sizes, vectors, boxes."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

import click

from cogsplat.formats.storage.byte_counts import ByteCount, parse_byte_count, parse_bytes

_COUNT: Final = re.compile(r"([0-9]{1,12}(?:\.[0-9]{1,9})?)(%?)")
_RANGE: Final = re.compile(r"([0-9]{0,9}):([0-9]{0,9})")
_SIZE: Final = re.compile(r"([0-9]{1,6})[x×]([0-9]{1,6})", re.IGNORECASE)
_HEXADECIMAL: Final = re.compile(r"#[0-9A-Fa-f]{6}")
_COLOURS: Final = {"black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0)}

# Digits of the largest label, 2³² - 1.
_LABEL_DIGITS: Final = 10

MAX_SIDE: Final = 16384
"""Largest side of a rendered picture, px."""

Colour = tuple[float, float, float]
Vector = tuple[float, float, float]
Box = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class ChunkRange:
    """A half-open range of chunk numbers; None leaves an end open."""

    first: int | None
    last: int | None


@dataclass(frozen=True)
class SplatCount:
    """A number of splats, or a share of a scene's splats.

    Parameters
    ----------
    amount : Fraction
        Number of splats, or share.
    is_share : bool
        Whether `amount` is a share, above 0 and at most 1.
    """

    amount: Fraction
    is_share: bool

    def of(self, splats: int) -> int:
        """Return the number of splats to keep of `splats`, rounded up."""
        return min(math.ceil(self.amount * splats if self.is_share else self.amount), splats)


class FiniteNumber(click.FloatRange):
    """Parameter type of a finite number, in a range where one is given.

    click compares a number with the ends of its range, and a comparison with NaN is false.
    """

    def convert(
        self, value: float, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number; refuse text that is none, NaN, infinity and a number out of range."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value!r}, expected a finite number", param, ctx)
        return number


def object_labels(text: str) -> tuple[int, ...]:
    """Parse labels of objects such as ``3`` or ``1,4``.

    Raises
    ------
    click.BadParameter
        The text is no list of labels.
    """
    parts = [part.strip() for part in text.split(",")]
    if all(part.isascii() and part.isdigit() and len(part) <= _LABEL_DIGITS for part in parts):
        return tuple(dict.fromkeys(int(part) for part in parts))
    raise click.BadParameter(f"{text!r}, expected labels of objects such as 3 or 1,4")


def byte_count(text: str) -> ByteCount:
    """Parse a byte count or a share, such as ``65536``, ``64KiB``, ``1.5MB`` or ``20%``.

    Raises
    ------
    click.BadParameter
        The text is neither.
    """
    try:
        return parse_byte_count(text)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


def number_of_bytes(text: str) -> int:
    """Parse a byte count such as ``65536``, ``64KiB`` or ``1.5MB``.

    Raises
    ------
    click.BadParameter
        The text is no byte count.
    """
    try:
        return parse_bytes(text)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


def splat_count(text: str) -> SplatCount:
    """Parse a number of splats or a share, such as ``20000`` or ``25%``.

    Raises
    ------
    click.BadParameter
        The text is neither.
    """
    match = _COUNT.fullmatch(text.strip())
    amount = Fraction(match[1]) if match else Fraction(0)
    if match and match[2] and 0 < amount <= 100:
        return SplatCount(amount / 100, is_share=True)
    if match and not match[2] and amount >= 1 and amount.denominator == 1:
        return SplatCount(amount, is_share=False)
    raise click.BadParameter(f"{text!r}, expected splats such as 20000, or a share such as 25%")


def chunk_range(text: str) -> ChunkRange:
    """Parse a half-open range ``A:B``; either end may be left out.

    Raises
    ------
    click.BadParameter
        The text is no range.
    """
    match = _RANGE.fullmatch(text.strip())
    if not match:
        raise click.BadParameter(f"{text!r}, expected A:B in whole numbers, such as 0:8 or 3:")
    first, last = (int(end) if end else None for end in match.groups())
    return ChunkRange(first, last)


def colour(text: str) -> Colour:
    """Parse a colour: ``R,G,B`` in [0, 1], ``#rrggbb``, ``black`` or ``white``.

    Raises
    ------
    click.BadParameter
        The text is no colour.
    """
    if text.strip().lower() in _COLOURS:
        return _COLOURS[text.strip().lower()]
    if _HEXADECIMAL.fullmatch(text.strip()):
        red, green, blue = bytes.fromhex(text.strip()[1:])
        return red / 255, green / 255, blue / 255
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(0.0 <= number <= 1.0 for number in numbers):
        raise click.BadParameter(
            f"{text!r}, expected #rrggbb, three numbers from 0 to 1 such as 0.6,0,0.4, black or "
            "white"
        )
    return numbers[0], numbers[1], numbers[2]


def picture_size(text: str) -> tuple[int, int]:
    """Parse a picture size ``WxH``, px.

    Raises
    ------
    click.BadParameter
        The text is no size, or a side is out of range.
    """
    match = _SIZE.fullmatch(text.strip())
    sides = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(1 <= side <= MAX_SIDE for side in sides):
        raise click.BadParameter(
            f"{text!r}, expected pixels such as 1280x720, each side 1 to {MAX_SIDE}"
        )
    return sides


def vector(text: str) -> Vector:
    """Parse a vector ``X,Y,Z`` of finite numbers.

    Raises
    ------
    click.BadParameter
        The text is no vector.
    """
    match _finite_numbers(text):
        case [x, y, z]:
            return x, y, z
        case _:
            raise click.BadParameter(f"{text!r}, expected three numbers such as 0,-90,0")


def box(text: str) -> Box:
    """Parse a box ``XMIN,YMIN,ZMIN,XMAX,YMAX,ZMAX`` of finite numbers, minima before maxima.

    Raises
    ------
    click.BadParameter
        The text is no box.
    """
    match _finite_numbers(text):
        case [a, b, c, d, e, f] if a <= d and b <= e and c <= f:
            return a, b, c, d, e, f
        case _:
            raise click.BadParameter(
                f"{text!r}, expected six numbers, the minima before the maxima, "
                "such as -1,-1,-1,1,1,1"
            )


def _finite_numbers(text: str) -> list[float]:
    """Return numbers separated by commas, nothing unless all are finite."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        return []
    return numbers if all(math.isfinite(number) for number in numbers) else []
