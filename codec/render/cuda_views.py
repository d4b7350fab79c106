"""Views of a scene on a CUDA device, where gsplat projects splats and lists what reaches a pixel.

gsplat (Ye et al. 2024) gives centres, conics, opacity factors, colours, lists by tile in the order
of depth, and pairs of a pixel and a splat. What each pair weighs follows here from the rules of
`blending`, because gsplat's own blend caps alpha at 0.999 where 3DGS and we do at 0.99. The same
rules hold, but not to the bit: the device adds in another order at every run, gsplat projects in
float32, and splats whose depths are equal in float32 keep the order of their rows.
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
# PyTorch comes with an extra: its tensors have no type here.
Tensor = Any

# Pixels whose pairs are held at once: a hundred bytes for each of some 50 pairs in a pixel.
_BAND_PIXELS: Final = 1 << 17
# gsplat ends a pixel at a transmittance of 1e-4 after alphas of at most 0.999. Two alphas of 0.99
# end it here, so that one pixel goes on behind at most one that the other cap makes ten times as
# dense. Begun with a hundred times the transmittance, gsplat lists all that we draw, and more.
_OPEN: Final = 100.0
_ALL: Final = 1 << 30
_FAR: Final = 3e38


class CudaView:
    """A scene seen by a camera, on the device.

    Made by `CudaScene.view`.

    Attributes
    ----------
    footprints : Footprints
        M of them, as `projection.project` gives, but for rounding.
    colours : (M, 3) float32
        That they show to the camera.
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
        """Return the picture over a background: (H, W, 3) float32, as `rasteriser.render`."""
        with within_device_memory():
            picture = self._pictures(background).float().cpu().numpy()
        shape = (self._camera.height, self._camera.width, 3)
        return np.ascontiguousarray(picture.reshape(shape), np.float32)

    def weights(self, top_k: int, least_weight: float) -> F64:
        """Return sums over pixels: (M, 3) float64, as `blend_weights.add_weights` adds them."""
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
        """Return moments: (M, 13) float64, as `sensitivities.add_moments` adds them."""
        import torch

        sums = torch.zeros(
            (len(self.colours), COLUMNS), dtype=torch.float64, device=self._depths.device
        )
        with within_device_memory():
            # As there, without a background.
            pictures = self._pictures((0.0, 0.0, 0.0))
            for pairs in self.pairs():
                g = pairs.lost(self._colours, pictures).square().sum(1) * pairs.free
                u, v = pairs.u.double(), pairs.v.double()
                powers = ((0, 0), (2, 0), (1, 1), (0, 2), (4, 0), (3, 1), (2, 2), (1, 3), (0, 4))
                for column, (p, q) in enumerate(powers):
                    sums[:, column].index_add_(0, pairs.splat, g * u**p * v**q)
        return self._array(sums)

    def loss_sums(self, by_picture: F32, background: Sequence[float]) -> F64:
        """Return what a loss asks of the footprints.

        Parameters
        ----------
        by_picture : (H, W, 3) float32
            Derivative of the loss by the picture over the background.
        background : sequence of float

        Returns
        -------
        (M, 10) float64
            Derivatives by the three colours; with g the derivative by ln alpha in a pixel, its
            moments 1, u, v, uu, uv, vv; the squared change of the picture without the splat.
        """
        import torch

        device = self._depths.device
        by = torch.tensor(by_picture, device=device).double().reshape(-1, 3)
        sums = torch.zeros((len(self.colours), 10), dtype=torch.float64, device=device)
        with within_device_memory():
            pictures = self._pictures(background)
            for pairs in self.pairs():
                by_pair = by[pairs.pixel]
                lost = pairs.lost(self._colours, pictures)
                g = (by_pair * lost).sum(1) * pairs.free
                u, v = pairs.u.double(), pairs.v.double()
                terms = [*(pairs.weight[:, None] * by_pair).unbind(1)]
                terms += [g, g * u, g * v, g * u * u, g * u * v, g * v * v, lost.square().sum(1)]
                for column, term in enumerate(terms):
                    sums[:, column].index_add_(0, pairs.splat, term)
        return self._array(sums)

    def pairs(self) -> Iterator[Pairs]:
        """Yield the pairs of bands of the picture, from top to bottom."""
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
        """Return the picture by pixel, (H·W, 3) float64; the one drawn last is kept."""
        if self._drawn is None or self._drawn[0] != tuple(background):
            self._drawn = tuple(background), self._draw(background)
        return self._drawn[1]

    def _draw(self, background: Sequence[float]) -> Tensor:
        import torch

        camera = self._camera
        device = self._depths.device
        behind = torch.tensor(tuple(background), dtype=torch.float64, device=device)
        pictures = behind.repeat(camera.height * camera.width, 1)
        for pairs in self.pairs():
            # A splat takes what is behind away and puts its own colour there.
            colours = self._colours[pairs.splat] - behind
            pictures.index_add_(0, pairs.pixel, pairs.weight[:, None] * colours)
        return pictures

    def _array(self, tensor: Tensor) -> F64:
        return np.asarray(tensor.cpu().numpy(), np.float64)


class CudaScene:
    """The splats of a scene on the device.

    Parameters
    ----------
    splats : Splats
        Rows that cannot be drawn are left out.

    Raises
    ------
    MissingExtraError
        As `cuda_device`.
    LimitError
        ``device-memory``, here and from all methods, of views too.
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
            As in `projection.project`.
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
    """Return the columns of `Footprints.ellipse`, and which of them reach a pixel's centre."""
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
