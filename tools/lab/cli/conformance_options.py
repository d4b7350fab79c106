"""Options that the commands of ``cogsplat lab conformance`` share."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Final, TypeVar

import click

from cogsplat.codec.errors import StorageError
from cogsplat.tools.terminal.standard_streams import PATH
from cogsplat.tools.terminal.values import FiniteNumber

Command = TypeVar("Command", bound=Callable[..., object])

MOST_SHOWN: Final = 40
"""Failures that the summary lists at most; ``--json`` lists all."""

VECTORS: Final = click.option(
    "--vectors",
    type=PATH,
    metavar="DIR",
    help="Folder of the conformance vectors.  [default: those of the installed package]",
)
"""The option ``--vectors``."""


def timeout_option(what: str) -> Callable[[Command], Command]:
    """Return the option ``--timeout``; `what` is the noun for what the limit applies to."""
    return click.option(
        "--timeout",
        type=FiniteNumber(min=0, min_open=True),
        default=30.0,
        show_default=True,
        metavar="SECONDS",
        help=f"Time limit for one {what}.",
    )


def own_vectors() -> Path:
    """Return the folder of the conformance vectors: of the installed package, or of the checkout.

    Raises
    ------
    StorageError
        ``not-found``: neither has them.
    """
    # The wheel holds them as package data; a checkout in its folder of tests. The path is resolved
    # because the import package reaches this file through a link.
    installed = Path(str(files("cogsplat") / "vectors"))
    checkout = Path(__file__).resolve().parents[3] / "tests" / "vectors"
    for folder in (installed, checkout):
        if (folder / "manifest.json").is_file():
            return folder
    raise StorageError(
        "not-found",
        f"{checkout}: no vectors here, expected --vectors with the folder tests/vectors of the "
        "source of cogsplat",
    )
