"""Virtual views: cameras for a scene that came without any, planned from its splats alone.

A view is worth what it shows clearly. Trained splats are small where cameras were near and many
where cameras looked, so a picture from where the scene was meant to be seen resolves thousands of
them; one from behind a wall, or from inside matter, resolves a few large ones. So: step back from
splats to where they would have been seen at their size, look at the scene from there in small
pictures, refuse places that matter hems in, and choose the views that together show most.
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
from cogsplat.codec.geometry.frustum import ALPHA_MIN, NEAR, in_picture
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.peak_weights import peak_weights
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .occlusion import Matter
from .orbit import Subject, orbit, subject_of, turntable
from .pose import Lens, Pose, down_of
from .subsample import Subsample, subsample

F64 = NDArray[np.float64]

# What planning looks at, whatever the size of the scene; and what is enough to tell inside from
# outside.
_SUBSAMPLE_SPLATS: Final = 40_000
_COARSE_SPLATS: Final = 4_096
# Pixels of the small pictures.
_LOOK_PIXELS: Final = 96 * 72
_LEAST_SIDE_PX: Final = 8

# Views looked at for each one chosen: first over the whole scene, then for what is badly shown.
_FIRST_LOOKS, _SECOND_LOOKS = 4, 2
# Share of the views that is chosen before the second looks.
_FIRST_SHARE: Final = _FIRST_LOOKS / (_FIRST_LOOKS + _SECOND_LOOKS)

# A subject fills a view of 60° from about this many of its radii. A splat's subject is the nearest
# quarter of the scene: in parts of a scene that stand apart, each is its own.
_STAND_OFF: Final = 2.0
_SUBJECT_SHARE: Final = 0.25
_SUBJECT_SAMPLES: Final = 256
_SUBJECT_NEIGHBOURS: Final = 4_096
# Backgrounds are coarser than their distance asks for: nobody stands back from a sky.
_FURTHEST: Final = 3.0
# Where something stands in the way back, keep to this share of the free path, so that the jittered
# copy (30 % further back) is still on this side; unless that is this near, compared with where the
# splat would be seen at its size: then the view is from behind what stands there.
_FREE_SHARE: Final = 0.7
_NEAREST: Final = 0.12
# Of the free path's beginning so much lies in the surface itself: in sizes, and of the way.
_SURFACE_SIZES, _SURFACE_SHARE = 3.0, 0.02

# A place is inside matter where, within this share of the distance at which things there would be
# seen at their size, more than this share of all directions is blocked.
_HEMMED_REACH: Final = 0.08
_HEMMED_SHARE: Final = 0.7

# Places with matter in more directions than this are inside of something: a room, or a subject.
_INSIDE_SHARE: Final = 0.7
# A side of the walls counts by what only it shows; where that is less than this share of the
# scene on both, walls without contents are a subject, seen from outside.
_SIDE_TIE: Final = 0.03
# For that, so many splats are looked for from so many places, but for the end of each way that lies
# in the surface itself: in sizes of coarse splats, and at most so much of the way.
_SIDE_SAMPLES, _SIDE_PLACES = 512, 48
_TARGET_SIZES, _TARGET_SHARE = 4.0, 0.1
# The other side still counts so much: what it shows is worth some views, few.
_LEAST_SIDE: Final = 0.1

# A splat shown less than this is not shown. Splats shown this much once, or more, are worth little
# more of the same: the gain is logarithmic, so that views spread over the scene as detail does.
_FAINT: Final = 0.02
_SHOWN: Final = 0.1
# Visitors look about level, rather down than up; a view at right angles to that counts a tenth.
_LEVEL_DEG: Final = 15.0
_LEAST_LEVEL: Final = 0.1

# A subject stands free where half of the places of an orbit have matter in no more directions than
# the subject itself fills there, and is one where it is not so many times as large as the nearest
# quarter of itself. Then most views are an orbit's: what viewers show first, and mostly.
_FREE_MATTER: Final = 0.12
_COMPACT: Final = 3.0
_ORBIT_TRIES: Final = 24
_ORBIT_SHARE: Final = 7 / 8
# Views to measure in, and how much larger than those that are scored: errors that a small picture
# averages away are seen in a visitor's.
_TEST_VIEWS: Final = 16
_TEST_VIEW_SCALE: Final = 1.2

# Less than this share of the splats may lie outside all pictures; up to one view in eight is added
# for them, from chosen places.
_UNCOVERED: Final = 0.001
_EXTRA_SHARE: Final = 1 / 8
_UNCOVERED_SAMPLES: Final = 32

# In small scenes the near plane, which is absolute, must stay clear of the subject: cameras keep
# this many near distances and zoom in instead.
_NEARS: Final = 4.0

# Two-dimensional low-discrepancy sequence: powers of the inverse of the plastic number (Roberts
# 2018, "The unreasonable effectiveness of quasirandom sequences").
_PLASTIC: Final = 1.3247179572447460
_SEQUENCE: Final = np.array([1.0 / _PLASTIC, 1.0 / _PLASTIC**2])


@dataclass(frozen=True)
class ViewPlanConfig:
    """How many virtual views, and of what kind.

    Parameters
    ----------
    views : int
        Number of views, before those added for what they leave out (an eighth at most).
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
        """Return the picture that views are taken with, or a copy of it in another size."""
        least = min(_LEAST_SIDE_PX, self.width, self.height)
        return Lens(
            width=max(least, round(scale * self.width)),
            height=max(least, round(scale * self.height)),
            slope=math.tan(math.radians(0.5 * self.fov_deg)),
        )


@dataclass(frozen=True, eq=False)
class ViewPlan:
    """Views to score on, and views to measure in.

    Parameters
    ----------
    views : list of Camera
        Named ``virtual-000`` and on, those that show most first.
    test_views : list of Camera
        Views of a visitor's that are not among them, to see in how a scene came out: a turntable
        around a subject that stands free; none of any other scene.
    """

    views: list[Camera]
    test_views: list[Camera]


@dataclass(frozen=True, eq=False)
class _Look:
    """What a pose shows: rows of the subsample, how clearly each, and what that is worth."""

    pose: Pose
    index: NDArray[np.int32]
    peaks: NDArray[np.float32]
    worth: NDArray[np.float32]


def plan_views(
    splats: Splats, config: ViewPlanConfig | None = None, *, progress: Progress = silent
) -> list[Camera]:
    """Return the views of a `plan`."""
    return plan(splats, config, progress=progress).views


def plan(
    splats: Splats, config: ViewPlanConfig | None = None, *, progress: Progress = silent
) -> ViewPlan:
    """Plan the views to score a scene on that came without cameras.

    Objects are seen from an orbit, rooms from inside, open ground from above, and what has several
    of these from each in proportion to its detail.

    Parameters
    ----------
    splats : Splats
        Rows that cannot be drawn are left out.
    config : ViewPlanConfig or None
        None for the defaults.
    progress : Progress
        Called with ``("plan views", looks done, looks)``; raising from it stops the work.

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
    planner = _Planner(subsample(bare.take(usable), _SUBSAMPLE_SPLATS), config, progress)
    found = planner.plan()
    lens, down = config.lens(), planner.down
    views = [pose.camera(lens, down, f"virtual-{row:03d}") for row, pose in enumerate(found)]
    turned: list[Pose] = []
    if planner.subject is not None:
        turned = turntable(planner.subject, _TEST_VIEWS, down, config.near_plane)
    large = config.lens(_TEST_VIEW_SCALE)
    seen = [pose.camera(large, down, f"test-{row:02d}") for row, pose in enumerate(turned)]
    return ViewPlan(views, seen)


class _Planner:
    """One run of `plan`."""

    def __init__(self, scene: Subsample, config: ViewPlanConfig, progress: Progress) -> None:
        self._scene = scene
        self._config = config
        self._progress = progress
        self._means = scene.splats.means.astype(np.float64)
        self._matter = Matter(scene.splats, config.threads)
        self._coarse = Matter(subsample(scene.splats, _COARSE_SPLATS).splats, config.threads)
        self.down = down_of(scene.splats.info.axes)
        # Size over distance at which the scene was meant to be seen.
        self._detail = self._typical_detail()
        natural = scene.sizes / self._detail
        typical = _weighted_median(natural, scene.counts)
        self._natural: F64 = np.minimum(natural, _FURTHEST * typical)
        # What stands free, once that is known.
        self.subject: Subject | None = None
        self._proposed = 0
        self._looks: list[_Look] = []
        self._inside: list[bool] = []
        # What a look counts, by whether it is from inside.
        self._side_share = {False: 1.0, True: 1.0}
        self._exposure = np.zeros(len(scene))
        scale = math.sqrt(_LOOK_PIXELS / (config.width * config.height))
        self._small = config.lens(min(scale, 1.0))

    def plan(self) -> list[Pose]:
        """Return the poses, most telling first."""
        views, counts = self._config.views, self._scene.counts
        total = (_FIRST_LOOKS + _SECOND_LOOKS) * views
        self._progress("plan views", 0, total)
        chosen: list[int] = []
        self._look_from(self._propose(_FIRST_LOOKS * views, counts))
        self._progress("plan views", _FIRST_LOOKS * views, total)
        self._weigh_sides()
        around = self._around()
        views -= len(around)
        self._choose(chosen, max(1, round(_FIRST_SHARE * views)))
        wanting = counts / (1.0 + self._exposure / _SHOWN)
        self._look_from(self._propose(_SECOND_LOOKS * self._config.views, wanting))
        self._progress("plan views", total, total)
        self._choose(chosen, views)
        poses = around + [self._looks[row].pose for row in chosen]
        inside = [False] * len(around) + [self._inside[row] for row in chosen]
        sides = np.array([self._side_share[side] for side in inside])
        return poses + self._for_uncovered(poses, sides)

    def _around(self) -> list[Pose]:
        """Return an orbit's poses where the scene is one subject that stands free, else none."""
        subject = subject_of(self._means, self._scene.counts)
        from_outside = self._side_share[False] > self._side_share[True]
        if not (from_outside and 0.0 < subject.radius < _COMPACT * self._near_radius):
            return []
        near_plane, count = self._config.near_plane, round(_ORBIT_SHARE * self._config.views)
        tries = np.array([p.position for p in orbit(subject, _ORBIT_TRIES, self.down, near_plane)])
        matter = self._coarse.enclosed(tries, np.full(len(tries), np.inf))
        if np.median(matter) > _FREE_MATTER:
            return []
        self.subject = subject
        return orbit(subject, count, self.down, near_plane)

    def _typical_detail(self) -> float:
        """Return size over distance where subjects fill the picture, as most of the scene has it.

        The distance is that of a view which frames the nearest quarter of the scene.
        """
        counts, sizes = self._scene.counts, self._scene.sizes
        samples = _systematic(counts, min(_SUBJECT_SAMPLES, len(counts)))
        others = _systematic(counts, min(_SUBJECT_NEIGHBOURS, len(counts)))
        nearest = max(1, round(_SUBJECT_SHARE * len(others)))
        radii = np.empty(len(samples))
        for row, sample in enumerate(samples):
            squares = np.square(self._means[others] - self._means[sample]).sum(axis=1)
            radii[row] = math.sqrt(np.partition(squares, nearest - 1)[nearest - 1])
        # A scene of one point still has an extent.
        radii = np.maximum(radii, 2.0 * sizes[samples])
        self._near_radius = float(np.median(radii))
        return float(np.median(sizes[samples] / (_STAND_OFF * radii)))

    def _propose(self, count: int, wanted: F64) -> list[Pose]:
        """Return poses that look at splats drawn by `wanted`, from where there is room."""
        rows = _systematic(wanted, count)
        serial = self._proposed + np.arange(count)
        self._proposed += count
        spread = np.modf(0.5 + serial[:, None] * _SEQUENCE)[0]
        z, turn = 2.0 * spread[:, 0] - 1.0, 2.0 * np.pi * spread[:, 1]
        ring = np.sqrt(1.0 - z * z)
        back = np.stack([ring * np.cos(turn), z, ring * np.sin(turn)], axis=1)
        targets, natural = self._means[rows], self._natural[rows]
        starts = np.maximum(_SURFACE_SIZES * self._scene.sizes[rows], _SURFACE_SHARE * natural)
        free = self._matter.free_paths(targets, back, natural, starts)
        blocked = (free < natural) & (_FREE_SHARE * free > _NEAREST * natural)
        distances = np.where(blocked, _FREE_SHARE * free, natural)
        places = targets + distances[:, None] * back
        roomy = self._matter.enclosed(places, _HEMMED_REACH * natural) <= _HEMMED_SHARE
        if not roomy.any():
            # Matter everywhere, such as fog: no place is better than another.
            roomy[:] = True
        zoom = np.maximum(1.0, _NEARS * self._config.near_plane / distances)
        places = targets + (zoom * distances)[:, None] * back
        return [Pose(places[row], -back[row], float(zoom[row])) for row in np.flatnonzero(roomy)]

    def _look_from(self, poses: Sequence[Pose]) -> None:
        threads = thread_count(self._config.threads)
        total = (_FIRST_LOOKS + _SECOND_LOOKS) * self._config.views
        for found in ordered_map(self._look, poses, threads):
            self._looks.append(found)
            if len(self._looks) % self._config.views == 0:
                self._progress("plan views", len(self._looks), total)
        places = np.array([pose.position for pose in poses])
        around = self._coarse.enclosed(places, np.full(len(poses), np.inf))
        self._inside += (around > _INSIDE_SHARE).tolist()

    def _look(self, pose: Pose) -> _Look:
        camera = pose.camera(self._small, self.down)
        index, peaks = peak_weights(self._scene.splats, camera, self._config.near_plane)
        clear = peaks > _FAINT
        index, peaks = index[clear], peaks[clear]
        distances = np.linalg.norm(self._means[index] - pose.position, axis=1) / pose.zoom
        # Too far to be resolved, splats share pixels.
        resolved = np.minimum(1.0, self._scene.sizes[index] / (distances * self._detail)) ** 2
        tilt = math.asin(min(1.0, max(-1.0, float(pose.forward @ self.down))))
        level = math.cos(tilt - math.radians(_LEVEL_DEG)) ** 2
        share = _LEAST_LEVEL + (1.0 - _LEAST_LEVEL) * level
        return _Look(pose, index, peaks, (share * peaks * resolved).astype(np.float32))

    def _weigh_sides(self) -> None:
        """Decide how much views from inside and from outside of walls count."""
        counts = self._scene.counts
        samples = _systematic(counts, min(_SIDE_SAMPLES, len(counts)))
        visible = {side: self._visible_from(side, samples) for side in (False, True)}
        only = {side: float((visible[side] & ~visible[not side]).mean()) for side in visible}
        most = max(only.values())
        for side in only:
            share = float(not side) if most <= _SIDE_TIE else (only[side] / most) ** 2
            self._side_share[side] = max(share, _LEAST_SIDE)

    def _visible_from(self, side: bool, samples: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Mark the samples that some place on a side has in sight, whichever way it looked."""
        rows = [row for row, inside in enumerate(self._inside) if inside == side]
        visible = np.zeros(len(samples), np.bool_)
        coarser = math.sqrt(max(1.0, self._scene.counts.sum() / _COARSE_SPLATS))
        ends = _TARGET_SIZES * coarser * self._scene.sizes[samples]
        for row in rows[:_SIDE_PLACES]:
            hidden = np.flatnonzero(~visible)
            ways = self._means[samples[hidden]] - self._looks[row].pose.position
            distances = np.maximum(np.linalg.norm(ways, axis=1), np.finfo(np.float64).tiny)
            lengths = distances - np.minimum(ends[hidden], _TARGET_SHARE * distances)
            origins = np.broadcast_to(self._looks[row].pose.position, ways.shape)
            free = self._coarse.free_paths(
                origins, ways / distances[:, None], lengths, np.zeros(len(ways))
            )
            visible[hidden] = free >= lengths
        return visible

    def _choose(self, chosen: list[int], views: int) -> None:
        """Add the looks that show most of what the chosen ones do not yet, one after the other.

        Gains only shrink as views are added, so a look is weighed anew only when its last known
        gain is the largest (Minoux 1978).
        """
        counts = self._scene.counts

        def gain(row: int) -> float:
            found = self._looks[row]
            worth = self._side_share[self._inside[row]] * found.worth
            more = np.log1p(worth / (self._exposure[found.index] + _SHOWN))
            return float((counts[found.index] * more).sum())

        taken = set(chosen)
        queue = [
            (-gain(row), row, len(chosen)) for row in range(len(self._looks)) if row not in taken
        ]
        heapq.heapify(queue)
        while queue and len(chosen) < views:
            _, row, known = heapq.heappop(queue)
            if known < len(chosen):
                heapq.heappush(queue, (-gain(row), row, len(chosen)))
                continue
            found = self._looks[row]
            self._exposure[found.index] += self._side_share[self._inside[row]] * found.worth
            chosen.append(row)

    def _for_uncovered(self, poses: Sequence[Pose], sides: F64) -> list[Pose]:
        """Return poses from where others stand, turned to splats that lie outside all pictures."""
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
            for pose, side in zip(poses, sides, strict=True):
                ways = self._means[left] - pose.position
                ways /= np.maximum(np.linalg.norm(ways, axis=1), np.finfo(np.float64).tiny)[:, None]
                aims = ways[np.searchsorted(left, targets)]
                found = side * ((aims @ ways.T > cosine) @ counts[left])
                if found.max() > best:
                    best = float(found.max())
                    best_pose = Pose(pose.position, aims[int(found.argmax())], 1.0)
            if best_pose is None:
                break
            extra.append(best_pose)
            uncovered &= ~in_picture(self._means, best_pose.camera(lens, self.down), near_plane)
        return extra


def _systematic(weights: F64, count: int) -> NDArray[np.intp]:
    """Return `count` rows drawn at even steps of the weights' running sum."""
    total = np.cumsum(weights)
    places = np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1])
    rows: NDArray[np.intp] = np.minimum(places, len(weights) - 1)
    return rows


def _weighted_median(values: F64, weights: F64) -> float:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order[int(np.searchsorted(total, 0.5 * total[-1]))]])
