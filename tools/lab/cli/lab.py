"""``cogsplat lab``: the group of commands that measure codecs and test decoders."""

from __future__ import annotations

from typing import Final

import click

from cogsplat.tools.terminal.lazy_group import LazyGroup

_MODULES: Final = {
    "score": "score.score",
    "order": "order.order",
    "views": "views.views",
    "evaluate": "evaluate.evaluate",
    "simulate": "simulate.simulate",
    "bench": "bench.bench",
    "synth": "synth.synth",
    "conformance": "conformance.conformance",
    "warm": "warm.warm",
}


@click.group(
    cls=LazyGroup,
    modules={name: f"{__package__}.{place}" for name, place in _MODULES.items()},
    epilog="\b\nExample:\n"
    "  cogsplat lab synth scene.ply\n"
    "  cogsplat lab bench scene.ply --cameras scene.cameras.json",
)
def lab() -> None:
    """Measure codecs, make test scenes and test decoders."""
