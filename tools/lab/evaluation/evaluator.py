"""Evaluator: PSNR and SSIM of many versions of a scene against renders of the full scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.metrics import psnr, ssim
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count
from cogsplat.codec.views.roam_views import roam
from cogsplat.tools.evaluation.lpips import Lpips

# Side of the SSIM window (Wang et al. 2004), px.
_MIN_SIDE: Final = 11
# Pixels of reference pictures kept in memory, 12 bytes each; further ones are rendered again.
_CACHED_PIXELS: Final = 1 << 28

Colour = tuple[float, float, float]
Picture = NDArray[np.float32]


@dataclass(frozen=True)
class Figures:
    """PSNR and SSIM of one version against the full scene.

    Parameters
    ----------
    held_out_db, worst_db, roam_db : float
        PSNR: mean and minimum over the test views, mean over the roaming views.
    held_out_ssim, worst_ssim, roam_ssim : float
        SSIM: mean and minimum over the test views, mean over the roaming views.
    worst_view : str
        Name of the test view of the lowest PSNR.
    first_view_db, first_view_ssim : float or None
        PSNR and SSIM at the first view, if there is one.
    held_out_lpips, worst_lpips, roam_lpips : float or None
        LPIPS of the same views, if there are weights; lower is better.
    photos_db : float or None
        Mean PSNR of the test views against photos, if there are any.
    """

    held_out_db: float
    worst_db: float
    roam_db: float
    held_out_ssim: float
    worst_ssim: float
    roam_ssim: float
    worst_view: str
    first_view_db: float | None = None
    first_view_ssim: float | None = None
    held_out_lpips: float | None = None
    worst_lpips: float | None = None
    roam_lpips: float | None = None
    photos_db: float | None = None

    def report(self) -> dict[str, object]:
        """Return the available figures, rounded."""
        found = {field.name: getattr(self, field.name) for field in fields(self)}
        return {
            name: round(value, 5) if isinstance(value, float) else value
            for name, value in found.items()
            if value is not None
        }


@dataclass(frozen=True)
class _ViewQuality:
    """PSNR, SSIM and LPIPS of one version in one view."""

    psnr_db: float
    ssim: float
    lpips: float | None
    photo_db: float | None


class Evaluator:
    """Measures versions of a scene in held-out cameras, roaming views and a first view.

    Parameters
    ----------
    reference : Splats
        Full scene; extra attributes are ignored.
    cameras : sequence of Camera
        Test views; at least one, each side at least 11 px.
    first_view : Camera or None
        Pose that an order is optimised for.
    photos : sequence of (H, W, 3) uint8 or None
        Photos of the test views.
    lpips : Lpips or None
        LPIPS network; None to skip LPIPS.
    background : tuple of float
        RGB behind the splats.
    ssim_border : str
        One of `metrics.SSIM_BORDERS`.
    threads : int
        0 for all cores; the figures do not depend on it.

    Raises
    ------
    DataError
        ``no-cameras``; ``view-too-small``; ``cameras-see-nothing``: all test views show only
        background.
    """

    def __init__(
        self,
        reference: Splats,
        cameras: Sequence[Camera],
        *,
        first_view: Camera | None = None,
        photos: Sequence[NDArray[np.uint8]] | None = None,
        lpips: Lpips | None = None,
        background: Colour = (0.0, 0.0, 0.0),
        ssim_border: str = "valid",
        threads: int = 0,
    ) -> None:
        if not cameras:
            raise DataError("no-cameras", "0 cameras to measure in, expected at least 1")
        self.cameras = list(cameras)
        self._views = [*cameras, *roam(reference, cameras), *([first_view] if first_view else [])]
        self._roaming = slice(len(cameras), len(cameras) * 3)
        self._first = first_view is not None
        self._photos = photos
        self._lpips = lpips
        self._background = background
        self._ssim_border = ssim_border
        self._threads = thread_count(threads)
        self.reference = reference.without_extras()
        for camera in self._views:
            smallest = max(_MIN_SIDE, 0 if lpips is None else lpips.smallest_side)
            if min(camera.width, camera.height) < smallest:
                raise DataError(
                    "view-too-small",
                    f"camera {camera.name!r}: {camera.width}x{camera.height} px, expected at "
                    f"least {smallest} a side to compare by",
                )
        pixels = np.cumsum([camera.width * camera.height for camera in self._views])
        kept = int(np.searchsorted(pixels, _CACHED_PIXELS, side="right"))
        self._cached: list[Picture] = list(
            ordered_map(
                lambda camera: self.draw(reference, camera), self._views[:kept], self._threads
            )
        )
        blank = np.array(background, np.float32)
        test_views = range(len(cameras))
        if not any(bool((self._reference_picture(view) != blank).any()) for view in test_views):
            raise DataError(
                "cameras-see-nothing",
                f"{len(cameras)} views of the reference show nothing but background, expected "
                "some splats in them",
            )

    def draw(self, splats: Splats, camera: Camera) -> Picture:
        """Render a version with the kernel of its `SceneInfo`."""
        from cogsplat.codec.render.rasteriser import RenderConfig, render

        config = RenderConfig(
            background=self._background,
            threads=1,
        )
        return render(splats, camera, config)

    def measure(
        self, versions: Sequence[Splats], *, progress: Progress = silent, stage: str = "measure"
    ) -> list[Figures]:
        """Measure versions of the scene in all test views.

        Parameters
        ----------
        versions : sequence of Splats
        progress : Progress
            Called with `stage`, views done and views.
        stage : str

        Returns
        -------
        list of Figures
            One for each version.
        """
        rows: list[list[_ViewQuality]] = []
        progress(stage, 0, len(self._views))
        for row in ordered_map(
            lambda view: self._measure_view(versions, view), range(len(self._views)), self._threads
        ):
            rows.append(row)
            progress(stage, len(rows), len(self._views))
        return [self._summarise([row[number] for row in rows]) for number in range(len(versions))]

    def _reference_picture(self, view: int) -> Picture:
        """Return the picture of the full scene, from the cache if possible."""
        if view < len(self._cached):
            return self._cached[view]
        return self.draw(self.reference, self._views[view])

    def _measure_view(self, versions: Sequence[Splats], view: int) -> list[_ViewQuality]:
        """Measure all versions in one view."""
        camera, expected = self._views[view], self._reference_picture(view)
        target = None if self._lpips is None else self._lpips.features(expected)
        photo = None
        if self._photos is not None and view < len(self.cameras):
            photo = self._photos[view].astype(np.float32) / 255
        found: list[_ViewQuality] = []
        for splats in versions:
            picture = self.draw(splats, camera)
            distance = None
            if self._lpips is not None and target is not None:
                distance = self._lpips.distance(target, self._lpips.features(picture))
            found.append(
                _ViewQuality(
                    psnr(expected, picture),
                    ssim(expected, picture, border=self._ssim_border),
                    distance,
                    None if photo is None else psnr(photo, picture),
                )
            )
        return found

    def _summarise(self, views: list[_ViewQuality]) -> Figures:
        """Aggregate the views of one version."""
        held, roaming = views[: len(self.cameras)], views[self._roaming]
        worst = min(range(len(held)), key=lambda view: held[view].psnr_db)
        distances = [one.lpips for one in held if one.lpips is not None]
        return Figures(
            held_out_db=_mean([one.psnr_db for one in held]),
            worst_db=held[worst].psnr_db,
            roam_db=_mean([one.psnr_db for one in roaming]),
            held_out_ssim=_mean([one.ssim for one in held]),
            worst_ssim=min(one.ssim for one in held),
            roam_ssim=_mean([one.ssim for one in roaming]),
            worst_view=self.cameras[worst].name,
            first_view_db=views[-1].psnr_db if self._first else None,
            first_view_ssim=views[-1].ssim if self._first else None,
            held_out_lpips=_mean(distances) if distances else None,
            worst_lpips=max(distances) if distances else None,
            roam_lpips=_mean([one.lpips for one in roaming if one.lpips is not None])
            if distances
            else None,
            photos_db=None
            if self._photos is None
            else _mean([one.photo_db for one in held if one.photo_db is not None]),
        )


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)
