"""Quality of each object of a scene: PSNR over the pixels that the object covers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.geometry.sh import C0
from cogsplat.codec.metrics import psnr
from cogsplat.codec.order import objects
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

# A colour is 0.5 + C0 · sh0 in 3DGS: these two are one and zero.
_ONE: Final = 0.5 / C0
_CHANNELS: Final = 3

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class ObjectQuality:
    """PSNR of one object against the full scene.

    Parameters
    ----------
    object : int
        Its label.
    views : int
        Test views that show it.
    pixels : int
        That it covers in all of them.
    psnr_db, worst_db : float or None
        Over its pixels: the mean of those views and the lowest; None where no view shows it.
    """

    object: int
    views: int
    pixels: int
    psnr_db: float | None
    worst_db: float | None


def object_pixels(
    splats: Splats, labels: NDArray[np.uint32], known: NDArray[np.uint32], camera: Camera
) -> NDArray[np.int32]:
    """Say which object each pixel shows.

    Parameters
    ----------
    splats : Splats
        The full scene.
    labels : (N,) uint32
        Of its splats.
    known : (L,) uint32
        Labels to look for.
    camera : Camera

    Returns
    -------
    (H, W) int32
        Row of `known` whose splats have the largest sum of blend weights in the pixel; -1 where
        what is left for the background is more than that.
    """
    from cogsplat.codec.render.rasteriser import RenderConfig, render

    config = RenderConfig(
        kernel_px=splats.info.kernel_px, antialiased=splats.info.antialiased, threads=1
    )
    plain = splats.without_extras().with_sh_degree(0)
    weights = np.zeros((camera.height, camera.width, len(known)), np.float32)
    for start in range(0, len(known), _CHANNELS):
        # Three labels in a picture: white in the channel of its own, black in the others, so that
        # a pixel's colour is the sum of the weights.
        some = known[start : start + _CHANNELS]
        belongs = labels[:, None] == np.resize(some, _CHANNELS)
        sh0 = np.where(belongs, _ONE, -_ONE).astype(np.float32)
        picture = render(replace(plain, sh0=sh0), camera, config)
        weights[..., start : start + len(some)] = picture[..., : len(some)]
    most = weights.argmax(axis=2).astype(np.int32)
    shown = np.take_along_axis(weights, most[..., None], axis=2)[..., 0]
    return np.where(shown > 1.0 - weights.sum(axis=2), most, np.int32(-1))


def object_qualities(
    reference: Splats,
    other: Splats,
    cameras: Sequence[Camera],
    *,
    background: Colour = (0.0, 0.0, 0.0),
    threads: int = 0,
    progress: Progress = silent,
) -> list[ObjectQuality]:
    """Compare two scenes object by object.

    Parameters
    ----------
    reference : Splats
        With labels in the attribute ``object``; its full render says which pixels an object has.
    other : Splats
        Its labels, if any, play no part.
    cameras : sequence of Camera
        At least one.
    background : tuple of float
        RGB behind the splats.
    threads : int
        0 for all cores; the figures do not depend on it.
    progress : Progress
        Called with the stage ``objects``, views done and views.

    Returns
    -------
    list of ObjectQuality
        By rising label; label 0, of splats of no object, is among them.

    Raises
    ------
    DataError
        ``no-objects`` or ``bad-objects`` as `labels_of`; ``no-cameras``.
    """
    return object_qualities_of(
        reference, [other], cameras, background=background, threads=threads, progress=progress
    )[0]


def object_qualities_of(
    reference: Splats,
    versions: Sequence[Splats],
    cameras: Sequence[Camera],
    *,
    background: Colour = (0.0, 0.0, 0.0),
    threads: int = 0,
    progress: Progress = silent,
) -> list[list[ObjectQuality]]:
    """Compare versions of a scene with it, object by object, as `object_qualities` does.

    Parameters
    ----------
    reference : Splats
    versions : sequence of Splats
    cameras, background, threads, progress
        See `object_qualities`.

    Returns
    -------
    list of list of ObjectQuality
        Of each version, by rising label.

    Raises
    ------
    DataError
        See `object_qualities`.
    """
    from cogsplat.codec.render.rasteriser import RenderConfig, render

    if not cameras:
        raise DataError("no-cameras", "0 cameras to compare with, expected at least 1")
    labels = objects.labels_of(reference)
    known = np.unique(labels)

    def drawn(splats: Splats, camera: Camera) -> NDArray[np.float32]:
        config = RenderConfig(
            kernel_px=splats.info.kernel_px,
            antialiased=splats.info.antialiased,
            background=background,
            threads=1,
        )
        return render(splats, camera, config)

    def measure(camera: Camera) -> list[list[tuple[int, float]]]:
        shown = object_pixels(reference, labels, known, camera)
        expected = drawn(reference, camera)
        masks = [shown == row for row in range(len(known))]
        found = []
        for version in versions:
            picture = drawn(version, camera)
            found.append(
                [
                    (int(mask.sum()), psnr(expected[mask], picture[mask]) if mask.any() else 0.0)
                    for mask in masks
                ]
            )
        return found

    views: list[list[list[tuple[int, float]]]] = []
    progress("objects", 0, len(cameras))
    for found in ordered_map(measure, cameras, thread_count(threads)):
        views.append(found)
        progress("objects", len(views), len(cameras))
    return [_summed(known, [view[number] for view in views]) for number in range(len(versions))]


def _summed(
    known: NDArray[np.uint32], views: Sequence[Sequence[tuple[int, float]]]
) -> list[ObjectQuality]:
    """Return the quality of each object from its pixels and its PSNR in every view."""
    qualities = []
    for row, label in enumerate(known):
        own = [view[row] for view in views if view[row][0]]
        figures = [db for _, db in own]
        qualities.append(
            ObjectQuality(
                object=int(label),
                views=len(own),
                pixels=sum(count for count, _ in own),
                psnr_db=sum(figures) / len(figures) if figures else None,
                worst_db=min(figures) if figures else None,
            )
        )
    return qualities
