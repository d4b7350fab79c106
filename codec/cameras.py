"""Pinhole cameras of scoring, training and test views."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .errors import DataError

# Tolerance of a rotation's orthonormality: files store rotations as rounded decimals.
_ROTATION_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class Camera:
    """One pinhole view, world to camera, OpenCV axes (x right, y down, z forward).

    Parameters
    ----------
    width, height : int
        Image size, px; pixel (0, 0) has its centre at (0.5, 0.5).
    fx, fy, cx, cy : float
        Focal lengths and principal point, px.
    rotation : (3, 3) float64
        World to camera: ``x_camera = rotation @ x_world + translation``.
    translation : (3,) float64
        Translation of the pose, scene units.
    name : str
        Name in the source, often an image's file name.
    target : (3,) float64, optional
        Point in front of the camera that an orbit turns around, world coordinates.

    Raises
    ------
    DataError
        ``bad-camera``: a size below 1, a focal length that is not positive and finite, an invalid
        rotation, or a target that does not lie in front of the camera.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    name: str = ""
    target: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        label = f"camera {self.name!r}"
        rotation = np.ascontiguousarray(self.rotation, dtype=np.float64)
        translation = np.ascontiguousarray(self.translation, dtype=np.float64)
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise DataError(
                "bad-camera",
                f"{label}: rotation {rotation.shape} and translation {translation.shape}, "
                "expected (3, 3) and (3,)",
            )
        if not 1 <= self.width <= 65535 or not 1 <= self.height <= 65535:
            raise DataError(
                "bad-camera", f"{label}: size {self.width}x{self.height}, expected 1 to 65535"
            )
        intrinsics = (self.fx, self.fy, self.cx, self.cy)
        if not all(map(math.isfinite, intrinsics)) or self.fx <= 0 or self.fy <= 0:
            raise DataError(
                "bad-camera",
                f"{label}: fx {self.fx}, fy {self.fy}, cx {self.cx}, cy {self.cy}, "
                "expected finite values and positive focal lengths",
            )
        rows = rotation.tolist()
        if not all(map(math.isfinite, [*rows[0], *rows[1], *rows[2], *translation.tolist()])):
            raise DataError("bad-camera", f"{label}: NaN or infinite pose, expected finite numbers")
        # Python floats: numpy takes ten times as long for nine numbers, and models have many views.
        (a, b, c), (d, e, f), (g, h, i) = rows
        lengths = (a * a + b * b + c * c, d * d + e * e + f * f, g * g + h * h + i * i)
        products = (a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i)
        error = max(*(abs(length - 1) for length in lengths), *map(abs, products))
        determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
        # Entries beyond 1e154 overflow: the error is then infinite or NaN, and fails the test.
        if not error <= _ROTATION_TOLERANCE or determinant < 0:
            raise DataError(
                "bad-camera",
                f"{label}: the rotation is off orthonormal by {error:.3g} or mirrored, "
                f"expected a proper rotation within {_ROTATION_TOLERANCE}",
            )
        if self.target is not None:
            self._check_target(np.ascontiguousarray(self.target, dtype=np.float64), label)

    def _check_target(self, target: NDArray[np.float64], label: str) -> None:
        """Store the target as float64; refuse one that does not lie in front of the camera."""
        object.__setattr__(self, "target", target)
        if target.shape != (3,) or not np.isfinite(target).all():
            raise DataError(
                "bad-camera", f"{label}: target {target.tolist()}, expected three finite numbers"
            )
        depth = float((self.rotation[2] * target).sum() + self.translation[2])
        if not depth > 0:
            raise DataError(
                "bad-camera",
                f"{label}: the target lies at depth {depth:.6g}, expected above 0, in front of "
                "the camera",
            )

    @property
    def position(self) -> NDArray[np.float64]:
        """Centre in world coordinates, (3,) float64."""
        centre: NDArray[np.float64] = -self.rotation.T @ self.translation
        return centre

    @property
    def focal_px(self) -> float:
        """Geometric mean of the focal lengths, px."""
        return math.sqrt(self.fx * self.fy)

    def resized(self, width: int, height: int | None = None) -> Camera:
        """Return the camera of the same picture in another number of pixels.

        Parameters
        ----------
        width : int
            New width, px.
        height : int, optional
            New height, px; by default the one of the same aspect ratio, rounded, at least 1.
            Focal lengths and principal point scale by the exact ratio of the sizes along each axis.

        Examples
        --------
        >>> import numpy as np
        >>> from cogsplat.codec.cameras import Camera
        >>> camera = Camera(1920, 1080, 1500.0, 1500.0, 960.0, 540.0, np.eye(3), np.zeros(3))
        >>> small = camera.resized(960)
        >>> small.width, small.height, small.fx, small.cy
        (960, 540, 750.0, 270.0)
        """
        if height is None:
            height = max(1, round(self.height * width / self.width))
        across, down = width / self.width, height / self.height
        return replace(
            self, width=width, height=height, fx=self.fx * across, fy=self.fy * down,
            cx=self.cx * across, cy=self.cy * down,
        )  # fmt: skip

    def downscaled(self, factor: int) -> Camera:
        """Return the camera of the picture that averages squares of `factor` × `factor` pixels.

        Columns at the right and rows at the bottom that do not fill a pixel are cropped.

        Parameters
        ----------
        factor : int
            Downscaling per axis, at least 1.
        """
        return replace(
            self, width=max(self.width // factor, 1), height=max(self.height // factor, 1),
            fx=self.fx / factor, fy=self.fy / factor, cx=self.cx / factor, cy=self.cy / factor,
        )  # fmt: skip
