"""Capture viewpoints of an encode's scene, by its request."""

from __future__ import annotations

import numpy as np

from cogsplat.codec.splats import Splats
from cogsplat.codec.views.capture_choice import choose_capture
from cogsplat.codec.views.first_look import FirstLook
from cogsplat.codec.views.trained_at import parse_trained_at

from .request import EncodeRequest


def with_capture_of(splats: Splats, request: EncodeRequest, look: FirstLook) -> Splats:
    """Return the scene with the capture viewpoints that its request states.

    Parameters
    ----------
    splats : Splats
        Scene in the frame of the request's cameras.
    request : EncodeRequest
        `EncodeRequest.trained_at` replaces the scene's own viewpoints. Without either, those of the
        cameras are taken.
    look : FirstLook
        First look of the scene, whose core box says where its middle is.
    """
    if request.trained_at is None:
        return splats.with_capture(choose_capture(splats, request.cameras or ()))
    core_box = np.zeros(6) if look.core_box is None else look.core_box
    return splats.without_capture().with_capture(
        parse_trained_at(request.trained_at).capture(core_box)
    )
