"""Refusal of NaN and infinity in the settings of a dataclass."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def require_finite(settings: DataclassInstance) -> None:
    """Refuse NaN and infinity in the fields of a dataclass, also in tuples and mappings.

    Called before the ranges are checked: a comparison with NaN is false, so NaN passes most ranges.

    Parameters
    ----------
    settings : dataclass
        Settings that a user chose.

    Raises
    ------
    ValueError
        A number is NaN or infinite.
    """
    for field in fields(settings):
        for number in _floats(getattr(settings, field.name)):
            if not math.isfinite(number):
                raise ValueError(f"{field.name} {number}, expected a finite number")


def _floats(value: object) -> Iterator[float]:
    """Yield the floats of a value, of the items of a tuple, or of the values of a mapping."""
    if isinstance(value, float):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _floats(item)
    elif isinstance(value, Mapping):
        yield from _floats(tuple(value.values()))
