"""Differentiable rendering: pictures of a scene, and gradients back to all splat values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.render.cuda_views import CudaScene, CudaView
from cogsplat.codec.render.projection import Footprints, project
from cogsplat.codec.render.rasteriser import RenderConfig, cuda_view
from cogsplat.codec.render.shading import footprint_colours
from cogsplat.codec.render.tiles import TileLists, add_pair_sums, tile_lists
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .splat_kernels import add_colour_gradients, add_shape_gradients
from .tile_kernels import SUMS, differentiate_tiles, draw_tiles

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Gradients:
    """Gradients of a loss w.r.t. all values of a scene, in arrays named as in `Splats`.

    Parameters
    ----------
    means : (N, 3) float32
        Gradient w.r.t. means, per scene unit.
    scales : (N, 3) float32
        Gradient w.r.t. log scales.
    quats : (N, 4) float32
        Gradient w.r.t. quaternions as stored, not normalised; it is orthogonal to them.
    opacities : (N,) float32
        Gradient w.r.t. opacity logits.
    sh0, shN : (N, 3) float32, (N, K-1, 3) float32
        Gradient by SH coefficients.
    """

    means: F32
    scales: F32
    quats: F32
    opacities: F32
    sh0: F32
    shN: F32  # noqa: N815 - the field's name

    @classmethod
    def zeros(cls, splats: Splats) -> Gradients:
        """Return gradients of zero for a scene."""
        return cls(**{name: np.zeros_like(getattr(splats, name)) for name in cls.names()})

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of the arrays: means, scales, quats, opacities, sh0, shN."""
        return tuple(cls.__dataclass_fields__)

    def clear(self) -> None:
        """Set all gradients to 0, in place."""
        for name in self.names():
            getattr(self, name).fill(0.0)

    def times(self, factor: float) -> Gradients:
        """Return the gradients multiplied by a factor."""
        return Gradients(
            **{name: np.float32(factor) * getattr(self, name) for name in self.names()}
        )

    def add(self, others: Gradients, rows: NDArray[np.int64] | None = None) -> None:
        """Add gradients of the same scene or of a subset of its splats, in place.

        Parameters
        ----------
        others : Gradients
            Gradients to add.
        rows : (n,) int64, optional
            Row of each splat of `others` in this scene, without duplicates. All rows by default.
        """
        at = slice(None) if rows is None else rows
        for name in self.names():
            getattr(self, name)[at] += getattr(others, name)


def with_values(splats: Splats, values: Mapping[str, F32]) -> Splats:
    """Return a copy of a scene with some arrays replaced, by array name."""
    arrays: dict[str, Any] = dict(values)
    return replace(splats, **arrays)


@dataclass(frozen=True, eq=False)
class ForwardPass:
    """A rendered picture, with the intermediate results that its backward pass needs.

    Parameters
    ----------
    splats, camera, config
        Arguments of `render_forward`. The arrays of the splats must not change before `backward`.
    footprints : Footprints
        Projected splats, M of them.
    colours : (M, 3) float32
        Colour of each footprint towards the camera.
    picture : (H, W, 3) float32
        Picture in the scene's colour space, not clipped; bit for bit that of `rasteriser.render`.
    lists : sequence of TileLists
        Footprints of each tile, front to back.
    stops : sequence of (tiles,) int64
        For each tile, the position in its list where all its pixels became opaque.
    on_device : CudaView or None
        View on a CUDA device, if it was rendered there; `lists` and `stops` are empty then.
    """

    splats: Splats
    camera: Camera
    config: RenderConfig
    footprints: Footprints
    colours: F32
    picture: F32
    lists: Sequence[TileLists]
    stops: Sequence[NDArray[np.int64]]
    on_device: CudaView | None = None

    def backward(self, by_picture: F32, gradients: Gradients) -> F64:
        """Add the gradients of a loss w.r.t. all splat values.

        Parameters
        ----------
        by_picture : (H, W, 3) float32
            Gradient of the loss w.r.t. the picture.
        gradients : Gradients
            Gradients of the scene, changed in place.

        Returns
        -------
        (M, 2) float64
            Gradient w.r.t. the image-space centre of each footprint, 1/px, which 3DGS densifies by.
            Row k belongs to splat ``footprints.index[k]``.
        """
        return self.add_gradients(self.footprint_sums(by_picture), gradients)

    def footprint_sums(self, by_picture: F32) -> F64:
        """Run the per-pixel half of the backward pass, which is most of its work.

        It changes no shared state: several views can run it in parallel.

        Parameters
        ----------
        by_picture : (H, W, 3) float32
            Gradient of the loss w.r.t. the picture.

        Returns
        -------
        (M, SUMS) float64
            Sums over pixels for each footprint (`tile_kernels.SUMS`), the argument of
            `add_gradients`.
        """
        if self.on_device is not None:
            return self.on_device.loss_sums(by_picture, self.config.background)
        sums = np.zeros((len(self.footprints), SUMS), np.float64)
        threads = thread_count(self.config.threads)
        for lists, stops in zip(self.lists, self.stops, strict=True):
            pair_sums = np.empty((len(lists.members), SUMS), np.float32)
            differentiate = partial(
                differentiate_tiles,
                lists.first,
                lists.starts,
                stops,
                lists.members,
                self.footprints.ellipse,
                self.footprints.rows,
                self.colours,
                self.picture,
                np.ascontiguousarray(by_picture, np.float32),
                pair_sums,
            )
            lists.for_ranges(differentiate, threads)
            add_pair_sums(lists.members, pair_sums, sums, 0)
        return sums

    def add_gradients(self, sums: F64, gradients: Gradients) -> F64:
        """Run the per-splat half of the backward pass.

        Call it for views in a fixed order: sums then do not depend on the number of threads.

        Parameters
        ----------
        sums : (M, SUMS) float64
            Sums from `footprint_sums`.
        gradients : Gradients
            Gradients of the scene, changed in place.

        Returns
        -------
        (M, 2) float64
            Gradient w.r.t. the image-space centre of each footprint, 1/px, as from `backward`.
        """
        splats, camera, footprints = self.splats, self.camera, self.footprints
        centres = np.empty((len(footprints), 2), np.float64)
        higher = splats.shN.shape[1]
        degree = {0: 0, 3: 1, 8: 2, 15: 3}[higher]
        if self.config.sh_degree is not None:
            degree = min(degree, self.config.sh_degree)
        order = footprints.row_order()
        colour = partial(
            add_colour_gradients,
            order,
            footprints.index,
            sums,
            self.colours,
            splats.means,
            splats.shN,
            camera.position,
            degree,
            gradients.means,
            gradients.sh0,
            gradients.shN,
        )
        shape = partial(
            add_shape_gradients,
            order,
            footprints.index,
            sums,
            footprints.ellipse,
            splats.means,
            splats.scales,
            splats.quats,
            splats.opacities,
            camera.rotation,
            camera.translation,
            np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float64),
            camera.width,
            camera.height,
            self.footprints.added,
            gradients.means,
            gradients.scales,
            gradients.quats,
            gradients.opacities,
            centres,
        )

        def add_range(rows: tuple[int, int]) -> None:
            colour(*rows)
            shape(*rows)

        threads = thread_count(self.config.threads)
        edges = np.linspace(0, len(footprints), threads + 1).astype(np.int64).tolist()
        # No two footprints share a row, so threads write to different rows.
        for _ in ordered_map(add_range, pairwise(edges), threads):
            pass
        return centres


def render_forward(
    splats: Splats, camera: Camera, config: RenderConfig | None = None
) -> ForwardPass:
    """Render a view and keep the intermediate results for its backward pass.

    Parameters
    ----------
    splats : Splats
        Scene to render, with the kernel of `Splats.info`; rows that cannot be drawn are skipped.
    camera : Camera
        Camera in the frame of the means.
    config : RenderConfig or None
        Render settings; None for the defaults.

    Returns
    -------
    ForwardPass

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.fit.differentiable_rendering import Gradients, render_forward
    >>> import cogsplat
    >>> splats = cogsplat.read("scene.ply")
    >>> camera = cogsplat.read_cameras("cameras.json")[0]
    >>> forward = render_forward(splats, camera)
    >>> gradients = Gradients.zeros(splats)
    >>> grey = np.full_like(forward.picture, 0.5)
    >>> by_centres = forward.backward(2.0 * (forward.picture - grey), gradients)
    >>> by_centres.shape[0] == len(forward.footprints), bool(np.abs(gradients.sh0).max() > 0)
    (True, True)
    """
    config = config or RenderConfig()
    if config.device == "cuda":
        view = cuda_view(CudaScene(splats), camera, config)
        picture = view.picture(config.background)
        return ForwardPass(
            splats, camera, config, view.footprints, view.colours, picture, (), (), view
        )
    footprints = project(splats, camera, reduction=config.reduction, near_plane=config.near_plane)
    colours = footprint_colours(splats, camera, footprints, sh_degree=config.sh_degree)
    present = np.ones(len(footprints), np.bool_)
    picture = np.empty((camera.height, camera.width, 3), np.float32)
    all_lists = list(tile_lists(footprints, camera.width, camera.height))
    all_stops = [np.empty(lists.last - lists.first, np.int64) for lists in all_lists]
    for lists, stops in zip(all_lists, all_stops, strict=True):
        part = partial(
            draw_tiles,
            lists.first,
            lists.starts,
            lists.members,
            footprints.ellipse,
            footprints.rows,
            colours,
            present,
            np.array(config.background, np.float32),
            picture,
            stops,
        )
        lists.for_ranges(part, thread_count(config.threads))
    return ForwardPass(splats, camera, config, footprints, colours, picture, all_lists, all_stops)
