"""Photos of a scene, and the PSNR of renders against the photos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.metrics import psnr
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count
from cogsplat.formats.storage.pictures import read_picture
from cogsplat.formats.storage.siblings import sibling

# Image formats that cameras and training code write.
_FORMATS = ("PNG", "JPEG", "WEBP")


@dataclass(frozen=True, eq=False)
class Photos:
    """Photos of some views, and the source scene's PSNR against the photos.

    Parameters
    ----------
    cameras : sequence of Camera
        Views of the photos.
    pictures : sequence of (H, W, 3) uint8
        Photo of each camera, of the camera's size.
    source_db : float
        Mean PSNR of the source's renders against the photos, dB.
    """

    cameras: Sequence[Camera]
    pictures: Sequence[NDArray[np.uint8]]
    source_db: float

    def psnr_db(
        self, splats: Splats, background: tuple[float, float, float], *, threads: int = 0
    ) -> float:
        """Return the mean PSNR of a scene's renders against the photos, dB.

        Parameters
        ----------
        splats : Splats
            Scene to render.
        background : tuple of float
            RGB colour of the background.
        threads : int
            Number of threads, 0 for all cores; the result is equal for any number.
        """
        return _mean_psnr_db(splats, self.cameras, self.pictures, background, threads)


def read_photos(
    folder: Path,
    splats: Splats,
    cameras: Sequence[Camera],
    background: tuple[float, float, float],
    *,
    threads: int = 0,
) -> Photos:
    """Read one photo per camera, and measure the source scene's PSNR against the photos.

    Parameters
    ----------
    folder : Path
        Folder of the photos, whose names are the cameras' names.
    splats : Splats
        The source scene.
    cameras : sequence of Camera
        Views, at least one.
    background : tuple of float
        RGB colour of the background.
    threads : int
        Number of threads, 0 for all cores.

    Raises
    ------
    StorageError
        A photo is missing or cannot be read.
    DataError
        ``photo``: a photo is no PNG, JPEG or WebP, or differs in size from its camera.
    FormatError
        ``photo-name``: a camera's name is a path outside `folder`.
    """
    pictures = _read_pictures(folder, cameras)
    source_db = _mean_psnr_db(splats, cameras, pictures, background, threads)
    return Photos(cameras, pictures, source_db)


def read_ground_truth(folder: Path, cameras: Sequence[Camera]) -> list[NDArray[np.float32]]:
    """Read one photo per camera as the ground truth of training, (H, W, 3), 0 to 1.

    Raises
    ------
    CogsplatError
        As in `read_photos`.
    """
    pictures = _read_pictures(folder, cameras)
    return [pixels.astype(np.float32) / np.float32(255) for pixels in pictures]


def _read_pictures(folder: Path, cameras: Sequence[Camera]) -> list[NDArray[np.uint8]]:
    """Return the photo of each camera, (H, W, 3)."""
    pictures: list[NDArray[np.uint8]] = []
    for index, camera in enumerate(cameras):
        path = sibling(folder, camera.name, f"camera {index}", "photo-name")
        size = camera.width, camera.height
        pixels = read_picture(path, size, code="photo", formats=_FORMATS, convert="RGB")
        pictures.append(pixels.astype(np.uint8, copy=False))
    return pictures


def _mean_psnr_db(
    splats: Splats,
    cameras: Sequence[Camera],
    pictures: Sequence[NDArray[np.uint8]],
    background: tuple[float, float, float],
    threads: int,
) -> float:
    """Return the mean PSNR of a scene's renders against photos, dB."""
    from cogsplat.codec.render.rasteriser import RenderConfig, render

    config = RenderConfig(
        background=background,
        threads=1,
    )

    def measure(index: int) -> float:
        drawn = render(splats, cameras[index], config)
        return psnr(pictures[index].astype(np.float32) / 255, drawn)

    found = list(ordered_map(measure, range(len(cameras)), thread_count(threads)))
    return sum(found) / len(found)
