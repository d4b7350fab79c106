"""What every splat adds to the pictures of a set of views: the measure that order is made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.geometry import sh
from cogsplat.codec.geometry.frustum import ALPHA_MIN, NEAR
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.jit import kernel
from cogsplat.codec.render.projection import FLAT, NARROW, OPACITY, SHEAR, Footprints, X, Y, project
from cogsplat.codec.render.rasteriser import ALPHA_MAX, TRANSMITTANCE_MIN, falloff
from cogsplat.codec.render.sensitivities import (
    COLUMNS,
    MOMENTS,
    PAIRS_AT_ONCE,
    Sensitivities,
    add_moments,
    from_columns,
    view_colours,
    view_sensitivities,
)
from cogsplat.codec.render.tiles import TILE, TileLists, tile_lists
from cogsplat.codec.splats import MAX_SH_DEGREE, Splats, sh_coefficients
from cogsplat.codec.threads import ordered_map, thread_count
from cogsplat.codec.views.view_sets import jitter

_ALPHA_MIN = np.float32(ALPHA_MIN)
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_HALF = np.float32(0.5)
_PIXELS = TILE * TILE
# Unsigned, so that no index is checked for counting from the end: such checks stop vectorisation.
_TILE = np.uintp(TILE)
_BASES = sh_coefficients(MAX_SH_DEGREE)
_RANGES_PER_THREAD = 4

# The spread of view directions is a mean over the scene: one splat in so many is enough.
_GRAM_STRIDE = 8

# Columns of a pair's or a footprint's sums.
_WEIGHT, _SQUARE, _PEAK = range(3)
# Rows of a tile's lanes.
_SQUARES, _PEAKS, _ROW = np.uintp(TILE), np.uintp(2 * TILE), np.uintp(3 * TILE)

# PRoGS, section 3.1 (Zoomers et al. 2024): a pixel's K largest weights count.
TOP_K = 20
# No pixel blends more: ln(1e-4) / ln(1 - 1/255) = 2344 splats of the least alpha.
_MOST_WEIGHTS = 2346


@dataclass(frozen=True)
class ScoreConfig:
    """What counts as contribution.

    Parameters
    ----------
    top_k : int
        Weights counted per pixel, the largest ones; 0 for all.
    jitter : bool
        Also score copies of the cameras that step back and turn (`view_sets.jitter`), so that what
        the capture path hides is not worth nothing.
    near_plane : float
        Means at or before this camera-space depth are not drawn, scene units.
    threads : int
        0 for every core this process may use. The scores do not depend on it.
    sensitivity_every : int
        Also measure `Sensitivities`, on one of so many views; 0 for none. At 1 they cost about as
        much again as the rest.
    """

    top_k: int = TOP_K
    jitter: bool = True
    near_plane: float = NEAR
    threads: int = 0
    sensitivity_every: int = 0

    def __post_init__(self) -> None:
        if self.top_k < 0:
            raise ValueError(f"top_k {self.top_k}, expected 0 (all) or more")
        if not self.near_plane > 0.0:
            raise ValueError(f"near_plane {self.near_plane}, expected more than 0")
        thread_count(self.threads)
        if self.sensitivity_every < 0:
            raise ValueError(
                f"sensitivity_every {self.sensitivity_every}, expected 0 (none) or more"
            )


@dataclass(frozen=True, eq=False)
class Scores:
    """Sums over views and pixels of the weights w = T·alpha with which a splat was blended.

    Parameters
    ----------
    contribution : (N,) float64
        Sum over a view's pixels of w, where w is among the pixel's top K; mean over the given
        views, plus, with jitter, the mean over their jittered copies (PRoGS, section 3.1). px
        per view.
    colour_sensitivity : (N,) float64
        Largest change that one SH coefficient makes to the mean unclamped pixel of its channel,
        per unit: the maximum over all 16 bases of the sum over views of ``|Y| · contribution in the
        view``, over the views' pixels (Niedermayr et al. 2024, section 3.1). With jitter, the given
        and the jittered views count half each. Top K makes it a lower bound.
    energy : (N,) float64
        Sum of w² over all weights, per pixel of the views: a colour error Δ of the splat alone
        costs ``energy · Δ²`` of mean squared error. With jitter, the two sets count half each.
    peak : (N,) float32
        Largest w in any pixel of any view.
    seen : (N,) int32
        Views in which it was blended into a pixel.
    covered : (N,) int32
        Views whose image its footprint reaches, whether or not something hides it there.
    basis_mean : (N, 15) float32
        Mean, by energy, over the views that see a splat of the SH bases above DC in their
        directions; zeros where none does.
    basis_spread : (15, 15) float64
        Covariance of those bases over a splat's views, its mean over the scene by energy: what an
        error of shN costs that sh0 cannot make up for.
    num_pixels : int
        Pixels of all views, jittered ones included.
    sensitivities : Sensitivities or None
        What errors of the stored values cost, where the configuration asks for it.
    """

    contribution: NDArray[np.float64]
    colour_sensitivity: NDArray[np.float64]
    energy: NDArray[np.float64]
    peak: NDArray[np.float32]
    seen: NDArray[np.int32]
    covered: NDArray[np.int32]
    basis_mean: NDArray[np.float32]
    basis_spread: NDArray[np.float64]
    num_pixels: int
    sensitivities: Sensitivities | None = None

    def take(self, rows: NDArray[np.integer]) -> Scores:
        """Return the scores of some splats."""
        found = self.sensitivities
        return replace(
            self,
            contribution=self.contribution[rows],
            colour_sensitivity=self.colour_sensitivity[rows],
            energy=self.energy[rows],
            peak=self.peak[rows],
            seen=self.seen[rows],
            covered=self.covered[rows],
            basis_mean=self.basis_mean[rows],
            sensitivities=None if found is None else found.take(rows),
        )


def unscored(splats: int) -> Scores:
    """Return scores for a scene that no view was rendered of: nothing known, nothing pruned."""
    return Scores(
        contribution=np.zeros(splats, np.float64),
        colour_sensitivity=np.zeros(splats, np.float64),
        energy=np.zeros(splats, np.float64),
        peak=np.zeros(splats, np.float32),
        seen=np.zeros(splats, np.int32),
        covered=np.zeros(splats, np.int32),
        basis_mean=np.zeros((splats, _BASES - 1), np.float32),
        basis_spread=np.zeros((_BASES - 1, _BASES - 1), np.float64),
        num_pixels=0,
    )


@dataclass(frozen=True, eq=False)
class _ViewScores:
    """One view's sums: rows of the scene (M,), and (M, 3) float64 Σw, Σw², largest w.

    Where they are asked for, (M, 13) float64 sums over pixels for `Sensitivities`.
    """

    index: NDArray[np.int32]
    sums: NDArray[np.float64]
    columns: NDArray[np.float64] | None


@kernel
def _weigh(
    first: int,
    last: int,
    lists_first: int,
    starts: NDArray[np.int64],
    members: NDArray[np.int32],
    ellipse: NDArray[np.float32],
    rows: NDArray[np.int32],
    width: int,
    height: int,
    top_k: int,
    sums: NDArray[np.float32],
) -> None:
    """Sum the weights of every pair of a tile and a splat, for the tiles ``first`` to ``last``.

    The same walk as `rasteriser._blend`, a row of 16 pixels at a time, with sums per splat in place
    of colours per pixel.
    """
    tiles_x = (width + TILE - 1) // TILE
    live = np.empty(_PIXELS, np.float32)
    # Σw, Σw², largest w by column of the tile, and the weights of one row.
    lanes = np.empty(4 * TILE, np.float32)
    # The largest weights of each pixel so far, with their pairs; once there are K, the smallest is
    # the one to beat.
    best = np.empty((_PIXELS, top_k), np.float32)
    owners = np.empty((_PIXELS, top_k), np.int64)
    filled = np.zeros(_PIXELS, np.int32)
    smallest = np.zeros(_PIXELS, np.int32)
    bar = np.zeros(_PIXELS, np.float32)
    for tile in range(first, last):
        top = tile // tiles_x * TILE
        left = tile % tiles_x * TILE
        num_rows = min(TILE, height - top)
        num_columns = min(TILE, width - left)
        live[:] = _ZERO
        filled[:] = 0
        bar[:] = _ZERO
        for y in range(num_rows):
            for x in range(num_columns):
                live[y * TILE + x] = _ONE
        unfinished = num_rows * num_columns
        begin, end = starts[tile - lists_first], starts[tile - lists_first + 1]
        for pair in range(begin, end):
            i = members[pair]
            narrow = ellipse[i, NARROW]
            shear = ellipse[i, SHEAR]
            flat = ellipse[i, FLAT]
            opacity = ellipse[i, OPACITY]
            centre_x = ellipse[i, X] - np.float32(left) - _HALF
            centre_y = ellipse[i, Y] - np.float32(top) - _HALF
            lanes[:] = _ZERO
            finished = 0
            for y in range(max(rows[i, 0] - top, 0), min(rows[i, 1] - top, num_rows)):
                dy = np.float32(y) - centre_y
                row_x = centre_x + shear * dy
                row_exponent = -flat * dy * dy
                base = np.uintp(y * TILE)
                above_bar = 0
                for lane in range(_TILE):
                    at = base + lane
                    u = narrow * (np.float32(lane) - row_x)
                    alpha = min(ALPHA_MAX, opacity * falloff(row_exponent - u * u))
                    before = live[at]
                    after = before * (_ONE - alpha)
                    touched = alpha >= _ALPHA_MIN
                    goes_on = after >= TRANSMITTANCE_MIN
                    weight = before * alpha if touched & goes_on else _ZERO
                    finished += int(touched & (before > _ZERO) & ~goes_on)
                    live[at] = (after if goes_on else _ZERO) if touched else before
                    lanes[lane] += weight
                    lanes[lane + _SQUARES] += weight * weight
                    lanes[lane + _PEAKS] = max(lanes[lane + _PEAKS], weight)
                    lanes[lane + _ROW] = weight
                    above_bar += int(weight > bar[at])
                if top_k > 0 and above_bar > 0:
                    for lane in range(_TILE):
                        at = base + lane
                        weight = lanes[lane + _ROW]
                        if weight > bar[at]:
                            count = filled[at]
                            if count < top_k:
                                best[at, count] = weight
                                owners[at, count] = pair
                                filled[at] = count + 1
                                if count + 1 < top_k:
                                    continue
                            else:
                                best[at, smallest[at]] = weight
                                owners[at, smallest[at]] = pair
                            # Of equal weights the furthest yields, as in a stable sort.
                            low = 0
                            for k in range(1, top_k):
                                if best[at, k] < best[at, low] or (
                                    best[at, k] == best[at, low] and owners[at, k] > owners[at, low]
                                ):
                                    low = k
                            smallest[at] = low
                            bar[at] = best[at, low]
            weights = _ZERO
            squares = _ZERO
            peak = _ZERO
            for lane in range(_TILE):
                weights += lanes[lane]
                squares += lanes[lane + _SQUARES]
                peak = max(peak, lanes[lane + _PEAKS])
            sums[pair, _WEIGHT] = weights if top_k == 0 else _ZERO
            sums[pair, _SQUARE] = squares
            sums[pair, _PEAK] = peak
            unfinished -= finished
            if unfinished == 0:
                for rest in range(pair + 1, end):
                    sums[rest, :] = _ZERO
                break
        if top_k > 0:
            for pixel in range(num_rows * TILE):
                for k in range(filled[pixel]):
                    sums[owners[pixel, k], _WEIGHT] += best[pixel, k]


@kernel
def _gather(
    members: NDArray[np.int32], pair_sums: NDArray[np.float32], sums: NDArray[np.float64]
) -> None:
    """Add up the tiles of each footprint, in the order of the lists."""
    for pair in range(len(members)):
        i = members[pair]
        sums[i, _WEIGHT] += pair_sums[pair, _WEIGHT]
        sums[i, _SQUARE] += pair_sums[pair, _SQUARE]
        sums[i, _PEAK] = max(sums[i, _PEAK], pair_sums[pair, _PEAK])


_terms = kernel(sh.terms)


@kernel
def _accumulate(
    index: NDArray[np.int32],
    sums: NDArray[np.float64],
    means: NDArray[np.float32],
    position: NDArray[np.float64],
    view_share: float,
    pixel_share: float,
    contribution: NDArray[np.float64],
    bases: NDArray[np.float64],
    energy: NDArray[np.float64],
    peak: NDArray[np.float32],
    seen: NDArray[np.int32],
) -> None:
    """Add one view to the scene's sums."""
    for row in range(len(index)):
        if not sums[row, _PEAK] > 0.0:
            continue
        i = index[row]
        weight = sums[row, _WEIGHT]
        contribution[i] += view_share * weight
        energy[i] += pixel_share * sums[row, _SQUARE]
        peak[i] = max(peak[i], np.float32(sums[row, _PEAK]))
        seen[i] += 1
        x = means[i, 0] - position[0]
        y = means[i, 1] - position[1]
        z = means[i, 2] - position[2]
        inverse = 1.0 / np.sqrt(x * x + y * y + z * z)
        values = _terms(x * inverse, y * inverse, z * inverse)
        share = pixel_share * weight
        bases[i, 0] += share * sh.C0
        for k in range(_BASES - 1):
            bases[i, k + 1] += share * abs(values[k])


@kernel
def _look(
    index: NDArray[np.int32],
    sums: NDArray[np.float64],
    means: NDArray[np.float32],
    position: NDArray[np.float64],
    pixel_share: float,
    basis_mean: NDArray[np.float64],
    gram: NDArray[np.float64],
) -> None:
    """Add the directions in which one view sees the splats."""
    for row in range(len(index)):
        share = pixel_share * sums[row, _SQUARE]
        if not share > 0.0:
            continue
        i = index[row]
        x = means[i, 0] - position[0]
        y = means[i, 1] - position[1]
        z = means[i, 2] - position[2]
        inverse = 1.0 / np.sqrt(x * x + y * y + z * z)
        values = _terms(x * inverse, y * inverse, z * inverse)
        for j in range(_BASES - 1):
            basis_mean[i, j] += share * values[j]
        if i % _GRAM_STRIDE == 0:
            for j in range(_BASES - 1):
                for k in range(j + 1):
                    gram[j, k] += share * values[j] * values[k]


def _spread(
    gram: NDArray[np.float64], basis_sum: NDArray[np.float64], energy: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the energy-weighted mean over splats of the covariance of bases over their views."""
    sampled = slice(None, None, _GRAM_STRIDE)
    weight = energy[sampled]
    sums = basis_sum[sampled][weight > 0]
    weight = weight[weight > 0]
    if len(weight) == 0:
        return np.zeros_like(gram)
    full = gram + np.tril(gram, -1).T
    # Sums in a fixed order: a matrix product's order depends on the number of threads.
    outer = np.einsum("nj,nk,n->jk", sums, sums, 1.0 / weight)
    spread: NDArray[np.float64] = (full - outer) / weight.sum()
    return spread


def _weigh_tiles(
    lists: TileLists, footprints: Footprints, camera: Camera, top_k: int, threads: int
) -> NDArray[np.float32]:
    sums = np.empty((len(lists.members), 3), np.float32)

    def weigh(tiles: tuple[int, int]) -> None:
        _weigh(
            tiles[0],
            tiles[1],
            lists.first,
            lists.starts,
            lists.members,
            footprints.ellipse,
            footprints.rows,
            camera.width,
            camera.height,
            top_k,
            sums,
        )

    parts = 1 if threads == 1 else threads * _RANGES_PER_THREAD
    for _ in ordered_map(weigh, lists.split(parts), threads):
        pass
    return sums


def _score_view(
    splats: Splats, camera: Camera, config: ScoreConfig, sensitive: bool, threads: int
) -> _ViewScores:
    footprints = project(
        splats,
        camera,
        kernel_px=splats.info.kernel_px,
        antialiased=splats.info.antialiased,
        near_plane=config.near_plane,
    )
    top_k = config.top_k if config.top_k < _MOST_WEIGHTS else 0
    sums = np.zeros((len(footprints), 3), np.float64)
    if not sensitive:
        for lists in tile_lists(footprints, camera.width, camera.height):
            _gather(lists.members, _weigh_tiles(lists, footprints, camera, top_k, threads), sums)
        return _ViewScores(footprints.index, sums, None)
    colours = view_colours(splats, camera, footprints)
    moments = np.zeros((len(footprints), MOMENTS), np.float64)
    for lists in tile_lists(footprints, camera.width, camera.height, PAIRS_AT_ONCE):
        _gather(lists.members, _weigh_tiles(lists, footprints, camera, top_k, threads), sums)
        add_moments(lists, footprints, colours, camera, threads, moments)
    columns = view_sensitivities(splats, camera, footprints, colours, moments, sums[:, _SQUARE])
    return _ViewScores(footprints.index, sums, columns)


def _sensitive(count: int, every: int) -> list[bool]:
    """Choose one of `every` views of a set: one of each run of so many, not the same in each.

    Jittered sets alternate between two kinds of copy, and both must be met.
    """
    if every == 0:
        return [False] * count
    return [(view + view // every) % every == 0 for view in range(count)]


def score(
    splats: Splats,
    cameras: Sequence[Camera],
    config: ScoreConfig | None = None,
    *,
    progress: Progress = silent,
) -> Scores:
    """Measure what each splat adds to what the cameras see, in one pass over the views.

    Parameters
    ----------
    splats : Splats
        Drawn with the kernel and anti-aliasing of ``splats.info``. Rows that cannot be drawn score
        0.
    cameras : sequence of Camera
        In the frame of the means.
    config : ScoreConfig or None
        None for the defaults.
    progress : Progress
        Called with ``("score", views done, views)``; raising from it stops the work.

    Returns
    -------
    Scores
        The same, bit for bit, for any number of threads.

    Raises
    ------
    DataError
        ``no-cameras`` for an empty list, ``cameras-see-nothing`` when no splat reaches a pixel.
    """
    config = config or ScoreConfig()
    if not cameras:
        raise DataError("no-cameras", "0 cameras to score with, expected at least 1")
    sets = [list(cameras)]
    if config.jitter:
        sets.append(jitter(splats, cameras))
    views: list[Camera] = []
    shares: list[tuple[float, float]] = []
    sensitive: list[float] = []
    for members in sets:
        pixels = sum(camera.width * camera.height for camera in members)
        views += members
        shares += [(1.0 / len(members), 1.0 / (pixels * len(sets)))] * len(members)
        chosen = _sensitive(len(members), config.sensitivity_every)
        pixels = sum(
            camera.width * camera.height
            for camera, included in zip(members, chosen, strict=True)
            if included
        )
        sensitive += [1.0 / (pixels * len(sets)) if included else 0.0 for included in chosen]

    n = len(splats)
    contribution = np.zeros(n, np.float64)
    energy = np.zeros(n, np.float64)
    bases = np.zeros((n, _BASES), np.float64)
    peak = np.zeros(n, np.float32)
    seen = np.zeros(n, np.int32)
    covered = np.zeros(n, np.int32)
    basis_sum = np.zeros((n, _BASES - 1), np.float64)
    gram = np.zeros((_BASES - 1, _BASES - 1), np.float64)
    columns = np.zeros((n if config.sensitivity_every else 0, COLUMNS), np.float64)
    threads = thread_count(config.threads)
    by_view = len(views) >= threads
    results = ordered_map(
        lambda view: _score_view(
            splats, views[view], config, sensitive[view] > 0.0, 1 if by_view else threads
        ),
        range(len(views)),
        threads if by_view else 1,
    )
    progress("score", 0, len(views))
    for done, result in enumerate(results):
        view_share, pixel_share = shares[done]
        _accumulate(
            result.index,
            result.sums,
            splats.means,
            views[done].position,
            view_share,
            pixel_share,
            contribution,
            bases,
            energy,
            peak,
            seen,
        )
        covered[result.index] += 1
        if splats.sh_degree:
            position = views[done].position
            _look(result.index, result.sums, splats.means, position, pixel_share, basis_sum, gram)
        if result.columns is not None:
            columns[result.index] += sensitive[done] * result.columns
        progress("score", done + 1, len(views))
    if not seen.any():
        raise DataError(
            "cameras-see-nothing",
            f"none of {n} splats reaches a pixel of the {len(cameras)} cameras, expected cameras "
            "in the frame of the scene",
        )
    return Scores(
        contribution=contribution,
        colour_sensitivity=bases.max(axis=1),
        energy=energy,
        peak=peak,
        seen=seen,
        covered=covered,
        basis_mean=(basis_sum / np.where(energy > 0, energy, 1.0)[:, None]).astype(np.float32),
        basis_spread=_spread(gram, basis_sum, energy),
        num_pixels=sum(camera.width * camera.height for camera in views),
        sensitivities=from_columns(columns) if config.sensitivity_every else None,
    )
