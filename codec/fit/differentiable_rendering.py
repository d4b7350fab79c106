"""Differentiable pictures: a scene drawn from a camera, and the way back to all stored values."""

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
from cogsplat.codec.render.tiles import TileLists, gather, tile_lists
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .splat_kernels import add_colour_gradients, add_shape_gradients
from .tile_kernels import SUMS, differentiate_tiles, draw_tiles

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Gradients:
    """Derivatives of a loss by every stored value of a scene.

    Parameters
    ----------
    means : (N, 3) float32
        Per scene unit.
    scales : (N, 3) float32
        By the log scales.
    quats : (N, 4) float32
        By the quaternions as they are stored; their length changes nothing.
    opacities : (N,) float32
        By the logits.
    sh0, shN : (N, 3) float32, (N, K-1, 3) float32
        By the SH coefficients.
    """

    means: F32
    scales: F32
    quats: F32
    opacities: F32
    sh0: F32
    shN: F32  # noqa: N815 - the field's name

    @classmethod
    def zeros(cls, splats: Splats) -> Gradients:
        """Return the gradients of a scene that no picture has been drawn of."""
        return cls(**{name: np.zeros_like(getattr(splats, name)) for name in cls.names()})

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of the arrays, which are those of `Splats`."""
        return tuple(cls.__dataclass_fields__)

    def clear(self) -> None:
        """Set all of them to 0."""
        for name in self.names():
            getattr(self, name).fill(0.0)

    def times(self, factor: float) -> Gradients:
        """Return all of them times a factor."""
        return Gradients(
            **{name: np.float32(factor) * getattr(self, name) for name in self.names()}
        )

    def add(self, others: Gradients, rows: NDArray[np.int64] | None = None) -> None:
        """Add others to them.

        Parameters
        ----------
        others : Gradients
        rows : (n,) int64, optional
            Splats that the rows of `others` belong to, each at most once; by default all, in order.
        """
        at = slice(None) if rows is None else rows
        for name in self.names():
            getattr(self, name)[at] += getattr(others, name)


def with_values(splats: Splats, values: Mapping[str, F32]) -> Splats:
    """Return a scene with other arrays of the names of `Gradients`."""
    arrays: dict[str, Any] = dict(values)
    return replace(splats, **arrays)


@dataclass(frozen=True, eq=False)
class ForwardPass:
    """A picture, and what is needed to differentiate it.

    Parameters
    ----------
    splats, camera, config
        As `draw` took them. The arrays of the splats must not change before `backward` is called.
    footprints : Footprints
        M of them.
    colours : (M, 3) float32
        That they show to the camera.
    picture : (H, W, 3) float32
        In the scene's colour space, not clipped: what `rasteriser.render` gives, bit for bit.
    lists : sequence of TileLists
        All tiles of the picture.
    stops : sequence of (tiles,) int64
        For each of the lists, where its tiles ended.
    on_device : CudaView or None
        What was drawn on a CUDA device; then there are no lists.
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
        """Add the derivatives of a loss by the stored values.

        Parameters
        ----------
        by_picture : (H, W, 3) float32
            Derivative of the loss by the picture.
        gradients : Gradients
            Of the same scene; changed in place. Sums over several pictures do not depend on the
            number of threads where the pictures come in one order.

        Returns
        -------
        (M, 2) float64
            Derivative by each footprint's centre, 1/px: what 3DGS grows scenes by. Row k belongs
            to splat ``footprints.index[k]``.
        """
        return self.add(self.sums(by_picture), gradients)

    def sums(self, by_picture: F32) -> F64:
        """Return what a loss asks of the footprints: (M, SUMS) float64, for `add`.

        This is most of the work, and touches no gradients: several pictures can be in it at once.
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
            gather(lists.members, pair_sums, sums, 0)
        return sums

    def add(self, sums: F64, gradients: Gradients) -> F64:
        """Add what `sums` returned to gradients; returns what `backward` does."""
        splats, camera, footprints = self.splats, self.camera, self.footprints
        centres = np.empty((len(footprints), 2), np.float64)
        higher = splats.shN.shape[1]
        degree = {0: 0, 3: 1, 8: 2, 15: 3}[higher]
        if self.config.sh_degree is not None:
            degree = min(degree, self.config.sh_degree)
        colour = partial(
            add_colour_gradients,
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
            float(self.config.kernel_px),
            self.config.antialiased,
            gradients.means,
            gradients.scales,
            gradients.quats,
            gradients.opacities,
            centres,
        )

        def of_range(rows: tuple[int, int]) -> None:
            colour(*rows)
            shape(*rows)

        threads = thread_count(self.config.threads)
        edges = np.linspace(0, len(footprints), threads + 1).astype(np.int64).tolist()
        # Every footprint has a row of its own, so that ranges write to different places.
        for _ in ordered_map(of_range, pairwise(edges), threads):
            pass
        return centres


def render_forward(
    splats: Splats, camera: Camera, config: RenderConfig | None = None
) -> ForwardPass:
    """Draw a scene so that it can be differentiated.

    Parameters
    ----------
    splats : Splats
        Rows that cannot be drawn are left out.
    camera : Camera
        In the frame of the means.
    config : RenderConfig or None
        None for the kernel and anti-aliasing the scene states in `Splats.info`, over black.

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
    >>> drawing = render_forward(splats, camera)
    >>> gradients = Gradients.zeros(splats)
    >>> grey = np.full_like(drawing.picture, 0.5)
    >>> by_centres = drawing.backward(2.0 * (drawing.picture - grey), gradients)
    >>> by_centres.shape[0] == len(drawing.footprints), bool(np.abs(gradients.sh0).max() > 0)
    (True, True)
    """
    info = splats.info
    config = config or RenderConfig(kernel_px=info.kernel_px, antialiased=info.antialiased)
    if config.device == "cuda":
        view = cuda_view(CudaScene(splats), camera, config)
        picture = view.picture(config.background)
        return ForwardPass(
            splats, camera, config, view.footprints, view.colours, picture, (), (), view
        )
    footprints = project(
        splats,
        camera,
        kernel_px=config.kernel_px,
        antialiased=config.antialiased,
        near_plane=config.near_plane,
    )
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
