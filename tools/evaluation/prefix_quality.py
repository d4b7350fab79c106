"""Quality of prefixes of a COGS file: PSNR and SSIM at several lengths."""

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

SHARES: Final = (0.05, 0.1, 0.25, 0.5, 1.0)
"""Shares of a file that are measured."""

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class PrefixQuality:
    """Quality of a prefix of a file against renders of the source.

    Parameters
    ----------
    share : float
        Of the file.
    size_bytes, splats : int
    held_out_db, worst_db, roam_db : float
        PSNR; the mean over the test views, the lowest of them, and the mean over roaming views.
    held_out_ssim, worst_ssim, roam_ssim : float
        Likewise.
    worst_view : str
    photos_db : float or None
        Mean PSNR against photos, where there are any.
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
        """Return the fields as JSON output has them."""
        figures = asdict(self)
        return {"bytes" if name == "size_bytes" else name: x for name, x in figures.items()}


def decode_prefix(
    path: Path, size_bytes: int, *, compensate: bool = False, threads: int = 0
) -> Splats:
    """Decode the complete chunks in the first bytes of a file, as after a broken transfer.

    Parameters
    ----------
    path : Path
    size_bytes : int
    compensate : bool
        Whether prefix compensation is applied (SPEC 8.5).
    threads : int

    Returns
    -------
    Splats
        Without rows where the bytes end inside the index.
    """
    try:
        with cogsplat.open(path, size_bytes=size_bytes) as file:
            return file.decode(compensate=compensate, threads=threads)
    except TruncatedError:
        return empty(0)


def decode_share(path: Path, share: float, *, threads: int = 0) -> Splats:
    """Decode the complete chunks in the first bytes of a file, with prefix compensation.

    Parameters
    ----------
    path : Path
    share : float
        Of the file, above 0 to 1.
    threads : int

    Returns
    -------
    Splats
        Without rows where the bytes end inside the root.
    """
    size_bytes = int(share * path.stat().st_size)
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
    """Measure prefixes of a file at `SHARES` of its length.

    Parameters
    ----------
    path : Path
    source : Splats
        What it was encoded from.
    cameras : sequence of Camera
        Test views; at least one.
    background : tuple of float
        RGB behind the splats.
    photos : Photos, optional
    threads : int
        0 for all cores; the figures do not depend on it.
    progress : Progress
        Called with ``measure``, lengths done and lengths.

    Raises
    ------
    DataError
        See `view_quality.compare`.
    """
    file_bytes = path.stat().st_size
    found: list[PrefixQuality] = []
    progress("measure", 0, len(SHARES))
    for share in SHARES:
        part = decode_share(path, share, threads=threads)
        seen = view_quality.compare(source, part, cameras, background=background, threads=threads)
        found.append(
            PrefixQuality(
                share=share,
                size_bytes=int(share * file_bytes),
                splats=len(part),
                held_out_db=view_quality.mean_psnr_db(seen.held_out),
                worst_db=seen.worst.psnr_db,
                roam_db=view_quality.mean_psnr_db(seen.roaming),
                held_out_ssim=view_quality.mean_ssim(seen.held_out),
                worst_ssim=seen.worst.ssim,
                roam_ssim=view_quality.mean_ssim(seen.roaming),
                worst_view=seen.worst.view,
                photos_db=photos.psnr_db(part, background, threads=threads) if photos else None,
            )
        )
        progress("measure", len(found), len(SHARES))
    return found
