"""Settings of the SuperSplat viewer as JSON: background, start camera, track, annotations.

Source: Experience Settings, version 2 (developer.playcanvas.com, SuperSplat's user manual, 2026);
settings without a version are the first one (github.com/playcanvas/supersplat-viewer, src/schemas).
Settings are a file next to the scene. The viewer turns scenes by 180° about z: its positions are
those of the splats, in the axes of 3DGS training, with x and y negated. Fields of view are vertical
here.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatWarning, FormatError
from cogsplat.codec.views.view_text import ViewText, view_text
from cogsplat.formats.cogs.description import Annotation, CameraPath, Description, PathStop
from cogsplat.formats.cogs.description_segment import MAX_STOPS
from cogsplat.formats.cogs.moved_description import right_down_front
from cogsplat.formats.storage.atomic import atomic_write
from cogsplat.formats.storage.strict_json import JsonObject

F64 = NDArray[np.float64]

_CODE: Final = "bad-settings-file"
_VERSION: Final = 2
# Field of view of settings of the first version that state none, degrees.
_FIRST_FOV: Final = 60.0

# The viewer's axes in terms of right, down, front.
_VIEWER: Final = np.diag([-1.0, -1.0, 1.0])
# Frames a second of written tracks; times are seconds times this.
_FRAME_RATE: Final = 30
# Depth of the target of a view without one, scene units.
_DEPTH: Final = 1.0


@dataclass(frozen=True, eq=False)
class ViewerSettings:
    """Parts of SuperSplat's settings that COGS stores, in the scene's axes.

    Parameters
    ----------
    description : Description
        Description with a background, a camera path and annotations only.
    first_view : Camera or None
        Camera where the viewer starts.
    """

    description: Description
    first_view: Camera | None


def is_settings(value: Mapping[str, object]) -> bool:
    """Whether a JSON object holds settings of SuperSplat rather than a description."""
    return any(key in value for key in ("animTracks", "tonemapping", "cameras", "camera"))


def parse_settings(value: Mapping[str, object], where: str, axes: str, up: F64) -> ViewerSettings:
    """Parse settings of the SuperSplat viewer into the axes of a scene.

    Parameters
    ----------
    value : mapping
        Settings as a JSON object.
    where : str
        Name of the file in messages.
    axes : str
        Axes of the scene, such as ``RDF``.
    up : (3,) float64
        Direction against gravity in the frame of the means, in which views are level.

    Raises
    ------
    FormatError
        ``bad-settings-file``: another version than the first and 2, or a value of another type.
    """
    root = JsonObject(dict(value), where, _CODE)
    if "version" not in root and "camera" in root:
        root = _from_first_version(root)
    if root.integer("version", 0, 1 << 30, default=0) != _VERSION:
        raise root.wrong("version", "settings of version 2")
    into = (_VIEWER @ right_down_front(axes)).T
    reader = _Reader(into, up)
    cameras = root.children("cameras")
    first = reader.view(cameras[0].child("initial")) if cameras else None
    tracks = root.children("animTracks")
    background = None
    if "background" in root:
        red, green, blue = root.child("background").numbers("color", 3)
        background = (_share(red), _share(green), _share(blue))
    description = Description(
        background=background,
        path=reader.path(tracks[0]) if tracks else None,
        annotations=tuple(reader.annotation(one) for one in root.children("annotations")),
    )
    return ViewerSettings(description, first)


def _from_first_version(root: JsonObject) -> JsonObject:
    """Return settings of the first version, which states none, as settings of version 2."""
    camera = root.child("camera")
    fov = camera.number("fov", _FIRST_FOV)
    value: dict[str, object] = {"version": _VERSION}
    if "position" in camera and "target" in camera:
        pose = {key: camera.values[key] for key in ("position", "target")}
        value["cameras"] = [{"initial": {**pose, "fov": fov}}]
    if "background" in root and "color" in root.child("background"):
        value["background"] = root.values["background"]
    tracks = []
    for track in root.children("animTracks"):
        frames = track.child("keyframes")
        times = frames.numbers("times")
        values = {**frames.child("values").values, "fov": [fov] * len(times)}
        # Times are in seconds where the track states no frame rate.
        rate = track.number("frameRate", 1.0)
        keyframes = {"times": times, "values": values}
        tracks.append({**track.values, "frameRate": rate, "keyframes": keyframes})
    return JsonObject({**value, "animTracks": tracks}, root.where, _CODE)


def _share(value: float) -> float:
    """Return a colour component, cut to 0 to 1."""
    return min(max(value, 0.0), 1.0)


class _Reader:
    """Reader of positions and views of settings, into the axes of a scene.

    Parameters
    ----------
    into : (3, 3) float64
        Matrix from the viewer's axes to those of the scene.
    up : (3,) float64
        Direction against gravity in the frame of the means.
    """

    def __init__(self, into: F64, up: F64) -> None:
        self._into, self._up = into, up

    def point(self, values: Sequence[float]) -> tuple[float, float, float]:
        """Return a position in the frame of the means."""
        x, y, z = (self._into @ np.array(values)).tolist()
        return x, y, z

    def view(self, pose: JsonObject) -> Camera:
        """Parse a pose of the settings: position, target and field of view."""
        numbers = [*pose.numbers("position", 3), *pose.numbers("target", 3), pose.number("fov")]
        return self._view(numbers, pose.where)

    def _view(self, numbers: Sequence[float], where: str) -> Camera:
        """Return the view of position, target and field of view in degrees."""
        position, target, fov = numbers[:3], numbers[3:6], numbers[6]
        if list(position) == list(target) or not 0 < fov < 180:
            raise FormatError(
                _CODE, f"{where}: {list(numbers)}, expected two points and an angle below 180"
            )
        return ViewText(self.point(position), self.point(target), fov).camera(self._up)

    def path(self, track: JsonObject) -> CameraPath | None:
        """Return the camera path of a track; None for one of fewer than two times."""
        frames = track.child("keyframes")
        values = frames.child("values")
        times = frames.numbers("times")
        count = len(times)
        rate = track.number("frameRate")
        positions = np.array(values.numbers("position", 3 * count)).reshape(-1, 3)
        targets = np.array(values.numbers("target", 3 * count)).reshape(-1, 3)
        fovs = values.numbers("fov", count)
        ascend = rate > 0 and all(a < b for a, b in pairwise(times))
        if not ascend or count > MAX_STOPS:
            raise FormatError(
                _CODE, f"{track.where}: expected ascending times, at most {MAX_STOPS}"
            )
        if count < 2:
            return None
        stops = [
            PathStop((time - times[0]) / rate, self._view([*a, *b, fov], track.where))
            for time, a, b, fov in zip(times, positions, targets, fovs, strict=True)
        ]
        loop = track.text("loopMode", "none") == "repeat"
        duration = track.number("duration")
        if loop and duration > stops[-1].time and count < MAX_STOPS:
            # The viewer moves on to the first view until the track ends.
            stops.append(PathStop(duration, stops[0].camera))
        return CameraPath(tuple(stops), loop)

    def annotation(self, value: JsonObject) -> Annotation:
        """Return an annotation."""
        view = value.child("camera").child("initial") if "camera" in value else None
        return Annotation(
            np.array(self.point(value.numbers("position", 3))),
            value.text("title"),
            value.text("text", ""),
            None if view is None else self.view(view),
        )


def write_settings(
    path: Path,
    description: Description,
    first_view: Camera | None,
    axes: str,
    up: F64,
    *,
    force: bool = False,
) -> int:
    """Write a description and first view as settings; return the bytes written.

    Titles, texts, named views and pictures have no place in settings; a warning names them.

    Parameters
    ----------
    path : Path
        Output file.
    description, first_view
        Description, and camera where viewers start.
    axes, up
        As in `parse_settings`.
    force : bool
        Whether to replace an existing file.

    Raises
    ------
    StorageError
        The file cannot be written.
    """
    out = _VIEWER @ right_down_front(axes)
    names = ("title", "text", "licence", "credits", "date", "metres_per_unit", "views",
             "georeference", "poster", "sky")  # fmt: skip
    lost = [name for name in names if getattr(description, name) not in (None, ())]
    if lost:
        warnings.warn(
            f"{path}: without {', '.join(lost)}, which settings have no place for",
            CogsplatWarning,
            stacklevel=2,
        )
    text = json.dumps(_settings(description, first_view, out, up), indent=2) + "\n"
    with atomic_write(path, force=force) as file:
        file.write(text.encode())
    return len(text.encode())


def _settings(
    description: Description, first_view: Camera | None, out: F64, up: F64
) -> dict[str, object]:
    """Return the settings as a JSON object; `out` takes the scene's axes to the viewer's."""

    def point(values: F64) -> list[float]:
        return [float(value) for value in out @ values]

    def pose(camera: Camera) -> dict[str, object]:
        x, y, z, tx, ty, tz, fov, *_ = map(float, view_text(camera, up, _target(camera)).split(","))
        position, target = np.array([x, y, z]), np.array([tx, ty, tz])
        return {"position": point(position), "target": point(target), "fov": fov}

    path = description.path
    tracks = []
    if path is not None:
        poses = [pose(stop.camera) for stop in path.stops]
        tracks.append(
            {
                "name": "path",
                "duration": path.stops[-1].time,
                "frameRate": _FRAME_RATE,
                "loopMode": "repeat" if path.loop else "none",
                "interpolation": "spline",
                "smoothness": 1,
                "keyframes": {
                    "times": [stop.time * _FRAME_RATE for stop in path.stops],
                    "values": {
                        "position": _flat(poses, "position"),
                        "target": _flat(poses, "target"),
                        "fov": [one["fov"] for one in poses],
                    },
                },
            }
        )
    start = [] if first_view is None else [{"initial": pose(first_view)}]
    return {
        "version": _VERSION,
        "tonemapping": "none",
        "highPrecisionRendering": False,
        "background": {"color": list(description.background or (0.0, 0.0, 0.0))},
        "postEffectSettings": _no_effects(),
        "cameras": start,
        "animTracks": tracks,
        "annotations": [
            {
                "position": point(one.place),
                "title": one.title,
                "text": one.text,
                "extras": {},
                "camera": {"initial": pose(one.view)}
                if one.view is not None
                else (start[0] if start else {"initial": _towards(point(one.place))}),
            }
            for one in description.annotations
        ],
        "startMode": "default",
    }


def _flat(poses: Sequence[Mapping[str, object]], key: str) -> list[object]:
    """Return the concatenated numbers of a key of all poses."""
    found: list[object] = []
    for pose in poses:
        values = pose[key]
        assert isinstance(values, list)
        found += values
    return found


def _towards(place: Sequence[float]) -> dict[str, object]:
    """Return a pose in front of a place, for annotations of a scene without a first view."""
    x, y, z = place
    return {"position": [x, y, z + 2 * _DEPTH], "target": [x, y, z], "fov": 60.0}


def _target(camera: Camera) -> F64:
    """Return the target of a camera, or a point in front of it."""
    if camera.target is not None:
        return camera.target
    ahead: F64 = camera.position + _DEPTH * camera.rotation[2]
    return ahead


def _no_effects() -> dict[str, object]:
    """Return the settings of effects, all off."""
    return {
        "sharpness": {"enabled": False, "amount": 0},
        "bloom": {"enabled": False, "intensity": 1, "blurLevel": 2},
        "grading": {
            "enabled": False,
            "brightness": 0,
            "contrast": 1,
            "saturation": 1,
            "tint": [1, 1, 1],
        },
        "vignette": {
            "enabled": False,
            "intensity": 0.5,
            "inner": 0.3,
            "outer": 0.75,
            "curvature": 1,
        },
        "fringing": {"enabled": False, "intensity": 0.5},
    }
