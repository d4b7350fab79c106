"""Options for the order of splats, and the order configuration that they set."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import click

from cogsplat.codec.cameras import Camera
from cogsplat.codec.order import objects
from cogsplat.codec.order.octree import MAX_DEPTH
from cogsplat.codec.order.orders import (
    FIRST_VIEW,
    FRUSTUM,
    ORDERS,
    POSE_RULES,
    OrderConfig,
    split_name,
)
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_text import parse_view
from cogsplat.tools.terminal.standard_streams import PATH
from cogsplat.tools.terminal.values import FiniteNumber

from .inputs import load_cameras

_DEFAULTS: Final = OrderConfig()

# Type, value and help of the options that set a field of `OrderConfig`.
_SETTINGS: Final[dict[str, tuple[click.ParamType[Any], str, str]]] = {
    "first_view_share": (
        FiniteNumber(0, 1),
        "SHARE",
        "With +first-view: share of the splats that the first view moves forward.",
    ),
    "first_view_mix": (
        FiniteNumber(0, 1),
        "SHARE",
        "With +first-view: share of every prefix for the first view until its splats are used up; "
        "with 1, other views come after.",
    ),
    "frustum_share": (
        FiniteNumber(0, 1),
        "SHARE",
        "With +frustum: share of every prefix that lies in the frustum of the first view until "
        "its splats are used up.",
    ),
    "frustum_margin": (
        FiniteNumber(0, 100),
        "SHARE",
        "With +frustum: margin of the frustum at each side, as a share of the image size.",
    ),
    "octree_depth": (
        click.IntRange(0, MAX_DEPTH),
        "N",
        "Depth of the octree of octree-round-robin and octree-quota.",
    ),
    "octree_capacity": (
        click.IntRange(min=1),
        "N",
        "Splats in a leaf of octree-adaptive at most.",
    ),
    "seed": (click.IntRange(min=0), "N", "Seed of the order random."),
}

Budgets = tuple[tuple[int | None, float], ...]


@dataclass(frozen=True)
class OrderChoice:
    """Values of the order options.

    Parameters
    ----------
    names : tuple of str
        Names of orders, such as ``contribution``. A rule for splats that a first view shows may
        follow, as in ``contribution+frustum``. Only ``evaluate`` takes several names.
    ordering : OrderConfig
        Order configuration without a first view.
    view : str or None
        First view: a pose as text, or the index of a camera. None chooses one.
    masks : Path or None
        Folder of masks from which object labels are voted.
    """

    names: tuple[str, ...]
    ordering: OrderConfig
    view: str | None
    masks: Path | None

    @property
    def name(self) -> str:
        """First of `names`: an order with its rule, such as ``contribution+frustum``."""
        return self.names[0]

    @property
    def by_object(self) -> bool:
        """Whether chunks hold splats of one object each."""
        return self.ordering.by_object

    def first_view(self, cameras: Sequence[Camera]) -> str | Camera | None:
        """Return the first view as text or as one of the cameras; None to choose one.

        Parameters
        ----------
        cameras : sequence of Camera
            Cameras that `view` may be an index of.

        Raises
        ------
        click.UsageError
            There is no camera of that index.
        """
        if self.view is None or not self.view.isdecimal():
            return self.view
        if int(self.view) >= len(cameras):
            expected = f"an index of 0 to {len(cameras) - 1}" if cameras else "--cameras"
            raise click.UsageError(f"--view {self.view}, expected {expected}, or a pose")
        return cameras[int(self.view)]

    def config(self, splats: Splats, cameras: Sequence[Camera], threads: int = 0) -> OrderConfig:
        """Return the order configuration, with the first view where an order has a rule for it.

        Parameters
        ----------
        splats : Splats
            Scene, in which a first view is chosen where none is given.
        cameras : sequence of Camera
            Cameras that `view` may be an index of.
        threads : int
        """
        from cogsplat.codec.views.first_look_search import find_first_look

        view = self.first_view(cameras)
        if view is None and not any(split_name(name)[1] for name in self.names):
            return self.ordering
        look = find_first_look(splats, cameras or None, view=view, threads=threads)
        return replace(self.ordering, first_view=look.view)

    def with_labels(
        self, splats: Splats, cameras: Path | None, *, threads: int = 0, progress: Progress = silent
    ) -> Splats:
        """Return the scene with object labels voted by the masks, or unchanged without masks.

        Parameters
        ----------
        splats : Splats
            Scene in the frame of its cameras, before any edit.
        cameras : Path or None
            File of the cameras that the masks belong to.
        threads : int
        progress : Progress

        Raises
        ------
        click.UsageError
            There are masks but no cameras.
        CogsplatError
            The masks cannot be read or match no camera; ``no-objects``, ``bad-objects``,
            ``object-missing``: the scene lacks the objects.
        """
        if self.masks is None:
            if self.by_object:
                objects.require_objects(splats, self.ordering.object_budgets)
            return splats
        if cameras is None:
            raise click.UsageError("--masks without --cameras, expected those the masks belong to")
        from cogsplat.codec.order.objects_from_masks import labels_from_masks
        from cogsplat.tools.pictures.mask_images import read_masks

        views, pictures = read_masks(self.masks, load_cameras(cameras))
        labels = labels_from_masks(splats, views, pictures, threads=threads, progress=progress)
        labelled = objects.with_labels(splats, labels)
        objects.require_objects(labelled, self.ordering.object_budgets)
        return labelled


def parse_order(text: str) -> str:
    """Parse the name of an order, alone or followed by a rule for a first view.

    Raises
    ------
    click.BadParameter
        The text names no order.
    """
    try:
        split_name(text)
    except ValueError:
        raise click.BadParameter(
            f"{text!r}, expected one of {', '.join(ORDERS)}; alone, or followed by "
            f"{' or '.join('+' + rule for rule in POSE_RULES)}"
        ) from None
    return text


def parse_view_option(text: str) -> str:
    """Check the text of a pose, or the index of a camera.

    Raises
    ------
    DataError
        ``bad-view-text``.
    """
    if not text.isdecimal():
        parse_view(text)
    return text


def parse_budgets(text: str) -> Budgets:
    """Parse budgets of objects such as ``20%`` or ``1:50%,2:10%``.

    Raises
    ------
    click.BadParameter
        The text has another form.
    """
    found: dict[int | None, float] = {}
    for part in text.split(","):
        label, colon, share = part.strip().rpartition(":")
        digits = share.removesuffix("%")
        number = digits.replace(".", "", 1)
        known = share.endswith("%") and number.isascii() and number.isdigit()
        named = label.isascii() and label.isdigit() and len(label) <= 10 if colon else True
        key = int(label) if colon and named else None
        if not known or not named or float(digits) > 100 or key in found:
            raise click.BadParameter(
                f"{text!r}, expected a share of every object such as 20%, or of some: 1:50%,2:10%"
            )
        found[key] = float(digits) / 100
    return tuple(found.items())


def parse_orders(text: str) -> tuple[str, ...]:
    """Parse names of orders, separated by commas, or ``all`` for every order without a first view.

    Raises
    ------
    click.BadParameter
        A name is no order.
    """
    if text.strip().lower() == "all":
        return ORDERS
    return tuple(dict.fromkeys(parse_order(part.strip()) for part in text.split(",")))


def _orders_like(ctx: click.Context, parameter: click.Parameter, start: str) -> list[str]:
    """Return the names of orders that complete a word in the shell."""
    return [name for name in ORDERS if name.startswith(start)]


def order_options(command: Callable[..., object]) -> Callable[..., object]:
    """Add ``--order`` and the parameters of orders, passed to the command as ``choice``."""
    option = click.option(
        "--order",
        type=parse_order,
        default="gain",
        show_default=True,
        metavar="NAME",
        shell_complete=_orders_like,
        help=f"Order of the splats: {', '.join(ORDERS)}.",
    )
    return _with_parameters(command, option)


def orders_option(command: Callable[..., object]) -> Callable[..., object]:
    """Add ``--orders`` and the parameters of orders, passed to the command as ``choice``."""
    option = click.option(
        "--orders",
        "order",
        type=parse_orders,
        default="all",
        show_default=True,
        metavar="NAMES",
        help=f"Separated by commas, of {', '.join(ORDERS)}; each may be followed by "
        f"{' or '.join('+' + rule for rule in POSE_RULES)}.",
    )
    return _with_parameters(command, option)


def _order_names(order: str | tuple[str, ...], frustum_share: float | None) -> tuple[str, ...]:
    """Return the names of the orders; refuse a frustum share that no order uses."""
    names = (order,) if isinstance(order, str) else order
    if frustum_share is not None and FRUSTUM not in {split_name(name)[1] for name in names}:
        raise click.UsageError(
            f"--frustum-share with {', '.join(names)}, expected an order followed by +{FRUSTUM}"
        )
    return names


def _setting_option(
    name: str, kind: click.ParamType[Any], metavar: str, text: str
) -> Callable[[Callable[..., object]], Callable[..., object]]:
    """Return the option of an `OrderConfig` field, with the field's default.

    Parameters
    ----------
    name : str
        Field.
    kind : click.ParamType
        Type of the option.
    metavar : str
        Value in the help.
    text : str
        Help.
    """
    default = getattr(_DEFAULTS, name)
    return click.option(
        f"--{name.replace('_', '-')}",
        type=kind,
        default=default,
        show_default=default is not None,
        metavar=metavar,
        help=text,
    )


def _with_parameters(
    command: Callable[..., object], naming: Callable[[Callable[..., object]], Callable[..., object]]
) -> Callable[..., object]:
    """Add an option that names orders, and the options for parameters of orders."""

    @functools.wraps(command)
    def chosen(
        *,
        order: str | tuple[str, ...],
        view: str | None,
        objects: bool,
        object_budgets: Budgets | None,
        masks: Path | None,
        **others: Any,
    ) -> object:
        settings = {name: others.pop(name) for name in _SETTINGS}
        ordering = OrderConfig(
            by_object=objects or masks is not None or object_budgets is not None,
            object_budgets=object_budgets or (),
            **settings,
        )
        names = _order_names(order, ordering.frustum_share)
        return command(choice=OrderChoice(names, ordering, view, masks), **others)

    options: list[Callable[[Callable[..., object]], Callable[..., object]]] = [
        naming,
        click.option(
            "--view",
            type=parse_view_option,
            metavar="POSE|INDEX",
            help="Where viewers start: a pose x,y,z,tx,ty,tz,fov[,roll], or the index of a camera "
            f"of --cameras, from 0. An order followed by +{FIRST_VIEW} or +{FRUSTUM} serves it "
            "first.  [default: chosen by what it shows]",
        ),
        *(_setting_option(name, *setting) for name, setting in _SETTINGS.items()),
        click.option(
            "--objects",
            is_flag=True,
            help=f"Fill each chunk with one object, by the attribute {objects.ATTRIBUTE!r}.",
        ),
        click.option(
            "--object-budgets",
            type=parse_budgets,
            metavar="P%|N:P%,…",
            help="Send this share of every object, or of object N, before the rest, objects of "
            "larger contribution first.",
        ),
        click.option(
            "--masks",
            type=PATH,
            metavar="DIR",
            help="Folder of masks, named like the cameras, from which splats get object labels: 0 "
            "is no object.",
        ),
    ]
    decorated: Callable[..., object] = chosen
    for option in reversed(options):
        decorated = option(decorated)
    return decorated
