"""Object masks of a labelled scene: images of the label at each pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry import sh
from cogsplat.codec.render.rasteriser import render_views
from cogsplat.codec.splats import Splats

_CHANNELS = 3


def synth_masks(
    splats: Splats, labels: NDArray[np.integer], cameras: Sequence[Camera]
) -> list[NDArray[np.uint8]]:
    """Render the object masks of a scene.

    Parameters
    ----------
    splats : Splats
    labels : (N,) integer
        Label of each splat, 0 to 255; 0 for the background.
    cameras : sequence of Camera

    Returns
    -------
    list of (H, W) uint8
        Label with the largest blending weight at each pixel; 0 for empty pixels.
    """
    found = np.unique(labels).tolist()
    best = [np.zeros((camera.height, camera.width), np.float32) for camera in cameras]
    masks = [np.zeros((camera.height, camera.width), np.uint8) for camera in cameras]
    plain = splats.without_extras().with_sh_degree(0)
    # Three labels at a time, one per channel: a splat's colour is 1 in its own and 0 elsewhere.
    for first in range(0, len(found), _CHANNELS):
        group = found[first : first + _CHANNELS]
        marks = np.zeros((len(splats), _CHANNELS), np.float32)
        for channel, label in enumerate(group):
            marks[:, channel] = labels == label
        sh0 = ((marks - sh.COLOUR_OFFSET) / sh.C0).astype(np.float32)
        pictures = render_views(replace(plain, sh0=sh0), cameras)
        for shown, mask, picture in zip(best, masks, pictures, strict=True):
            for channel, label in enumerate(group):
                more = picture[:, :, channel] > shown
                mask[more] = label
                shown[more] = picture[:, :, channel][more]
    return masks
