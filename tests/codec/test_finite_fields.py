"""Settings refuse NaN and infinity in every field that holds numbers."""

import dataclasses
import importlib
import math
import pkgutil
from collections.abc import Iterator

import pytest

import cogsplat.codec
import cogsplat.formats
from cogsplat.codec.encode.config import Target

# Measurements and contents of files, which no user sets.
NO_SETTINGS = {"EncodeReport", "SceneInfo", "Traffic"}


def settings() -> Iterator[object]:
    """Yield an instance of every dataclass of the library that has defaults for all fields."""
    seen = set()
    for package in (cogsplat.codec, cogsplat.formats):
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            try:
                module = importlib.import_module(found.name)
            except ModuleNotFoundError as error:
                if error.name != "torch":
                    raise
                continue
            for kind in vars(module).values():
                if isinstance(kind, type) and dataclasses.is_dataclass(kind) and kind not in seen:
                    seen.add(kind)
                    try:
                        yield kind()
                    except (TypeError, ValueError):
                        continue


def changed(value: object, number: float) -> object:
    """Return a value with its first float replaced, None if it holds none."""
    if isinstance(value, float):
        return number
    if isinstance(value, tuple) and value and isinstance(value[0], float):
        return (number, *value[1:])
    if isinstance(value, dict) and value and isinstance(next(iter(value.values())), float):
        return {**value, next(iter(value)): number}
    return None


FIELDS = [
    (config, field.name)
    for config in settings()
    for field in dataclasses.fields(config)  # type: ignore[arg-type]
    if type(config).__name__ not in NO_SETTINGS
    if field.init and changed(getattr(config, field.name), 0.0) is not None
]


def test_the_settings_of_the_library_are_found() -> None:
    names = {type(config).__name__ for config, _ in FIELDS}
    assert {"EncodeConfig", "OrderConfig", "TuneConfig", "NetworkOptions", "LevelsConfig"} <= names


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("config", "name"), FIELDS, ids=[f"{type(c).__name__}.{name}" for c, name in FIELDS]
)
def test_numbers_of_settings_are_finite(config: object, name: str, number: float) -> None:
    values = {name: changed(getattr(config, name), number)}
    with pytest.raises(ValueError, match="expected"):
        dataclasses.replace(config, **values)  # type: ignore[type-var]


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_a_target_is_finite(number: float) -> None:
    with pytest.raises(ValueError, match="expected a finite number"):
        Target(psnr_db=number)
