"""First look of an encode's scene, by its request."""

from __future__ import annotations

from dataclasses import replace

from cogsplat.codec.order.orders import split_name
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.first_look import FirstLook
from cogsplat.codec.views.first_look_search import find_first_look

from .request import EncodeRequest


def find_look_of(splats: Splats, request: EncodeRequest) -> tuple[FirstLook, EncodeRequest]:
    """Find the first look of a scene that is to be encoded.

    Parameters
    ----------
    splats : Splats
        Scene in the frame of the request's cameras.
    request : EncodeRequest
        `EncodeRequest.up` and `EncodeRequest.view` are used where they are given. Without a view,
        the first view of the order is taken.

    Returns
    -------
    (FirstLook, EncodeRequest)
        The look, and the request. An order with a rule for the first view has that view.
    """
    config = request.config
    look = find_first_look(
        splats,
        request.cameras,
        up=request.up,
        view=request.view or config.ordering.first_view,
        threads=config.threads,
    )
    if split_name(config.order)[1]:
        ordering = replace(config.ordering, first_view=look.view)
        request = replace(request, config=replace(config, ordering=ordering))
    return look, request
