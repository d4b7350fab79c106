"""Curves of ``cogsplat lab evaluate``: one for each order, octree orders at each depth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeVar

import click

from cogsplat.codec.order.octree import MAX_DEPTH
from cogsplat.codec.order.orders import OrderConfig, split_name

Command = TypeVar("Command", bound=Callable[..., object])

OF_ONE_DEPTH: Final = ("octree-round-robin", "octree-quota")
"""Orders whose octree has all its leaves at `OrderConfig.octree_depth`."""


@dataclass(frozen=True)
class Curve:
    """An order that is measured.

    Parameters
    ----------
    label : str
        As figures and tables call it.
    order : str
        As `order_rows` takes it.
    config : OrderConfig
    """

    label: str
    order: str
    config: OrderConfig


def depths(text: str) -> tuple[int, ...]:
    """Parse depths of octrees such as ``1,2,3,5,7``.

    Raises
    ------
    click.BadParameter
        They are none.
    """
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isascii() and part.isdigit() and len(part) <= 3 for part in parts) or not all(
        int(part) <= MAX_DEPTH for part in parts
    ):
        raise click.BadParameter(f"{text!r}, expected depths from 0 to {MAX_DEPTH} such as 1,3,5")
    return tuple(dict.fromkeys(int(part) for part in parts))


def octree_depths_option(command: Command) -> Command:
    """Add ``--octree-depths``."""
    return click.option(
        "--octree-depths",
        type=depths,
        metavar="N,…",
        help="Measure octree-round-robin and octree-quota at each of these depths, one curve for "
        "each, in place of --octree-depth.",
    )(command)


def require_octree(names: Sequence[str], octree_depths: Sequence[int] | None) -> None:
    """Refuse depths where no order has one.

    Raises
    ------
    click.UsageError
        There are depths, and none of the orders is one of `OF_ONE_DEPTH`.
    """
    if octree_depths and not any(split_name(name)[0] in OF_ONE_DEPTH for name in names):
        raise click.UsageError(
            f"--octree-depths with the orders {', '.join(names)}, expected "
            f"{' or '.join(OF_ONE_DEPTH)} among them"
        )


def curves(
    names: Sequence[str], config: OrderConfig, octree_depths: Sequence[int] | None
) -> list[Curve]:
    """Return what to measure, in the order of the names and then of the depths.

    Parameters
    ----------
    names : sequence of str
        Orders.
    config : OrderConfig
        Of all of them.
    octree_depths : sequence of int or None
        Depths that replace the configuration's, where an order has one (PRoGS, figure 6).
    """
    found = []
    for name in names:
        if octree_depths and split_name(name)[0] in OF_ONE_DEPTH:
            found += [
                Curve(f"{name} depth {depth}", name, replace(config, octree_depth=depth))
                for depth in octree_depths
            ]
        else:
            found.append(Curve(name, name, config))
    return found
