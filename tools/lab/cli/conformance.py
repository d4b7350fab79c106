"""``cogsplat lab conformance``: the group of commands that test decoders of COGS."""

from __future__ import annotations

from typing import Final

import click

from cogsplat.tools.terminal.lazy_group import LazyGroup

_MODULES: Final = {"run": "conformance_run.run", "fuzz": "conformance_fuzz.fuzz"}


@click.group(
    cls=LazyGroup,
    modules={name: f"{__package__}.{place}" for name, place in _MODULES.items()},
)
def conformance() -> None:
    """Test a decoder of COGS against the conformance vectors."""
