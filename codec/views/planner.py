"""Virtual views: cameras planned from the splats of a scene that has no cameras.

Trained splats are small where the capturing cameras were near, and many where these cameras looked.
A picture from a similar position resolves thousands of splats. A picture from behind a wall or
inside a surface resolves a few large ones.

The planner proposes candidate views: it steps back from a splat to the distance at which the splat
has its typical size in a picture, unless other splats block the way. It leaves out positions
enclosed by splats and draws each candidate as a small picture. Then it greedily chooses the views
that together show most of the scene clearly.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.executor import Executor, LocalThreads
from cogsplat.codec.finite_fields import require_finite
from cogsplat.codec.geometry.frustum import ALPHA_MIN, NEAR, in_picture
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import thread_count

from .candidates import USUAL_PITCH_DEG, Candidate, CandidateInputs, draw_candidate, pitch_deg
from .coverage import SeenSplats, choose_covering
from .low_discrepancy import STEPS_2D, sequence
from .occlusion import Occluders
from .orbit import OrbitTarget, bounding_ball, orbit, orbit_target, turntable
from .pose import Lens, Pose, down_direction
from .subsample import Subsample, subsample
from .view_sets import TEST_VIEWS

F64 = NDArray[np.float64]

# Splats of the subsample for planning, and of the coarser subsample for testing whether a position
# is enclosed. They bound the run time for scenes of any size.
_SUBSAMPLE_SPLATS: Final = 40_000
_COARSE_SPLATS: Final = 4_096
# Pixels of a candidate's small picture.
_CANDIDATE_PIXELS: Final = 96 * 72
_MIN_SIDE_PX: Final = 8

# Candidates per view: in the first round over the whole scene, in the second round for splats that
# the views chosen so far show badly.
_FIRST_ROUND, _SECOND_ROUND = 4, 2
# Share of the views chosen after the first round.
_FIRST_SHARE: Final = _FIRST_ROUND / (_FIRST_ROUND + _SECOND_ROUND)

# A splat's vicinity is the nearest quarter of the scene, so that each of several separate objects
# has its own. A vicinity fills a view of 60° from a distance of about two of its radii. Its radius
# is measured for a sample of the splats, among a sample of neighbours.
_VIEW_FILLING_RADII: Final = 2.0
_VICINITY_SHARE: Final = 0.25
_VICINITY_SAMPLES: Final = 256
_VICINITY_NEIGHBOURS: Final = 4_096
# Limit of viewing distances, in median viewing distances. The large splats of a background are not
# meant to be seen from the distance that their size suggests.
_MAX_DISTANCE_RATIO: Final = 3.0
# If splats block the way back from a target, the camera stands at this share of the free length, so
# that its jittered copy (30 % further back) is also in front of them. If that is nearer than the
# second share of the viewing distance, the camera stands at the viewing distance, behind them.
_FREE_SHARE: Final = 0.7
_MIN_DISTANCE_SHARE: Final = 0.12
# The first part of the way back lies in the target's own surface and is ignored: this many sizes of
# the splat or this share of the way, whichever is longer.
_SURFACE_SIZES, _SURFACE_SHARE = 3.0, 0.02

# A position is enclosed by splats, for example inside a solid object, if more than this share of
# the directions is blocked within this share of the viewing distance.
_ENCLOSED_REACH: Final = 0.08
_ENCLOSED_OCCLUSION: Final = 0.7

# A position is inside something, a room or an object, if splats at any distance block more than
# this share of the directions.
_INSIDE_OCCLUSION: Final = 0.7
# Views from inside and from outside are weighted by the share of the scene that only they show. If
# both shares are at most this, the walls hide nothing: the scene is an object seen from outside.
_SIDE_TIE: Final = 0.03
# That visibility is tested for a sample of splats from a sample of positions. The end of each ray
# lies in the target's surface and is ignored: this many sizes of coarse splats, but at most this
# share of the way.
_SIDE_SAMPLES, _SIDE_POSITIONS = 512, 48
_TARGET_SIZES, _TARGET_SHARE = 4.0, 0.1
# Minimum weight of a side: splats that only one side shows deserve a few views.
_MIN_SIDE_WEIGHT: Final = 0.1

# Exposure at which the gain of a view saturates. The gain is logarithmic, so that views spread over
# the scene in proportion to its detail.
_SATURATION: Final = 0.1

# An object is isolated if, at half of the poses of an orbit or more, splats block at most this
# share of the directions; the object itself fills about this share. It is compact if its radius is
# less than this many median vicinity radii. All views of a compact isolated object are orbit poses,
# as in an orbit viewer.
_ISOLATED_OCCLUSION: Final = 0.12
_COMPACT: Final = 3.0
_ORBIT_TRIES: Final = 24
# Size of the test views relative to the scoring views: a small picture averages away errors that a
# viewer sees.
_TEST_VIEW_SCALE: Final = 1.2
# Poses proposed at a time for test views, and how often at most. A pose is plausible for a viewer
# if its pitch differs from the usual one by at most 30° and no splat is nearer than 0.2 median
# vicinity radii: 1 pose in 3 on a terrace, 1 in 40 in a furnished house. Proposals end with as many
# plausible poses as test views: in twice as many, the choice by detail leaves out bare walls, and
# the prediction for two rooms is 1.1 dB below what visitors see.
_TEST_PROPOSALS: Final = 8 * TEST_VIEWS
_TEST_ROUNDS: Final = 8
_MAX_PITCH_OFFSET_DEG: Final = 30.0
_CLEARANCE: Final = 0.2

# Share of the splats that may lie outside all views. Views for the rest are added at positions
# already chosen, at most 1/8 of the number of views.
_UNCOVERED: Final = 0.001
_EXTRA_SHARE: Final = 1 / 8
# Covering views at most, relative to the number of views.
_COVER_SHARE: Final = 1 / 2
_UNCOVERED_SAMPLES: Final = 32

# The near plane is a fixed distance and would cut off the objects of a small scene. Cameras stay at
# least this many near-plane distances from the splat they look at, and zoom in instead.
_NEAR_PLANES: Final = 4.0


@dataclass(frozen=True)
class ViewPlanConfig:
    """Number and image size of virtual views.

    Parameters
    ----------
    views : int
        Number of views before additions. Planning adds covering views, at most 1/2 of this number,
        and views of splats outside all pictures, at most 1/8 of this number.
    width, height : int
        Image size of each view, px.
    fov_deg : float
        Horizontal field of view, degrees.
    near_plane : float
        Camera-space depth up to which scoring draws nothing, scene units.
    threads : int
        Number of threads; 0 for every core this process may use. The plan does not depend on it.
    """

    views: int = 64
    width: int = 400
    height: int = 300
    fov_deg: float = 60.0
    near_plane: float = NEAR
    threads: int = 0

    def __post_init__(self) -> None:
        require_finite(self)
        if self.views < 1:
            raise ValueError(f"{self.views} views, expected at least 1")
        if not (1 <= self.width <= 65535 and 1 <= self.height <= 65535):
            raise ValueError(f"views of {self.width}x{self.height} px, expected 1 to 65535")
        if not 1.0 <= self.fov_deg <= 150.0:
            raise ValueError(f"a field of view of {self.fov_deg} degrees, expected 1 to 150")
        if not self.near_plane > 0.0:
            raise ValueError(f"near_plane {self.near_plane}, expected more than 0")
        thread_count(self.threads)

    def at_width(self, width: int | None) -> ViewPlanConfig:
        """Return the settings of views of another width, px; None keeps the width."""
        if width is None:
            return self
        return replace(self, width=width, height=max(1, round(self.height * width / self.width)))

    def lens(self, scale: float = 1.0) -> Lens:
        """Return the lens of the views, with width and height multiplied by `scale`."""
        min_side = min(_MIN_SIDE_PX, self.width, self.height)
        return Lens(
            width=max(min_side, round(scale * self.width)),
            height=max(min_side, round(scale * self.height)),
            slope=math.tan(math.radians(0.5 * self.fov_deg)),
        )


@dataclass(frozen=True, eq=False)
class ViewPlan:
    """Planned views for scoring, and separate views for testing.

    Parameters
    ----------
    views : list of Camera
        Scoring views, named ``virtual-000`` and on, by descending gain.
    covering_views : list of Camera
        Views of parts that the orbit around an isolated object misses, such as the bottom of a
        bowl; named ``covering-000`` and on. They show that a part is visible, and say nothing of
        how often: means over views exclude them. Empty for other scenes, whose covering views are
        among `views`.
    test_views : list of Camera
        Test views, named ``test-00`` and on, at other positions than `views`: all around an
        isolated object, or in other scenes at plausible viewer positions that show much of the
        scene clearly. Nothing is tuned on them.
    coverage : float
        Share of the visible splats that `views` and `covering_views` cover
        (`coverage.choose_covering`), 0 to 1.
    """

    views: list[Camera]
    covering_views: list[Camera]
    test_views: list[Camera]
    coverage: float


def plan_views(
    splats: Splats, config: ViewPlanConfig | None = None, *, progress: Progress = silent
) -> list[Camera]:
    """Plan the scoring views of a scene that has no cameras.

    Parameters
    ----------
    splats, config, progress
        See `plan`.

    Returns
    -------
    list of Camera
        `ViewPlan.views`, then `ViewPlan.covering_views`.

    Raises
    ------
    DataError
        See `plan`.

    Examples
    --------
    >>> from cogsplat.codec.views.planner import ViewPlanConfig, plan_views
    >>> import cogsplat
    >>> splats = cogsplat.read("scene.ply")
    >>> cameras = plan_views(splats, ViewPlanConfig(views=4, width=64, height=48))
    >>> cameras[0].name, cameras[0].width, cameras[0].height
    ('virtual-000', 64, 48)
    """
    found = plan(splats, config, progress=progress)
    return found.views + found.covering_views


def plan(
    splats: Splats,
    config: ViewPlanConfig | None = None,
    *,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> ViewPlan:
    """Plan the scoring and test views of a scene that has no cameras.

    Objects are viewed from an orbit, rooms from inside, open ground from above. A scene with
    several of these gets views of each in proportion to its detail.

    Parameters
    ----------
    splats : Splats
        Scene; splats that cannot be drawn are ignored.
    config : ViewPlanConfig or None
        None for the defaults.
    executor : Executor, optional
        Executor of the work on single views; by default threads of this process.
    progress : Progress
        Called with ``("plan views", candidates drawn, candidates)``; raising from it stops the
        work.

    Returns
    -------
    ViewPlan
        Plan, independent of the number of threads.

    Raises
    ------
    DataError
        ``empty-scene``: no splat can be drawn.
    """
    config = config or ViewPlanConfig()
    # SH is dropped first: copying it would be most of the work.
    bare = splats.with_sh_degree(0)
    usable = ~bare.invalid_rows()
    usable &= bare.opacities > math.log(ALPHA_MIN / (1.0 - ALPHA_MIN))
    if not usable.any():
        raise DataError(
            "empty-scene", f"none of {len(splats)} splats can be drawn, expected at least 1"
        )
    executor = executor or LocalThreads(config.threads)
    planner = _Planner(subsample(bare.take(usable), _SUBSAMPLE_SPLATS), config, executor, progress)
    poses, covering = planner.plan()
    lens, down = config.lens(), planner.down

    def cameras(found: Sequence[Pose], name: str) -> list[Camera]:
        return [pose.camera(lens, down, f"{name}-{row:03d}") for row, pose in enumerate(found)]

    large = config.lens(_TEST_VIEW_SCALE)
    test_poses = enumerate(planner.test_poses())
    tests = [pose.camera(large, down, f"test-{row:02d}") for row, pose in test_poses]
    return ViewPlan(
        cameras(poses, "virtual"), cameras(covering, "covering"), tests, planner.coverage
    )


class _Planner:
    """State of one run of `plan`.

    Parameters
    ----------
    scene : Subsample
        Scene thinned to M splats.
    config : ViewPlanConfig
    executor : Executor
        Executor that draws the candidates.
    progress : Progress
    """

    def __init__(
        self, scene: Subsample, config: ViewPlanConfig, executor: Executor, progress: Progress
    ) -> None:
        self._scene = scene
        self._executor = executor
        self._config = config
        self._progress = progress
        self._means = scene.splats.means.astype(np.float64)
        self._occluders = Occluders(scene.splats, config.threads)
        self._coarse = Occluders(subsample(scene.splats, _COARSE_SPLATS).splats, config.threads)
        self.down = down_direction(scene.splats.info.axes)
        # Typical ratio of a splat's size to its distance in a picture.
        self._detail = self._typical_detail()
        distances = scene.sizes / self._detail
        typical = _weighted_median(distances, scene.counts)
        # Distance at which each splat has that ratio.
        self._viewing_distances: F64 = np.minimum(distances, _MAX_DISTANCE_RATIO * typical)
        # Whether the scene is an isolated object; set by `_orbit_poses`.
        self._isolated = False
        # Covered share of the visible splats; set by `_cover`.
        self.coverage = 1.0
        self._candidates: list[Candidate] = []
        # Whether each candidate's position is inside something, and the weight of either side.
        self._inside: list[bool] = []
        self._side_weight = {False: 1.0, True: 1.0}
        # Sum over the chosen views of each splat's exposure.
        self._exposure = np.zeros(len(scene))
        scale = math.sqrt(_CANDIDATE_PIXELS / (config.width * config.height))
        lens = config.lens(min(scale, 1.0))
        self._inputs = CandidateInputs(scene, self._detail, lens, self.down, config.near_plane)

    def plan(self) -> tuple[list[Pose], list[Pose]]:
        """Return the poses of the views, by descending gain, and of the covering views."""
        views, counts = self._config.views, self._scene.counts
        total = (_FIRST_ROUND + _SECOND_ROUND) * views
        self._progress("plan views", 0, total)
        chosen: list[int] = []
        first = _FIRST_ROUND * views
        self._draw_candidates(self._propose(np.arange(first), counts))
        self._progress("plan views", first, total)
        self._weigh_sides()
        around = self._orbit_poses()
        # Splats that the orbit shows need no covering views.
        orbiting = list(self._executor.map(draw_candidate, around, self._inputs))
        for found in orbiting:
            self._exposure[found.index] += found.exposure
        views -= len(around)
        self._choose_more(chosen, round(_FIRST_SHARE * views))
        badly_shown = counts / (1.0 + self._exposure / _SATURATION)
        self._draw_candidates(self._propose(np.arange(first, total), badly_shown))
        self._progress("plan views", total, total)
        self._choose_more(chosen, views)
        chosen += self._cover(chosen, orbiting)
        poses = around + [self._candidates[row].pose for row in chosen]
        inside = [False] * len(around) + [self._inside[row] for row in chosen]
        weights = np.array([self._side_weight[side] for side in inside])
        poses += self._poses_for_uncovered(poses, weights)
        views = len(around) or len(poses)
        return poses[:views], poses[views:]

    def _orbit_poses(self) -> list[Pose]:
        """Return orbit poses if the scene is a compact isolated object, else an empty list."""
        target = orbit_target(self._means, self._scene.counts)
        self._isolated = self._is_isolated(target)
        if not (self._isolated and target.radius < _COMPACT * self._vicinity_radius):
            return []
        return orbit(target, self._config.views, self.down, self._config.near_plane)

    def _is_isolated(self, target: OrbitTarget) -> bool:
        """Whether splats block only few directions around at least half of the orbit poses."""
        if self._from_inside or not target.radius > 0.0:
            return False
        tries = orbit(target, _ORBIT_TRIES, self.down, self._config.near_plane)
        places = np.array([pose.position for pose in tries])
        occlusion = self._coarse.occlusion(places, np.full(len(places), np.inf))
        return bool(np.median(occlusion) <= _ISOLATED_OCCLUSION)

    @property
    def _from_inside(self) -> bool:
        """Whether the scene is mainly viewed from inside."""
        return self._side_weight[True] >= self._side_weight[False]

    def test_poses(self) -> list[Pose]:
        """Return the poses of the test views; call `plan` first.

        An isolated object gets turntable poses that show the whole object. Other scenes get
        plausible viewer poses: about level, on the side (inside or outside) that the scene is
        viewed from, and clear of splats. Of these, the poses that show most of the scene clearly
        are chosen, as the cameras of a capture are: a picture of the far background loses less
        than the pictures that visitors look at.
        """
        means, counts = self._means, self._scene.counts
        if self._isolated:
            whole = bounding_ball(means, counts)
            return turntable(whole, TEST_VIEWS, self.down, self._config.near_plane)
        poses: list[Pose] = []
        faults: list[F64] = []
        for first in range(_TEST_ROUNDS):
            # Negative numbers of the sequence: no candidate has one of these poses, and they are
            # the same for any number of views.
            numbers = np.arange(-_TEST_PROPOSALS, 0) - first * _TEST_PROPOSALS
            proposed = self._propose(numbers, counts)
            poses += proposed
            faults.append(self._faults(proposed))
            if (np.concatenate(faults) == 0.0).sum() >= TEST_VIEWS:
                break
        # The least faulty poses fill up the list where too few are plausible.
        order = np.argsort(np.concatenate(faults), kind="stable")
        plausible = int((np.concatenate(faults) == 0.0).sum())
        rows = order[: max(plausible, TEST_VIEWS)].tolist()
        drawn = list(self._executor.map(draw_candidate, [poses[row] for row in rows], self._inputs))
        chosen: list[int] = []
        weights = [1.0] * len(drawn)
        _choose(drawn, weights, counts, np.zeros(len(counts)), chosen, TEST_VIEWS)
        return [drawn[row].pose for row in sorted(chosen)]

    def _faults(self, poses: Sequence[Pose]) -> F64:
        """Return the faults of each pose as a place of a viewer, weighted: 0 to 7.

        The wrong side of walls counts 4, a steep pitch 2 and splats close to the camera 1.
        """
        places = np.array([pose.position for pose in poses]).reshape(-1, 3)
        around = self._coarse.occlusion(places, np.full(len(poses), np.inf))
        reach = np.full(len(poses), _CLEARANCE * self._vicinity_radius)
        near = self._coarse.occlusion(places, reach) > 0.0
        pitches = np.array([pitch_deg(pose, self.down) for pose in poses])
        steep = np.abs(pitches - USUAL_PITCH_DEG) >= _MAX_PITCH_OFFSET_DEG
        wrong_side = (around > _INSIDE_OCCLUSION) != self._from_inside
        faults: F64 = 4.0 * wrong_side + 2.0 * steep + 1.0 * near
        return faults

    def _typical_detail(self) -> float:
        """Measure the typical ratio of a splat's size to its viewing distance.

        The viewing distance is that at which the splat's vicinity, the nearest quarter of the
        scene, fills the view. The ratio is the median over a sample. The method also sets
        `_vicinity_radius`, the median radius of the vicinities.
        """
        counts, sizes = self._scene.counts, self._scene.sizes
        samples = _systematic(counts, min(_VICINITY_SAMPLES, len(counts)))
        others = _systematic(counts, min(_VICINITY_NEIGHBOURS, len(counts)))
        nearest = max(1, round(_VICINITY_SHARE * len(others)))
        radii = np.empty(len(samples))
        for row, sample in enumerate(samples):
            squares = np.square(self._means[others] - self._means[sample]).sum(axis=1)
            radii[row] = math.sqrt(np.partition(squares, nearest - 1)[nearest - 1])
        # A scene of one point still has an extent.
        radii = np.maximum(radii, 2.0 * sizes[samples])
        self._vicinity_radius = float(np.median(radii))
        return float(np.median(sizes[samples] / (_VIEW_FILLING_RADII * radii)))

    def _propose(self, numbers: NDArray[np.int64], weights: F64) -> list[Pose]:
        """Return poses that look at sampled splats from viewing distance, or nearer if blocked.

        Parameters
        ----------
        numbers : (n,) int64
            Numbers of the directions in the low-discrepancy sequence, one for each sampled splat.
        weights : (M,) float64
            Sampling weight of each splat.

        Returns
        -------
        list of Pose
            At most n poses; positions enclosed by splats are left out.
        """
        rows = _systematic(weights, len(numbers))
        points = sequence(numbers, STEPS_2D)
        height, azimuth = 2.0 * points[:, 0] - 1.0, 2.0 * np.pi * points[:, 1]
        ring = np.sqrt(1.0 - height * height)
        back = np.stack([ring * np.cos(azimuth), height, ring * np.sin(azimuth)], axis=1)
        targets, preferred = self._means[rows], self._viewing_distances[rows]
        starts = np.maximum(_SURFACE_SIZES * self._scene.sizes[rows], _SURFACE_SHARE * preferred)
        free = self._occluders.free_lengths(targets, back, preferred, starts)
        blocked = (free < preferred) & (_FREE_SHARE * free > _MIN_DISTANCE_SHARE * preferred)
        distances = np.where(blocked, _FREE_SHARE * free, preferred)
        places = targets + distances[:, None] * back
        occlusion = self._occluders.occlusion(places, _ENCLOSED_REACH * preferred)
        usable = occlusion <= _ENCLOSED_OCCLUSION
        if not usable.any():
            # Splats are everywhere, as in fog: all positions are equally good.
            usable[:] = True
        zoom = np.maximum(1.0, _NEAR_PLANES * self._config.near_plane / distances)
        places = targets + (zoom * distances)[:, None] * back
        return [Pose(places[row], -back[row], float(zoom[row])) for row in np.flatnonzero(usable)]

    def _draw_candidates(self, poses: Sequence[Pose]) -> None:
        """Append a candidate for each pose, drawn as a small picture."""
        total = (_FIRST_ROUND + _SECOND_ROUND) * self._config.views
        for found in self._executor.map(draw_candidate, poses, self._inputs):
            self._candidates.append(found)
            if len(self._candidates) % self._config.views == 0:
                self._progress("plan views", len(self._candidates), total)
        places = np.array([pose.position for pose in poses])
        occlusion = self._coarse.occlusion(places, np.full(len(poses), np.inf))
        self._inside += (occlusion > _INSIDE_OCCLUSION).tolist()

    def _weigh_sides(self) -> None:
        """Set the weights of views from inside and from outside of a room or object."""
        counts = self._scene.counts
        samples = _systematic(counts, min(_SIDE_SAMPLES, len(counts)))
        visible = {side: self._visible_from(side, samples) for side in (False, True)}
        only = {side: float((visible[side] & ~visible[not side]).mean()) for side in visible}
        most = max(only.values())
        for side in only:
            share = float(not side) if most <= _SIDE_TIE else (only[side] / most) ** 2
            self._side_weight[side] = max(share, _MIN_SIDE_WEIGHT)

    def _visible_from(self, inside: bool, samples: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Return a mask of the samples that are visible from a candidate on one side.

        Parameters
        ----------
        inside : bool
            True for the candidates inside a room or object, False for those outside.
        samples : (n,) intp
            Rows of the subsample.

        Returns
        -------
        (n,) bool
            Whether each sample is visible from at least one tested candidate on that side.
        """
        rows = [row for row, enclosed in enumerate(self._inside) if enclosed == inside]
        visible = np.zeros(len(samples), np.bool_)
        coarser = math.sqrt(max(1.0, self._scene.counts.sum() / _COARSE_SPLATS))
        ends = _TARGET_SIZES * coarser * self._scene.sizes[samples]
        for row in rows[:_SIDE_POSITIONS]:
            hidden = np.flatnonzero(~visible)
            position = self._candidates[row].pose.position
            offsets = self._means[samples[hidden]] - position
            distances = np.maximum(np.linalg.norm(offsets, axis=1), np.finfo(np.float64).tiny)
            lengths = distances - np.minimum(ends[hidden], _TARGET_SHARE * distances)
            origins = np.broadcast_to(position, offsets.shape)
            free = self._coarse.free_lengths(
                origins, offsets / distances[:, None], lengths, np.zeros(len(offsets))
            )
            visible[hidden] = free >= lengths
        return visible

    def _choose_more(self, chosen: list[int], views: int) -> None:
        """Choose candidates by `_choose`, up to `views` rows in `chosen`."""
        weights = [self._side_weight[inside] for inside in self._inside]
        _choose(self._candidates, weights, self._scene.counts, self._exposure, chosen, views)

    def _cover(self, chosen: Sequence[int], orbiting: Sequence[Candidate]) -> list[int]:
        """Return rows of candidates that cover visible splats not covered yet; set `coverage`.

        Parameters
        ----------
        chosen : sequence of int
            Rows of the candidates chosen as views.
        orbiting : sequence of Candidate
            Views of an orbit, which are not among the candidates.
        """
        seen = [
            SeenSplats(found.index, self._side_weight[inside] * found.peaks.astype(np.float64))
            for found, inside in zip(self._candidates, self._inside, strict=True)
        ]
        existing = [SeenSplats(found.index, found.peaks.astype(np.float64)) for found in orbiting]
        existing += [seen[row] for row in chosen]
        max_views = int(_COVER_SHARE * self._config.views)
        added, self.coverage = choose_covering(self._scene.counts, existing, seen, max_views)
        return added

    def _poses_for_uncovered(self, poses: Sequence[Pose], weights: F64) -> list[Pose]:
        """Return poses that look at splats outside all pictures so far, from the same positions.

        Parameters
        ----------
        poses : sequence of Pose
            Poses of all views so far.
        weights : (len(poses),) float64
            Factor on the number of splats that a new pose at each position covers.

        Returns
        -------
        list of Pose
            Poses to add, at most an eighth of the number of views.
        """
        counts = self._scene.counts
        uncovered = np.ones(len(counts), np.bool_)
        lens, near_plane = self._config.lens(), self._config.near_plane
        for pose in poses:
            uncovered &= ~in_picture(self._means, pose.camera(lens, self.down), near_plane)
        cosine = math.cos(math.atan(lens.slope * min(1.0, lens.height / lens.width)))
        extra: list[Pose] = []
        while len(extra) < int(_EXTRA_SHARE * self._config.views):
            left = np.flatnonzero(uncovered)
            if counts[left].sum() <= _UNCOVERED * counts.sum():
                break
            targets = left[_systematic(counts[left], min(_UNCOVERED_SAMPLES, len(left)))]
            best, best_pose = 0.0, None
            for pose, weight in zip(poses, weights, strict=True):
                offsets = self._means[left] - pose.position
                distances = np.maximum(np.linalg.norm(offsets, axis=1), np.finfo(np.float64).tiny)
                directions = offsets / distances[:, None]
                aims = directions[np.searchsorted(left, targets)]
                found = weight * ((aims @ directions.T > cosine) @ counts[left])
                if found.max() > best:
                    best = float(found.max())
                    best_pose = Pose(pose.position, aims[int(found.argmax())], 1.0)
            if best_pose is None:
                break
            extra.append(best_pose)
            uncovered &= ~in_picture(self._means, best_pose.camera(lens, self.down), near_plane)
        return extra


def _choose(
    candidates: Sequence[Candidate],
    weights: Sequence[float],
    counts: F64,
    exposure: F64,
    chosen: list[int],
    views: int,
) -> None:
    """Choose candidates greedily: each adds most to how clearly the views show the splats.

    Parameters
    ----------
    candidates : sequence of Candidate
        Views to choose from.
    weights : sequence of float
        Factor on the exposure of each candidate.
    counts : (M,) float64
        Number of the scene's splats that each row stands for.
    exposure : (M,) float64
        Sum over the chosen views of each splat's exposure; updated in place.
    chosen : list of int
        Rows of the chosen candidates; extended in place.
    views : int
        Number of chosen candidates to reach.

    Notes
    -----
    A view's gain is the rise of Σ log(exposure + a constant) over the splats. The exposure of a
    splat is the sum of `Candidate.exposure` over the chosen views.

    Gains only shrink as views are added, so a candidate's gain is recomputed only when its last
    known gain is the largest (lazy greedy, Minoux 1978).
    """
    if len(chosen) >= views:
        return

    def gain(row: int) -> float:
        found = candidates[row]
        added = weights[row] * found.exposure
        more = np.log1p(added / (exposure[found.index] + _SATURATION))
        return float((counts[found.index] * more).sum())

    already_chosen = set(chosen)
    queue = [
        (-gain(row), row, len(chosen))
        for row in range(len(candidates))
        if row not in already_chosen
    ]
    heapq.heapify(queue)
    while queue and len(chosen) < views:
        _, row, known = heapq.heappop(queue)
        if known < len(chosen):
            heapq.heappush(queue, (-gain(row), row, len(chosen)))
            continue
        found = candidates[row]
        exposure[found.index] += weights[row] * found.exposure
        chosen.append(row)


def _systematic(weights: F64, count: int) -> NDArray[np.intp]:
    """Return `count` rows by systematic sampling: at equal steps of the weights' running sum."""
    total = np.cumsum(weights)
    places = np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1])
    rows: NDArray[np.intp] = np.minimum(places, len(weights) - 1)
    return rows


def _weighted_median(values: F64, weights: F64) -> float:
    """Return the weighted median: the smallest value with half of the weights up to it."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order[int(np.searchsorted(total, 0.5 * total[-1]))]])
