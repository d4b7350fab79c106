"""Quality of prefixes of a COGS file: PSNR and SSIM at several sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import TruncatedError
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.scoring import view_quality
from cogsplat.codec.splats import Splats, empty

from .photos import Photos

PREFIX_FRACTIONS: Final = (0.05, 0.1, 0.25, 0.5, 1.0)
"""Sizes of the measured prefixes, as fractions of the file."""

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class PrefixQuality:
    """Quality of a prefix of a file against renders of the source.

    Parameters
    ----------
    share : float
        Size of the prefix, as a fraction of the file.
    size_bytes : int
        Size of the prefix, bytes.
    splats : int
        Number of splats in the prefix.
    held_out_db, worst_db, roam_db : float
        PSNR, dB: mean over the test views, lowest of the test views, mean over roaming views.
    held_out_ssim, worst_ssim, roam_ssim : float
        SSIM: mean over the test views, SSIM of the view `worst_view`, mean over roaming views.
    worst_view : str
        Name of the test view with the lowest PSNR.
    photos_db : float or None
        Mean PSNR against photos, dB; None without photos.
    """

    share: float
    size_bytes: int
    splats: int
    held_out_db: float
    worst_db: float
    roam_db: float
    held_out_ssim: float
    worst_ssim: float
    roam_ssim: float
    worst_view: str
    photos_db: float | None

    def report(self) -> dict[str, object]:
        """Return the fields by their names in JSON output."""
        figures = asdict(self)
        return {"bytes" if name == "size_bytes" else name: x for name, x in figures.items()}


def decode_prefix(
    path: Path, size_bytes: int, *, compensate: bool = False, threads: int = 0
) -> Splats:
    """Decode the complete chunks in the first bytes of a file.

    Parameters
    ----------
    path : Path
        The COGS file.
    size_bytes : int
        Size of the prefix, bytes.
    compensate : bool
        Whether prefix compensation is applied (SPEC 8.5).
    threads : int
        Number of threads, 0 for all cores.

    Returns
    -------
    Splats
        The decoded splats; none if the prefix ends inside the index.
    """
    try:
        with cogsplat.open(path, size_bytes=size_bytes) as file:
            return file.decode(compensate=compensate, threads=threads)
    except TruncatedError:
        return empty(0)


def decode_fraction(path: Path, fraction: float, *, threads: int = 0) -> Splats:
    """Decode the complete chunks in a fraction of a file, with prefix compensation.

    Parameters
    ----------
    path : Path
        The COGS file.
    fraction : float
        Size of the prefix, as a fraction of the file, above 0 and up to 1.
    threads : int
        Number of threads, 0 for all cores.

    Returns
    -------
    Splats
        The decoded splats; none if the prefix ends inside the index.
    """
    size_bytes = int(fraction * path.stat().st_size)
    return decode_prefix(path, size_bytes, compensate=True, threads=threads)


def measure(
    path: Path,
    source: Splats,
    cameras: Sequence[Camera],
    *,
    background: Colour = (0.0, 0.0, 0.0),
    photos: Photos | None = None,
    threads: int = 0,
    progress: Progress = silent,
) -> list[PrefixQuality]:
    """Measure the quality of a file's prefixes at `PREFIX_FRACTIONS`.

    Parameters
    ----------
    path : Path
        The COGS file.
    source : Splats
        Scene from which the file was encoded.
    cameras : sequence of Camera
        Test views, at least one.
    background : tuple of float
        RGB colour of the background.
    photos : Photos, optional
        Photos to measure against as well.
    threads : int
        Number of threads, 0 for all cores; the results are equal for any number.
    progress : Progress
        Called with ``measure``, prefixes done and prefixes.

    Raises
    ------
    DataError
        See `view_quality.compare`.
    """
    file_bytes = path.stat().st_size
    found: list[PrefixQuality] = []
    progress("measure", 0, len(PREFIX_FRACTIONS))
    for fraction in PREFIX_FRACTIONS:
        prefix = decode_fraction(path, fraction, threads=threads)
        compared = view_quality.compare(
            source, prefix, cameras, background=background, close=False, threads=threads
        )
        found.append(
            PrefixQuality(
                share=fraction,
                size_bytes=int(fraction * file_bytes),
                splats=len(prefix),
                held_out_db=view_quality.mean_psnr_db(compared.test),
                worst_db=compared.worst.psnr_db,
                roam_db=view_quality.mean_psnr_db(compared.roaming),
                held_out_ssim=view_quality.mean_ssim(compared.test),
                worst_ssim=compared.worst.ssim,
                roam_ssim=view_quality.mean_ssim(compared.roaming),
                worst_view=compared.worst.view,
                photos_db=photos.psnr_db(prefix, background, threads=threads) if photos else None,
            )
        )
        progress("measure", len(found), len(PREFIX_FRACTIONS))
    return found
