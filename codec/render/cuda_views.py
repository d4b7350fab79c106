"""Views of a scene on a CUDA device, drawn with gsplat.

The CPU projects, so that every splat is as thick as in other pictures. gsplat (Ye et al. 2024)
computes colours, tile lists by depth, and pairs of a pixel and a splat. The weight of each pair is
computed here by the rules of `blending`, because gsplat caps alpha at 0.999 and 3DGS at 0.99.

Results agree with the CPU only up to rounding: the device adds in a different order in every run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.frustum import NEAR
from cogsplat.codec.geometry.sh import COLOUR_OFFSET
from cogsplat.codec.splats import Splats

from .blend_weights import PEAK, SQUARE, WEIGHT
from .cuda_device import cuda_device, within_device_memory
from .cuda_pairs import Pairs, drawn_pairs
from .projection import (
    FLAT,
    HALF_HEIGHT,
    NARROW,
    OPACITY,
    SHEAR,
    Footprints,
    X,
    Y,
    project,
)
from .sensitivities import COLUMNS, SQUARES
from .tiles import TILE

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
# PyTorch is an optional dependency, so its tensors have no static type here.
Tensor = Any

# Pixels whose pairs are in memory at once; a pixel has some 50 pairs of a hundred bytes each.
_BAND_PIXELS: Final = 1 << 17
# Initial transmittance passed to gsplat, so that it lists every pair drawn here. gsplat ends a
# pixel at 1e-4 and caps alpha at 0.999. Here two alphas of 0.99 end a pixel, so at most one splat
# in front of a drawn one is ten times as dense in gsplat: a factor of 100 more than covers it.
_OPEN: Final = 100.0
_ALL: Final = 1 << 30
# Larger than any picture, px; tiles of float32 boxes stay exact.
_LARGEST_RADIUS: Final = 1 << 22


class CudaView:
    """Footprints of a scene seen by a camera, and its pairs of pixel and splat, on a CUDA device.

    Create it with `CudaScene.view`.

    Attributes
    ----------
    footprints : Footprints
        Footprints of M splats, from `projection.project`.
    colours : (M, 3) float32
        Colours of the footprints in this view.
    """

    def __init__(self, camera: Camera, footprints: Footprints, colours: Tensor) -> None:
        import torch

        self._camera = camera
        self._drawn: tuple[tuple[float, ...], Tensor] | None = None
        self.footprints = footprints
        self.colours: F32 = colours.cpu().numpy()
        device = colours.device
        self._colours = colours.double()
        self._ellipse = torch.tensor(footprints.ellipse, device=device)
        # Footprints are sorted, and gsplat sorts by depth: a footprint's number stands for it.
        self._depths = torch.arange(1, len(footprints) + 1, device=device, dtype=torch.float32)
        conics, radii = _conics_and_radii(footprints)
        self._conics = torch.tensor(conics, device=device)
        self._radii = torch.tensor(radii, device=device)

    def picture(self, background: Sequence[float]) -> F32:
        """Return the picture over a background, (H, W, 3) float32; see `rasteriser.render`."""
        with within_device_memory():
            picture = self._pictures(background).float().cpu().numpy()
        shape = (self._camera.height, self._camera.width, 3)
        return np.ascontiguousarray(picture.reshape(shape), np.float32)

    def weights(self, top_k: int, least_weight: float) -> F64:
        """Return sums of weights over pixels, (M, 3) float64; see `blend_weights.add_weights`."""
        import torch

        sums = torch.zeros((len(self.colours), 3), dtype=torch.float64, device=self._depths.device)
        with within_device_memory():
            for pairs in self.pairs():
                weight = pairs.weight
                kept = pairs.largest(top_k) if top_k else weight >= least_weight
                sums[:, WEIGHT].index_add_(0, pairs.splat, weight * kept)
                sums[:, SQUARE].index_add_(0, pairs.splat, weight * weight)
                peaks = torch.zeros_like(sums[:, PEAK])
                peaks.scatter_reduce_(0, pairs.splat, weight, "amax")
                sums[:, PEAK] = torch.maximum(sums[:, PEAK], peaks)
        return self._array(sums)

    def moments(self, tiles: NDArray[np.bool_]) -> F64:
        """Return the sums from which sensitivities are computed.

        Parameters
        ----------
        tiles : (T,) bool
            Mask of the tiles of the picture that are measured.

        Returns
        -------
        (M, 13) float64
            The first ten columns are the moments of each footprint (see `sensitivities._moments`).
        """
        import torch

        sums = torch.zeros(
            (len(self.colours), COLUMNS), dtype=torch.float64, device=self._depths.device
        )
        by_tile = tiles.reshape(-1, -(-self._camera.width // TILE))
        pixels = by_tile.repeat(TILE, 0).repeat(TILE, 1)
        pixels = pixels[: self._camera.height, : self._camera.width].ravel()
        measured = torch.tensor(pixels, device=self._depths.device)
        with within_device_memory():
            # Without a background, as in `add_moments`.
            pictures = self._pictures((0.0, 0.0, 0.0))
            for pairs in self.pairs():
                by_log_alpha = pairs.colour_derivatives(self._colours, pictures)
                counts = measured[pairs.pixel]
                g = by_log_alpha.square().sum(1) * (pairs.free & counts)
                u, v = pairs.u.double(), pairs.v.double()
                powers = ((0, 0), (2, 0), (1, 1), (0, 2), (4, 0), (3, 1), (2, 2), (1, 3), (0, 4))
                for column, (p, q) in enumerate(powers):
                    sums[:, column].index_add_(0, pairs.splat, g * u**p * v**q)
                squares = pairs.weight.square() * counts
                sums[:, SQUARES].index_add_(0, pairs.splat, squares)
        return self._array(sums)

    def loss_sums(self, by_picture: F32, background: Sequence[float]) -> F64:
        """Return a loss's gradient sums by footprint, for back-propagation.

        Parameters
        ----------
        by_picture : (H, W, 3) float32
            Derivative of the loss w.r.t. the picture over the background.
        background : sequence of float
            Background colour, RGB.

        Returns
        -------
        (M, 10) float64
            Derivatives w.r.t. the three colour channels; then the moments 1, u, v, uu, uv, vv of g,
            the derivative w.r.t. ln alpha in a pixel; then the squared change of the picture if the
            splat is deleted.
        """
        import torch

        device = self._depths.device
        by = torch.tensor(by_picture, device=device).double().reshape(-1, 3)
        sums = torch.zeros((len(self.colours), 10), dtype=torch.float64, device=device)
        with within_device_memory():
            pictures = self._pictures(background)
            for pairs in self.pairs():
                by_pair = by[pairs.pixel]
                by_log_alpha = pairs.colour_derivatives(self._colours, pictures)
                g = (by_pair * by_log_alpha).sum(1) * pairs.free
                u, v = pairs.u.double(), pairs.v.double()
                terms = [*(pairs.weight[:, None] * by_pair).unbind(1)]
                terms += [g, g * u, g * v, g * u * u, g * u * v, g * v * v]
                terms.append(by_log_alpha.square().sum(1))
                for column, term in enumerate(terms):
                    sums[:, column].index_add_(0, pairs.splat, term)
        return self._array(sums)

    def pairs(self) -> Iterator[Pairs]:
        """Yield the pairs of pixel and splat, one horizontal band of the picture at a time."""
        import gsplat
        import torch

        camera = self._camera
        band = max(_BAND_PIXELS // (camera.width * TILE), 1) * TILE
        tiles_x = -(-camera.width // TILE)
        for top in range(0, camera.height if len(self.colours) else 0, band):
            height = min(band, camera.height - top)
            tiles_y = -(-height // TILE)
            centres = self._ellipse[:, [X, Y]] - torch.tensor(
                [0.0, float(top)], device=self._depths.device
            )
            _, crossings, members = gsplat.isect_tiles(
                centres[None], self._radii[None], self._depths[None], TILE, tiles_x, tiles_y
            )
            if len(members) == 0:
                continue
            splat, pixel, _ = gsplat.rasterize_to_indices_in_range(
                0,
                _ALL,
                torch.full((1, height, camera.width), _OPEN, device=self._depths.device),
                centres[None],
                self._conics[None],
                self._ellipse[None, :, OPACITY],
                camera.width,
                height,
                TILE,
                gsplat.isect_offset_encode(crossings, 1, tiles_x, tiles_y),
                members,
            )
            yield drawn_pairs(splat, pixel + top * camera.width, self._ellipse, camera.width)

    def _pictures(self, background: Sequence[float]) -> Tensor:
        """Return the picture by pixel, (H·W, 3) float64; the last picture is cached."""
        if self._drawn is None or self._drawn[0] != tuple(background):
            self._drawn = tuple(background), self._draw(background)
        return self._drawn[1]

    def _draw(self, background: Sequence[float]) -> Tensor:
        """Draw the picture by pixel, (H·W, 3) float64."""
        import torch

        camera = self._camera
        device = self._depths.device
        behind = torch.tensor(tuple(background), dtype=torch.float64, device=device)
        pictures = behind.repeat(camera.height * camera.width, 1)
        for pairs in self.pairs():
            # A splat replaces the background by its own colour, in proportion to its weight.
            colours = self._colours[pairs.splat] - behind
            pictures.index_add_(0, pairs.pixel, pairs.weight[:, None] * colours)
        return pictures

    def _array(self, tensor: Tensor) -> F64:
        """Copy a tensor to a float64 array in memory."""
        return np.asarray(tensor.cpu().numpy(), np.float64)


def _conics_and_radii(footprints: Footprints) -> tuple[F32, NDArray[np.int32]]:
    """Return gsplat's form of ellipses: inverse covariances xx, xy, yy, and half sizes in px.

    Returns
    -------
    conics : (M, 3) float32
        Inverse covariances, 1/px².
    radii : (M, 2) int32
        Half width and half height of the box around the pixels that a footprint may reach.
    """
    ellipse = footprints.ellipse.astype(np.float64)
    narrow, shear, flat = ellipse[:, NARROW], ellipse[:, SHEAR], ellipse[:, FLAT]
    # The exponent is -(narrow · (dx - shear · dy))² - flat · dy².
    xx = 2.0 * narrow * narrow
    conics = np.stack([xx, -xx * shear, xx * shear * shear + 2.0 * flat], axis=1)
    half_height = ellipse[:, HALF_HEIGHT]
    # var_x = 1 / xx + shear² · var_y, and the half sizes are to each other as the deviations.
    half_width = half_height * np.sqrt(2.0 * flat / xx + shear * shear)
    reach = np.stack([half_width, half_height], axis=1)
    radii = np.ceil(np.minimum(reach * (1.0 + 1e-6) + 0.01, _LARGEST_RADIUS))
    return conics.astype(np.float32), radii.astype(np.int32)


class CudaScene:
    """Splats of a scene, whose views are drawn on the CUDA device.

    Parameters
    ----------
    splats : Splats
        Scene; splats that cannot be drawn are ignored.

    Raises
    ------
    MissingExtraError
        The device is not available; see `cuda_device`.
    LimitError
        ``device-memory``: the device is out of memory, here or in any method of a view.
    """

    def __init__(self, splats: Splats) -> None:
        device = cuda_device()
        import torch

        self._splats = splats
        with within_device_memory():
            self._means = torch.tensor(splats.means, device=device)
            self._coefficients = torch.cat(
                [
                    torch.tensor(splats.sh0, device=device)[:, None],
                    torch.tensor(splats.shN, device=device),
                ],
                dim=1,
            )

    def view(
        self,
        camera: Camera,
        *,
        reduction: float = 1.0,
        near_plane: float = NEAR,
        sh_degree: int | None = None,
    ) -> CudaView:
        """Project the scene into a camera.

        Parameters
        ----------
        camera, reduction, near_plane
            See `projection.project`, which projects on the CPU.
        sh_degree : int or None
            Highest SH degree used; None for the scene's own.
        """
        import gsplat
        import torch

        footprints = project(self._splats, camera, reduction=reduction, near_plane=near_plane)
        with within_device_memory():
            device = self._means.device
            shown = torch.tensor(footprints.index, device=device).long()
            position = torch.tensor(camera.position, dtype=torch.float32, device=device)
            own = self._splats.sh_degree
            colours = gsplat.spherical_harmonics(
                own if sh_degree is None else min(own, sh_degree),
                self._means[shown] - position,
                self._coefficients[shown],
            )
            return CudaView(camera, footprints, (colours + COLOUR_OFFSET).clamp(min=0.0))
