"""Virtual views: cameras for a scene that came without any, planned from its splats alone.

Trained splats are small where the capturing cameras were near, and many where these cameras looked.
A picture from a place like theirs resolves thousands of splats; one from behind a wall, or from
inside a surface, resolves a few large ones. The planner therefore proposes candidate views: from a
splat it steps back to the distance at which the splat has the size that is typical in a picture,
unless something blocks the way. It draws each candidate as a small picture, leaves out places that
splats enclose, and chooses greedily the views that together show most of the scene clearly.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.executor import Executor, LocalThreads
from cogsplat.codec.geometry.frustum import ALPHA_MIN, NEAR, in_picture
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import thread_count

from .candidates import LEVEL_DEG, Candidate, CandidateDrawing, draw_candidate, pitch_deg
from .coverage import SeenSplats, additions
from .low_discrepancy import STEPS_2D, STEPS_3D, sequence
from .occlusion import Occluders
from .orbit import OrbitTarget, bounding_ball, bounding_box, orbit, orbit_target, turntable
from .pose import Lens, Pose, down_of, level_axes
from .subsample import Subsample, subsample

F64 = NDArray[np.float64]

# Splats of the subsample that planning works on, and of the coarser one that tells whether a place
# is enclosed. They bound the time, whatever the size of the scene.
_SUBSAMPLE_SPLATS: Final = 40_000
_COARSE_SPLATS: Final = 4_096
# Pixels of the small picture of a candidate.
_CANDIDATE_PIXELS: Final = 96 * 72
_LEAST_SIDE_PX: Final = 8

# Candidates for each view chosen: in the first round over the whole scene, in the second for what
# the views chosen so far show badly.
_FIRST_ROUND, _SECOND_ROUND = 4, 2
# Share of the views that is chosen after the first round.
_FIRST_SHARE: Final = _FIRST_ROUND / (_FIRST_ROUND + _SECOND_ROUND)

# A splat's vicinity is the nearest quarter of the scene, so that each of several things that stand
# apart has its own. It fills a view of 60° from about this many of its radii. Vicinities are
# measured for some splats only, and among some.
_FILLING: Final = 2.0
_VICINITY_SHARE: Final = 0.25
_VICINITY_SAMPLES: Final = 256
_VICINITY_NEIGHBOURS: Final = 4_096
# Viewing distances are at most so many times the median one: the large splats of a background are
# not meant to be seen from as far away as their size would ask for.
_FURTHEST: Final = 3.0
# Where splats block the way back from a splat, the camera keeps to this share of the free length,
# so that its jittered copy (30 % further back) stands before them as well. Where that would be
# nearer than this share of the viewing distance, the camera stands at the viewing distance, behind
# what blocks the way.
_FREE_SHARE: Final = 0.7
_NEAREST: Final = 0.12
# The first part of the way back lies in the splat's own surface and does not count: so many sizes
# of the splat, or this share of the way if that is more.
_SURFACE_SIZES, _SURFACE_SHARE = 3.0, 0.02

# A place is enclosed by splats, such as one inside a solid object, where within this share of the
# viewing distance more than this share of all directions is blocked.
_ENCLOSED_REACH: Final = 0.08
_ENCLOSED_OCCLUSION: Final = 0.7

# A place with splats in more than this share of all directions, at any distance, is inside of
# something: a room, or an object.
_INSIDE_OCCLUSION: Final = 0.7
# Views from inside and from outside count by the share of the scene that only they can show. Where
# that is at most this much on both sides, the walls hold nothing: the scene is an object, seen from
# outside.
_SIDE_TIE: Final = 0.03
# Visibility for this is tested for so many splats from so many places. The end of each ray lies in
# the surface that it aims at and does not count: so many sizes of coarse splats, at most this share
# of the way.
_SIDE_SAMPLES, _SIDE_PLACES = 512, 48
_TARGET_SIZES, _TARGET_SHARE = 4.0, 0.1
# Views of the other side count at least this much: what only they show deserves a few views.
_LEAST_SIDE: Final = 0.1

# Exposure beyond this adds little: the gain is logarithmic, so that views spread over the scene as
# its detail does.
_SHOWN: Final = 0.1

# An object is isolated where, from half of the poses of an orbit, splats block at most this share
# of the directions (the object itself fills about as much), and its radius is less than so many
# radii of the median vicinity. Then all views are poses of an orbit: that is what viewers show.
_ISOLATED_OCCLUSION: Final = 0.12
_COMPACT: Final = 3.0
_ORBIT_TRIES: Final = 24
# Number of test views, and how much larger they are than the views to score on: a small picture
# averages away errors that a visitor sees.
_TEST_VIEWS: Final = 32
_TEST_VIEW_SCALE: Final = 1.2
# Of so many times as many places of visitors those are taken that look up or down by at most this
# angle from the usual pitch, and from where nothing is nearer than this share of the median
# vicinity's radius. Of these, the half is taken that splats leave most room: within the second
# share of that radius they block the fewest directions. A visitor stands in the room, not in a
# chest that stands in it.
_VISITORS_DRAWN: Final = 8
_STEEPEST_DEG: Final = 30.0
_CLEARANCE: Final = 0.2
_ROOM: Final = 0.5

# At most this share of the splats may lie outside all views. For the others up to one more view for
# each eight is added, from places that were chosen.
_UNCOVERED: Final = 0.001
_EXTRA_SHARE: Final = 1 / 8
# Views that are added so that all that is visible is covered, for each that was asked for, at most.
_COVER_SHARE: Final = 1 / 2
_UNCOVERED_SAMPLES: Final = 32

# The near plane is a fixed distance. In a small scene it would cut the object off: cameras keep
# this many near-plane distances from the splat they look at, and zoom in instead.
_NEAR_PLANES: Final = 4.0


@dataclass(frozen=True)
class ViewPlanConfig:
    """Number and image size of virtual views.

    Parameters
    ----------
    views : int
        Number of views, before those added so that all that is visible is covered (half as many at
        most), and for splats outside all of them (an eighth at most).
    width, height : int
        Size of each, px.
    fov_deg : float
        Horizontal field of view, degrees.
    near_plane : float
        Camera-space depth up to which scoring draws nothing, scene units.
    threads : int
        0 for every core this process may use. The plan does not depend on it.
    """

    views: int = 64
    width: int = 400
    height: int = 300
    fov_deg: float = 60.0
    near_plane: float = NEAR
    threads: int = 0

    def __post_init__(self) -> None:
        if self.views < 1:
            raise ValueError(f"{self.views} views, expected at least 1")
        if not (1 <= self.width <= 65535 and 1 <= self.height <= 65535):
            raise ValueError(f"views of {self.width}x{self.height} px, expected 1 to 65535")
        if not 1.0 <= self.fov_deg <= 150.0:
            raise ValueError(f"a field of view of {self.fov_deg} degrees, expected 1 to 150")
        if not self.near_plane > 0.0:
            raise ValueError(f"near_plane {self.near_plane}, expected more than 0")
        thread_count(self.threads)

    def lens(self, scale: float = 1.0) -> Lens:
        """Return image size and field of view; `scale` multiplies width and height."""
        least = min(_LEAST_SIDE_PX, self.width, self.height)
        return Lens(
            width=max(least, round(scale * self.width)),
            height=max(least, round(scale * self.height)),
            slope=math.tan(math.radians(0.5 * self.fov_deg)),
        )


@dataclass(frozen=True, eq=False)
class ViewPlan:
    """Views to score on, and other views to test in.

    Parameters
    ----------
    views : list of Camera
        Named ``virtual-000`` and on; those that show most come first.
    covering_views : list of Camera
        Named ``covering-000`` and on: views of what the orbit around an isolated object leaves out,
        such as the bottom of a bowl. They say that it is visible, not how often visitors see it:
        means over views leave them out. Empty for other scenes, where views are chosen by what they
        show: those that are added are among `views`.
    test_views : list of Camera
        Named ``test-00`` and on, from places that the others have none in: all around an isolated
        object, or anywhere that a visitor of another scene may be. They are not chosen by what they
        show, and nothing is tuned on them.
    coverage : float
        Share of the visible splats that `views` and `covering_views` cover
        (`coverage.additions`), 0 to 1.
    """

    views: list[Camera]
    covering_views: list[Camera]
    test_views: list[Camera]
    coverage: float


def plan_views(
    splats: Splats, config: ViewPlanConfig | None = None, *, progress: Progress = silent
) -> list[Camera]:
    """Plan the views to score a scene on that came without cameras.

    Parameters
    ----------
    splats, config, progress
        As `plan` takes them.

    Returns
    -------
    list of Camera
        `ViewPlan.views`, then `ViewPlan.covering_views`.

    Raises
    ------
    DataError
        As `plan`.

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
    """Plan the views to score and to test a scene on that came without cameras.

    Objects are seen from an orbit, rooms from inside, open ground from above, and what has several
    of these from each in proportion to its detail.

    Parameters
    ----------
    splats : Splats
        Rows that cannot be drawn are left out.
    config : ViewPlanConfig or None
        None for the defaults.
    executor : Executor, optional
        What runs the work of single views; threads of this process where it is not given.
    progress : Progress
        Called with ``("plan views", candidates drawn, candidates)``; raising from it stops the
        work.

    Returns
    -------
    ViewPlan
        The same for any number of threads.

    Raises
    ------
    DataError
        ``empty-scene``: no splat that could be drawn.
    """
    config = config or ViewPlanConfig()
    # Without SH from the start: copies of it would be most of the work.
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
    visitors = enumerate(planner.test_poses())
    tests = [pose.camera(large, down, f"test-{row:02d}") for row, pose in visitors]
    return ViewPlan(
        cameras(poses, "virtual"), cameras(covering, "covering"), tests, planner.coverage
    )


class _Planner:
    """One run of `plan`.

    Parameters
    ----------
    scene : Subsample
        M splats.
    config : ViewPlanConfig
    executor : Executor
        What draws the candidates.
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
        self.down = down_of(scene.splats.info.axes)
        # Size over distance that is typical of the scene's splats in a picture.
        self._detail = self._typical_detail()
        distances = scene.sizes / self._detail
        typical = _weighted_median(distances, scene.counts)
        # From where each splat has that size.
        self._viewing_distances: F64 = np.minimum(distances, _FURTHEST * typical)
        # Whether the scene is an isolated object, once that is known.
        self._isolated = False
        # What the views cover, once they are chosen.
        self.coverage = 1.0
        self._proposed = 0
        self._candidates: list[Candidate] = []
        # Whether each candidate's place is inside of something, and what such a view counts.
        self._inside: list[bool] = []
        self._side_weight = {False: 1.0, True: 1.0}
        # How well the chosen views show each splat together.
        self._exposure = np.zeros(len(scene))
        scale = math.sqrt(_CANDIDATE_PIXELS / (config.width * config.height))
        lens = config.lens(min(scale, 1.0))
        drawing = CandidateDrawing(scene, self._detail, lens, self.down, config.near_plane)
        self._drawing = drawing

    def plan(self) -> tuple[list[Pose], list[Pose]]:
        """Return the poses of the views, those that show most first, and of the covering views."""
        views, counts = self._config.views, self._scene.counts
        total = (_FIRST_ROUND + _SECOND_ROUND) * views
        self._progress("plan views", 0, total)
        chosen: list[int] = []
        self._draw_candidates(self._propose(_FIRST_ROUND * views, counts))
        self._progress("plan views", _FIRST_ROUND * views, total)
        self._weigh_sides()
        around = self._orbit_poses()
        # What the orbit shows needs no covering views.
        orbiting = list(self._executor.map(draw_candidate, around, self._drawing))
        for found in orbiting:
            self._exposure[found.index] += found.exposure
        views -= len(around)
        self._choose(chosen, round(_FIRST_SHARE * views))
        badly_shown = counts / (1.0 + self._exposure / _SHOWN)
        self._draw_candidates(self._propose(_SECOND_ROUND * self._config.views, badly_shown))
        self._progress("plan views", total, total)
        self._choose(chosen, views)
        chosen += self._cover(chosen, orbiting)
        poses = around + [self._candidates[row].pose for row in chosen]
        inside = [False] * len(around) + [self._inside[row] for row in chosen]
        weights = np.array([self._side_weight[side] for side in inside])
        poses += self._for_uncovered(poses, weights)
        views = len(around) or len(poses)
        return poses[:views], poses[views:]

    def _orbit_poses(self) -> list[Pose]:
        """Return the poses of all views of a compact isolated object; none in other scenes."""
        target = orbit_target(self._means, self._scene.counts)
        self._isolated = self._is_isolated(target)
        if not (self._isolated and target.radius < _COMPACT * self._vicinity_radius):
            return []
        return orbit(target, self._config.views, self.down, self._config.near_plane)

    def _is_isolated(self, target: OrbitTarget) -> bool:
        """Tell whether an object is all there is around the poses of an orbit."""
        if self._from_inside or not target.radius > 0.0:
            return False
        tries = orbit(target, _ORBIT_TRIES, self.down, self._config.near_plane)
        places = np.array([pose.position for pose in tries])
        occlusion = self._coarse.occlusion(places, np.full(len(places), np.inf))
        return bool(np.median(occlusion) <= _ISOLATED_OCCLUSION)

    @property
    def _from_inside(self) -> bool:
        """Whether the scene is one to look at from inside."""
        return self._side_weight[True] >= self._side_weight[False]

    def test_poses(self) -> list[Pose]:
        """Return the poses of the test views; `plan` comes first.

        Around an isolated object they are those of a turntable that shows the whole of it. In
        other scenes they are visitors': they look at splats about level, from the side that the
        scene is seen from, and keep clear of everything.
        """
        means, counts = self._means, self._scene.counts
        if self._isolated:
            whole = bounding_ball(means, counts)
            return turntable(whole, _TEST_VIEWS, self.down, self._config.near_plane)
        count = _VISITORS_DRAWN * _TEST_VIEWS
        # Outside they are drawn as candidates are, but none of them is one.
        drawn = self._visitors(count) if self._from_inside else self._propose(count, counts)
        places = np.array([pose.position for pose in drawn])
        around = self._coarse.occlusion(places, np.full(len(drawn), np.inf))
        near, room = (
            self._coarse.occlusion(places, np.full(len(drawn), share * self._vicinity_radius))
            for share in (_CLEARANCE, _ROOM)
        )
        pitches = np.array([pitch_deg(pose, self.down) for pose in drawn])
        level = np.abs(pitches - LEVEL_DEG) < _STEEPEST_DEG
        right_side = (around > _INSIDE_OCCLUSION) == self._from_inside
        fits = right_side & level & (near == 0.0)
        if fits.any():
            fits &= room <= np.median(room[fits])
        # The clearest places where none is clear; all where none is on the right side.
        unfit = np.lexsort((np.arange(len(drawn)), ~fits, near > 0.0, ~level, ~right_side))
        fitting = sorted(unfit[:_TEST_VIEWS].tolist())
        return [drawn[row] for row in fitting]

    def _visitors(self, count: int) -> list[Pose]:
        """Return poses anywhere in the box of the scene that look about level in any direction."""
        box = bounding_box(self._means, self._scene.counts)
        numbers = np.arange(count)
        places = box[0] + sequence(numbers, STEPS_3D) * (box[1] - box[0])
        looks = sequence(numbers, STEPS_2D)
        pitches = np.radians(LEVEL_DEG + _STEEPEST_DEG * (2.0 * looks[:, 0] - 1.0))
        angles = 2.0 * np.pi * looks[:, 1]
        down = self.down if self.down.any() else np.array([0.0, 1.0, 0.0])
        side, other = level_axes(down)
        level = np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * other
        forward = np.cos(pitches)[:, None] * level + np.sin(pitches)[:, None] * down
        return [Pose(place, look, 1.0) for place, look in zip(places, forward, strict=True)]

    def _typical_detail(self) -> float:
        """Return the median, over splats, of size over the distance of a picture of the vicinity.

        From that distance the splat's vicinity fills the view.
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
        return float(np.median(sizes[samples] / (_FILLING * radii)))

    def _propose(self, count: int, weights: F64) -> list[Pose]:
        """Return poses that look at splats drawn by weight, from viewing distance if that is free.

        Parameters
        ----------
        count : int
        weights : (M,) float64
            Chance of each splat to be looked at.

        Returns
        -------
        list of Pose
            At most `count`: places that splats enclose are left out.
        """
        rows = _systematic(weights, count)
        points = sequence(self._proposed + np.arange(count), STEPS_2D)
        self._proposed += count
        height, azimuth = 2.0 * points[:, 0] - 1.0, 2.0 * np.pi * points[:, 1]
        ring = np.sqrt(1.0 - height * height)
        back = np.stack([ring * np.cos(azimuth), height, ring * np.sin(azimuth)], axis=1)
        targets, wanted = self._means[rows], self._viewing_distances[rows]
        starts = np.maximum(_SURFACE_SIZES * self._scene.sizes[rows], _SURFACE_SHARE * wanted)
        free = self._occluders.free_lengths(targets, back, wanted, starts)
        blocked = (free < wanted) & (_FREE_SHARE * free > _NEAREST * wanted)
        distances = np.where(blocked, _FREE_SHARE * free, wanted)
        places = targets + distances[:, None] * back
        occlusion = self._occluders.occlusion(places, _ENCLOSED_REACH * wanted)
        usable = occlusion <= _ENCLOSED_OCCLUSION
        if not usable.any():
            # Splats everywhere, such as fog: no place is better than another.
            usable[:] = True
        zoom = np.maximum(1.0, _NEAR_PLANES * self._config.near_plane / distances)
        places = targets + (zoom * distances)[:, None] * back
        return [Pose(places[row], -back[row], float(zoom[row])) for row in np.flatnonzero(usable)]

    def _draw_candidates(self, poses: Sequence[Pose]) -> None:
        """Draw a small picture from each pose and add the candidates."""
        total = (_FIRST_ROUND + _SECOND_ROUND) * self._config.views
        for found in self._executor.map(draw_candidate, poses, self._drawing):
            self._candidates.append(found)
            if len(self._candidates) % self._config.views == 0:
                self._progress("plan views", len(self._candidates), total)
        places = np.array([pose.position for pose in poses])
        occlusion = self._coarse.occlusion(places, np.full(len(poses), np.inf))
        self._inside += (occlusion > _INSIDE_OCCLUSION).tolist()

    def _weigh_sides(self) -> None:
        """Decide how much views from inside and from outside of walls count."""
        counts = self._scene.counts
        samples = _systematic(counts, min(_SIDE_SAMPLES, len(counts)))
        visible = {side: self._visible_from(side, samples) for side in (False, True)}
        only = {side: float((visible[side] & ~visible[not side]).mean()) for side in visible}
        most = max(only.values())
        for side in only:
            share = float(not side) if most <= _SIDE_TIE else (only[side] / most) ** 2
            self._side_weight[side] = max(share, _LEAST_SIDE)

    def _visible_from(self, side: bool, samples: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Mark the samples that some candidate's place on a side sees, in any direction.

        Parameters
        ----------
        side : bool
            True for places inside, False for those outside.
        samples : (n,) intp
            Rows of the subsample.

        Returns
        -------
        (n,) bool
        """
        rows = [row for row, inside in enumerate(self._inside) if inside == side]
        visible = np.zeros(len(samples), np.bool_)
        coarser = math.sqrt(max(1.0, self._scene.counts.sum() / _COARSE_SPLATS))
        ends = _TARGET_SIZES * coarser * self._scene.sizes[samples]
        for row in rows[:_SIDE_PLACES]:
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

    def _choose(self, chosen: list[int], views: int) -> None:
        """Add the candidates that show most of what the chosen ones do not show yet, one by one.

        Parameters
        ----------
        chosen : list of int
            Rows of the candidates; extended in place.
        views : int
            How many there are to be in the end.

        Notes
        -----
        Marginal gains only shrink as views are added, so a candidate is evaluated anew only when
        its last known gain is the largest (lazy greedy, Minoux 1978).
        """
        if len(chosen) >= views:
            return
        counts = self._scene.counts

        def gain(row: int) -> float:
            found = self._candidates[row]
            added = self._side_weight[self._inside[row]] * found.exposure
            more = np.log1p(added / (self._exposure[found.index] + _SHOWN))
            return float((counts[found.index] * more).sum())

        taken = set(chosen)
        queue = [
            (-gain(row), row, len(chosen))
            for row in range(len(self._candidates))
            if row not in taken
        ]
        heapq.heapify(queue)
        while queue and len(chosen) < views:
            _, row, known = heapq.heappop(queue)
            if known < len(chosen):
                heapq.heappush(queue, (-gain(row), row, len(chosen)))
                continue
            found = self._candidates[row]
            self._exposure[found.index] += self._side_weight[self._inside[row]] * found.exposure
            chosen.append(row)

    def _cover(self, chosen: Sequence[int], orbiting: Sequence[Candidate]) -> list[int]:
        """Return the candidates that cover the rest of what is visible; note how much is covered.

        Parameters
        ----------
        chosen : sequence of int
            Candidates that are views already.
        orbiting : sequence of Candidate
            Views that are not among the candidates.
        """
        seen = [
            SeenSplats(found.index, self._side_weight[inside] * found.peaks.astype(np.float64))
            for found, inside in zip(self._candidates, self._inside, strict=True)
        ]
        there = [SeenSplats(found.index, found.peaks.astype(np.float64)) for found in orbiting]
        there += [seen[row] for row in chosen]
        most = int(_COVER_SHARE * self._config.views)
        added, self.coverage = additions(self._scene.counts, there, seen, most)
        return added

    def _for_uncovered(self, poses: Sequence[Pose], weights: F64) -> list[Pose]:
        """Return poses in places of given ones that look at splats outside all their pictures.

        Parameters
        ----------
        poses : sequence of Pose
        weights : (len(poses),) float64
            What a view from each place counts.

        Returns
        -------
        list of Pose
            At most one for each eight views.
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


def _systematic(weights: F64, count: int) -> NDArray[np.intp]:
    """Return `count` rows by systematic sampling: at even steps of the weights' running sum."""
    total = np.cumsum(weights)
    places = np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1])
    rows: NDArray[np.intp] = np.minimum(places, len(weights) - 1)
    return rows


def _weighted_median(values: F64, weights: F64) -> float:
    """Return the smallest value up to which half of the weights lies."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order[int(np.searchsorted(total, 0.5 * total[-1]))]])
