"""Views of a scene on a CUDA device, projected by gsplat.

gsplat (Ye et al. 2024) computes centres, conics, opacity factors, colours, tile lists by depth, and
pairs of a pixel and a splat. The weight of each pair is computed here by the rules of `blending`,
because gsplat caps alpha at 0.999 and 3DGS at 0.99.

Results agree with the CPU only up to rounding. The device adds in a different order in every run,
gsplat projects in float32, and splats with equal float32 depths keep the order of their rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.frustum import ALPHA_MIN, NEAR
from cogsplat.codec.geometry.sh import COLOUR_OFFSET
from cogsplat.codec.splats import Splats

from .blend_weights import PEAK, SQUARE, WEIGHT
from .cuda_device import cuda_device, within_device_memory
from .cuda_pairs import Pairs, drawn_pairs
from .projection import OPACITY, Footprints, X, Y
from .sensitivities import COLUMNS
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
_FAR: Final = 3e38


class CudaView:
    """Footprints of a scene seen by a camera, and its pairs of pixel and splat, on a CUDA device.

    Create it with `CudaScene.view`.

    Attributes
    ----------
    footprints : Footprints
        Footprints of M splats, equal to `projection.project` up to rounding.
    colours : (M, 3) float32
        Colours of the footprints in this view.
    """

    def __init__(
        self,
        camera: Camera,
        rows: Tensor,
        radii: Tensor,
        depths: Tensor,
        ellipse: Tensor,
        conics: Tensor,
        colours: Tensor,
    ) -> None:
        import torch

        self._camera = camera
        self._drawn: tuple[tuple[float, ...], Tensor] | None = None
        # Nearest first, ties by row.
        nearest = depths.argsort(stable=True)
        self._radii, self._depths = radii[nearest].int(), depths[nearest]
        self._ellipse, self._conics = ellipse[nearest], conics[nearest]
        self._colours = colours[nearest].double()
        self.colours: F32 = colours[nearest].cpu().numpy()
        centre, reach = ellipse[nearest, Y], ellipse[nearest, -1]
        covered = torch.stack(
            [
                (centre - reach - 0.5).clamp(min=0.0).ceil(),
                (centre + reach - 0.5).clamp(max=camera.height - 1.0).floor() + 1.0,
            ],
            dim=1,
        )
        order = rows[nearest].argsort().argsort()
        self.footprints = Footprints(
            index=rows[nearest].int().cpu().numpy(),
            order=order.int().cpu().numpy(),
            ellipse=self._ellipse.cpu().numpy(),
            rows=covered.int().cpu().numpy(),
        )

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

    def moments(self) -> F64:
        """Return the sums from which sensitivities are computed, (M, 13) float64.

        The first nine columns are the moments of each footprint (see `sensitivities._moments`).
        """
        import torch

        sums = torch.zeros(
            (len(self.colours), COLUMNS), dtype=torch.float64, device=self._depths.device
        )
        with within_device_memory():
            # Without a background, as in `add_moments`.
            pictures = self._pictures((0.0, 0.0, 0.0))
            for pairs in self.pairs():
                by_log_alpha = pairs.colour_derivatives(self._colours, pictures)
                g = by_log_alpha.square().sum(1) * pairs.free
                u, v = pairs.u.double(), pairs.v.double()
                powers = ((0, 0), (2, 0), (1, 1), (0, 2), (4, 0), (3, 1), (2, 2), (1, 3), (0, 4))
                for column, (p, q) in enumerate(powers):
                    sums[:, column].index_add_(0, pairs.splat, g * u**p * v**q)
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


class CudaScene:
    """Splats of a scene on the CUDA device.

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

        rows = np.flatnonzero(~splats.invalid_rows())
        with within_device_memory():
            self._rows = torch.tensor(rows, device=device)
            means, scales, quats, opacities, sh0, shN = (
                torch.tensor(array if len(rows) == len(splats) else array[rows], device=device)
                for array in (
                    splats.means, splats.scales, splats.quats, splats.opacities, splats.sh0,
                    splats.shN,
                )
            )  # fmt: skip
            self._means, self._quats = means, quats
            self._scales_linear, self._opacities_unit = scales.exp(), opacities.sigmoid()
            self._coefficients = torch.cat([sh0[:, None], shN], dim=1)
        self._sh_degree = splats.sh_degree

    def view(
        self,
        camera: Camera,
        *,
        kernel_px: float,
        antialiased: bool,
        near_plane: float = NEAR,
        sh_degree: int | None = None,
    ) -> CudaView:
        """Project the scene into a camera.

        Parameters
        ----------
        camera, kernel_px, antialiased, near_plane
            See `projection.project`.
        sh_degree : int or None
            Highest SH degree used; None for the scene's own.
        """
        with within_device_memory():
            return self._view(camera, kernel_px, antialiased, near_plane, sh_degree)

    def _view(
        self,
        camera: Camera,
        kernel_px: float,
        antialiased: bool,
        near_plane: float,
        sh_degree: int | None,
    ) -> CudaView:
        """Project and shade the scene with gsplat."""
        import gsplat
        import torch

        device = self._means.device
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = camera.rotation, camera.translation
        lens = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
        radii, centres, depths, conics, factors = gsplat.fully_fused_projection(
            self._means,
            None,
            self._quats,
            self._scales_linear,
            torch.tensor(pose, dtype=torch.float32, device=device)[None],
            torch.tensor(lens, dtype=torch.float32, device=device)[None],
            camera.width,
            camera.height,
            eps2d=kernel_px,
            near_plane=near_plane,
            far_plane=_FAR,
            calc_compensations=antialiased,
            opacities=self._opacities_unit,
        )
        opacities = self._opacities_unit
        if antialiased:
            opacities = opacities * factors[0]
        shown = ((radii[0] > 0).all(dim=1) & (opacities >= ALPHA_MIN)).nonzero()[:, 0]
        ellipse, on_picture = _ellipse(
            camera, centres[0, shown].double(), conics[0, shown].double(), opacities[shown].double()
        )
        shown = shown[on_picture]
        position = torch.tensor(camera.position, dtype=torch.float32, device=device)
        degree = self._sh_degree if sh_degree is None else min(self._sh_degree, sh_degree)
        colours = gsplat.spherical_harmonics(
            degree, self._means[shown] - position, self._coefficients[shown]
        )
        return CudaView(
            camera,
            rows=self._rows[shown],
            radii=radii[0, shown],
            depths=depths[0, shown],
            ellipse=ellipse[on_picture].float(),
            conics=conics[0, shown],
            colours=(colours + COLOUR_OFFSET).clamp(min=0.0),
        )


def _ellipse(
    camera: Camera, centres: Tensor, conics: Tensor, opacities: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the rows of `Footprints.ellipse`, and a mask of ellipses that reach a pixel centre.

    Parameters
    ----------
    camera : Camera
        Camera of the picture.
    centres : (n, 2) tensor
        Centres of the ellipses, px.
    conics : (n, 3) tensor
        Inverse covariances xx, xy, yy, 1/px².
    opacities : (n,) tensor
        Opacities, 0 to 1.
    """
    import torch

    x, y = centres.unbind(1)
    a, b, c = conics.unbind(1)
    flat = 0.5 * (c - b * b / a)
    cut = (opacities / ALPHA_MIN).log()
    half_height = (cut / flat).sqrt()
    reach = half_height * (c / a).sqrt()
    half_width = (2.0 * cut / a).sqrt()
    on_picture = (x + reach > 0.5) & (x - reach < camera.width - 0.5)
    on_picture &= (y + half_height > 0.5) & (y - half_height < camera.height - 0.5)
    columns = (x, y, (0.5 * a).sqrt(), -b / a, flat, opacities, half_width, half_height)
    return torch.stack(columns, dim=1), on_picture
