"""Description of a scene: texts, views, a camera path, annotations, pictures (SPEC 5.13, 5.14)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera

F64 = NDArray[np.float64]

PICTURES: Final = ("poster", "sky")
"""Names of the pictures, by the owner of their segments (SPEC 5.14)."""


@dataclass(frozen=True, eq=False)
class PathStop:
    """View that a camera path reaches at a time.

    Parameters
    ----------
    time : float
        Time since the start of the path, s.
    camera : Camera
        View at that time, in the frame of the means.
    """

    time: float
    camera: Camera


@dataclass(frozen=True, eq=False)
class CameraPath:
    """Camera path: views at ascending times, the first at 0 s.

    Parameters
    ----------
    stops : tuple of PathStop
        2 to 1,024 stops.
    loop : bool
        Whether the path starts again at its end.
    """

    stops: tuple[PathStop, ...]
    loop: bool = False


@dataclass(frozen=True, eq=False)
class Annotation:
    """Text at a place of the scene.

    Parameters
    ----------
    place : (3,) float64
        Position in the frame of the means.
    title : str
        Title, at most 255 bytes.
    text : str
        Text, at most 4,096 bytes.
    view : Camera, optional
        View from which to look at the place.
    """

    place: F64
    title: str
    text: str = ""
    view: Camera | None = None


@dataclass(frozen=True, eq=False)
class Georeference:
    """Position of the scene on Earth.

    Parameters
    ----------
    crs : str
        Coordinate reference system, such as ``EPSG:4978`` or WKT 2.
    transform : (4, 4) float64
        Matrix from world coordinates (origin + means) to coordinates of the system.
    """

    crs: str
    transform: F64


@dataclass(frozen=True, eq=False)
class Picture:
    """Poster or sky.

    Parameters
    ----------
    media_type : str
        ``image/jpeg`` or ``image/webp``.
    width, height : int
        Size, px. A sky is equirectangular: twice as wide as high.
    rotation : (3, 3) float64, optional
        For a sky: rotation from the frame of the means to the picture's x right, y down, z middle.
    data : bytes, optional
        The picture's file; None where the description alone was read.
    """

    media_type: str
    width: int
    height: int
    rotation: F64 | None = None
    data: bytes | None = None


@dataclass(frozen=True, eq=False)
class Description:
    """Description of a scene (SPEC 5.13). Every field may be missing.

    Parameters
    ----------
    title, text, licence, credits : str, optional
        Texts of at most 255, 16,384, 255 and 1,024 bytes; data, never markup.
    date : str, optional
        Date of the capture in ISO 8601, from ``2026`` to a time with its offset.
    metres_per_unit : float, optional
        Length of a scene unit, m.
    unit : str, optional
        Unit in which viewers show lengths: ``mm``, ``cm``, ``m``, ``km``, ``in`` or ``ft``.
    background : tuple of float, optional
        sRGB colour behind the splats, each 0 to 1.
    views : tuple of Camera
        Named views, at most 256; `Camera.name` is the name, `Camera.target` the point to orbit.
    path : CameraPath, optional
        Camera path.
    annotations : tuple of Annotation
        Texts at places, at most 256.
    georeference : Georeference, optional
        Position on Earth.
    poster : Picture, optional
        Picture to show while the scene loads.
    sky : Picture, optional
        Equirectangular picture behind the splats.

    Examples
    --------
    >>> from cogsplat import Description
    >>> Description(title="Garden", licence="CC-BY-4.0").title
    'Garden'
    """

    title: str | None = None
    text: str | None = None
    licence: str | None = None
    credits: str | None = None
    date: str | None = None
    metres_per_unit: float | None = None
    unit: str | None = None
    background: tuple[float, float, float] | None = None
    views: tuple[Camera, ...] = ()
    path: CameraPath | None = None
    annotations: tuple[Annotation, ...] = ()
    georeference: Georeference | None = None
    poster: Picture | None = None
    sky: Picture | None = None

    @property
    def is_empty(self) -> bool:
        """Whether no field is set."""
        return all(value is None or value == () for value in vars(self).values())

    def pictures(self) -> dict[str, Picture]:
        """Return the pictures by name."""
        found = {"poster": self.poster, "sky": self.sky}
        return {name: picture for name, picture in found.items() if picture is not None}

    def updated(self, other: Description) -> Description:
        """Return the description with every field of another that is set."""
        given = {key: value for key, value in vars(other).items() if value not in (None, ())}
        return replace(self, **given)

    def without_pictures(self) -> Description:
        """Return the description without poster and sky."""
        return replace(self, poster=None, sky=None)

    def with_pictures(self, pictures: Mapping[str, Picture]) -> Description:
        """Return the description with some pictures replaced, by name."""
        poster, sky = pictures.get("poster", self.poster), pictures.get("sky", self.sky)
        return replace(self, poster=poster, sky=sky)
