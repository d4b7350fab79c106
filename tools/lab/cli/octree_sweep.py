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
"""Orders whose octree has all leaves at `OrderConfig.octree_depth`."""


@dataclass(frozen=True)
class Curve:
    """An order to measure.

    Parameters
    ----------
    label : str
        Name in charts and tables.
    order : str
        Name of the order (`order_rows`).
    config : OrderConfig
        Parameters of the order.
    """

    label: str
    order: str
    config: OrderConfig


def depths(text: str) -> tuple[int, ...]:
    """Parse depths of octrees such as ``1,2,3,5,7``.

    Raises
    ------
    click.BadParameter
        The text is no list of depths.
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
        help="Measure octree-round-robin and octree-quota at each of these depths instead of "
        "--octree-depth.",
    )(command)


def require_octree(names: Sequence[str], octree_depths: Sequence[int] | None) -> None:
    """Refuse octree depths without an order that has a depth.

    Raises
    ------
    click.UsageError
        There are depths, and no order is one of `OF_ONE_DEPTH`.
    """
    if octree_depths and not any(split_name(name)[0] in OF_ONE_DEPTH for name in names):
        raise click.UsageError(
            f"--octree-depths with the orders {', '.join(names)}, expected "
            f"{' or '.join(OF_ONE_DEPTH)} among them"
        )


def curves(
    names: Sequence[str], config: OrderConfig, octree_depths: Sequence[int] | None
) -> list[Curve]:
    """Return the curves to measure, by order and then by depth.

    Parameters
    ----------
    names : sequence of str
        Orders.
    config : OrderConfig
        Parameters of all orders.
    octree_depths : sequence of int or None
        Octree depths, each a curve of its own (PRoGS, figure 6); None for the depth of `config`.
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
