"""Quality of each object of a scene: PSNR over the pixels covered by the object."""

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

# Value of sh0 for white; its negative is black, because a colour is 0.5 + C0 · sh0 in 3DGS.
_WHITE: Final = 0.5 / C0
_CHANNELS: Final = 3

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class ObjectQuality:
    """PSNR of one object against the reference.

    Parameters
    ----------
    object : int
        Label of the object.
    views : int
        Number of test views that show the object.
    pixels : int
        Number of pixels that the object covers in all views.
    psnr_db, worst_db : float or None
        Mean and lowest PSNR over the views that show the object, dB; None if no view does.
    """

    object: int
    views: int
    pixels: int
    psnr_db: float | None
    worst_db: float | None


def object_pixels(
    splats: Splats, labels: NDArray[np.uint32], known: NDArray[np.uint32], camera: Camera
) -> NDArray[np.int32]:
    """Return the object that each pixel of a view shows.

    Parameters
    ----------
    splats : Splats
        The reference.
    labels : (N,) uint32
        Object label of each splat.
    known : (L,) uint32
        Labels of all objects.
    camera : Camera
        The view.

    Returns
    -------
    (H, W) int32
        Index into `known` of the object with the largest sum of blend weights in the pixel; -1 if
        the background's weight is larger.
    """
    from cogsplat.codec.render.rasteriser import RenderConfig, render

    config = RenderConfig(threads=1)
    plain = splats.without_extras().with_sh_degree(0)
    weights = np.zeros((camera.height, camera.width, len(known)), np.float32)
    for start in range(0, len(known), _CHANNELS):
        # Render three objects at once, each white in one colour channel and black in the others, so
        # that a channel of the image is the sum of an object's blend weights.
        group = known[start : start + _CHANNELS]
        in_group = labels[:, None] == np.resize(group, _CHANNELS)
        sh0 = np.where(in_group, _WHITE, -_WHITE).astype(np.float32)
        picture = render(replace(plain, sh0=sh0), camera, config)
        weights[..., start : start + len(group)] = picture[..., : len(group)]
    best = weights.argmax(axis=2).astype(np.int32)
    best_weight = np.take_along_axis(weights, best[..., None], axis=2)[..., 0]
    return np.where(best_weight > 1.0 - weights.sum(axis=2), best, np.int32(-1))


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
        Scene with labels in the attribute ``object``; its renders define the objects' pixels.
    other : Splats
        Scene to measure; its labels, if any, are ignored.
    cameras : sequence of Camera
        Test views, at least one.
    background : tuple of float
        RGB colour of the background.
    threads : int
        Number of threads, 0 for all cores; the results are equal for any number.
    progress : Progress
        Called with the stage ``objects``, views done and views.

    Returns
    -------
    list of ObjectQuality
        Objects by ascending label, including label 0 for splats without an object.

    Raises
    ------
    DataError
        ``no-objects`` or ``bad-objects``, see `labels_of`; ``no-cameras``.
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
    """Compare several versions of a scene with the reference, object by object.

    Parameters
    ----------
    reference : Splats
        Scene with labels in the attribute ``object``.
    versions : sequence of Splats
        Versions of the scene to measure.
    cameras, background, threads, progress
        See `object_qualities`.

    Returns
    -------
    list of list of ObjectQuality
        Objects of each version, by ascending label.

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

    def draw(splats: Splats, camera: Camera) -> NDArray[np.float32]:
        config = RenderConfig(
            background=background,
            threads=1,
        )
        return render(splats, camera, config)

    def measure(camera: Camera) -> list[list[tuple[int, float]]]:
        shown = object_pixels(reference, labels, known, camera)
        expected = draw(reference, camera)
        masks = [shown == row for row in range(len(known))]
        found = []
        for version in versions:
            picture = draw(version, camera)
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
    return [_over_views(known, [view[index] for view in views]) for index in range(len(versions))]


def _over_views(
    known: NDArray[np.uint32], views: Sequence[Sequence[tuple[int, float]]]
) -> list[ObjectQuality]:
    """Combine each object's pixel count and PSNR over all views."""
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
