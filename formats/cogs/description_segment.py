"""Encode and decode the segments of the description and its pictures (SPEC 5.13, 5.14)."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatError, DataError, FormatError

from . import canonical_msgpack
from .canonical_msgpack import Value
from .description import (
    PICTURES,
    Annotation,
    CameraPath,
    Description,
    Georeference,
    PathStop,
    Picture,
)
from .layout import MAX_CAMERA_VALUES, MAX_DESCRIPTION_BYTES, MAX_PICTURE_BYTES, SegmentKind
from .msgpack_map import CheckedMap
from .picture_header import JPEG, WEBP, picture_header
from .root import camera_map, parse_camera
from .writer import Segment

_T = TypeVar("_T")

MAX_VIEWS: Final = 256
MAX_ANNOTATIONS: Final = 256
MAX_STOPS: Final = 1024
MAX_PICTURE_SIDE: Final = 8192
"""Longest side of a picture, px (SPEC 9.1)."""

MAX_TEXT_BYTES: Final = {"title": 255, "text": 16384, "licence": 255, "credits": 1024}
"""Longest texts of a description, bytes (SPEC 5.13)."""

MAX_ANNOTATION_BYTES: Final = 4096
MAX_CRS_BYTES: Final = 4096
MAX_NAME_BYTES: Final = 255
MAX_DATE_BYTES: Final = 32

UNITS: Final = ("mm", "cm", "m", "km", "in", "ft")
"""Units in which viewers show lengths (SPEC 5.13)."""

_DATE: Final = re.compile(
    r"[0-9]{4}(-(0[1-9]|1[0-2])(-(0[1-9]|[12][0-9]|3[01])"
    r"(T([01][0-9]|2[0-3]):[0-5][0-9](:[0-5][0-9](\.[0-9]{1,9})?)?"
    r"(Z|[+-]([01][0-9]|2[0-3]):[0-5][0-9])?)?)?)?"
)
# Control characters other than tab and line feed.
_CONTROLS: Final = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f]")


def pack_description(
    description: Description, unknown: Mapping[str, Value] = MappingProxyType({})
) -> bytes:
    """Encode a description as the payload of its segment, without the pictures' files.

    Parameters
    ----------
    description : Description
        Description to encode.
    unknown : mapping of str to Value
        Further keys of the map, which readers skip.

    Raises
    ------
    DataError
        ``bad-description``: a value that readers refuse.
    """
    payload = canonical_msgpack.pack({**description_map(description), **unknown})
    try:
        unpack_description(payload, "description")
    except CogsplatError as error:
        raise DataError("bad-description", error.message) from error
    if len(payload) > MAX_DESCRIPTION_BYTES:
        raise DataError(
            "bad-description",
            f"a description of {len(payload)} bytes, expected at most {MAX_DESCRIPTION_BYTES}",
        )
    return payload


def pack_segments(
    description: Description | None, unknown: Mapping[str, Value] = MappingProxyType({})
) -> list[Segment]:
    """Return the segments of a description and its pictures; an empty list for no description.

    Parameters
    ----------
    description : Description or None
        Description to encode; None for none.
    unknown : mapping of str to Value
        Further keys of the description's map, which readers skip.

    Raises
    ------
    DataError
        ``bad-description``: a value or a picture that readers refuse, or a picture without its
        file.
    """
    if description is None or description.is_empty:
        return []
    segments = [Segment(SegmentKind.DESCRIPTION, 0, pack_description(description, unknown))]
    for name, picture in description.pictures().items():
        if picture.data is None:
            raise DataError("bad-description", f"{name}: no file, expected the picture's bytes")
        if len(picture.data) > MAX_PICTURE_BYTES:
            raise DataError(
                "bad-description",
                f"{name}: {len(picture.data)} bytes, expected at most {MAX_PICTURE_BYTES}",
            )
        try:
            check_picture(picture, picture.data, name)
        except FormatError as error:
            raise DataError("bad-description", error.message) from error
        segments.append(Segment(SegmentKind.PICTURE, PICTURES.index(name), picture.data))
    return segments


def description_map(description: Description) -> dict[str, Value]:
    """Return a description as a msgpack map (SPEC 5.13)."""
    value: dict[str, Value] = {}
    for key in ("title", "text", "licence", "credits", "date", "metres_per_unit", "unit"):
        found = getattr(description, key)
        if found is not None:
            value[key] = float(found) if key == "metres_per_unit" else found
    if description.background is not None:
        value["background"] = [float(x) for x in description.background]
    if description.views:
        value["views"] = [{"name": view.name, **camera_map(view)} for view in description.views]
    path = description.path
    if path is not None:
        stops: list[Value] = [
            {"time": float(stop.time), **camera_map(stop.camera)} for stop in path.stops
        ]
        value["path"] = {"loop": path.loop, "stops": stops}
    if description.annotations:
        value["annotations"] = [_annotation_map(one) for one in description.annotations]
    reference = description.georeference
    if reference is not None:
        value["georeference"] = {
            "crs": reference.crs,
            "transform": [float(x) for x in np.asarray(reference.transform).reshape(-1)],
        }
    for name, picture in description.pictures().items():
        value[name] = _picture_map(picture)
    return value


def _annotation_map(annotation: Annotation) -> dict[str, Value]:
    """Return an annotation as a msgpack map."""
    value: dict[str, Value] = {
        "place": [float(x) for x in annotation.place],
        "title": annotation.title,
        "text": annotation.text,
    }
    if annotation.view is not None:
        value["view"] = camera_map(annotation.view)
    return value


def _picture_map(picture: Picture) -> dict[str, Value]:
    """Return type, size and rotation of a picture as a msgpack map."""
    value: dict[str, Value] = {
        "type": picture.media_type,
        "width": picture.width,
        "height": picture.height,
    }
    if picture.rotation is not None:
        value["rotation"] = [float(x) for x in np.asarray(picture.rotation).reshape(-1)]
    return value


def unpack_description(payload: bytes, where: str, allowed_bytes: int | None = None) -> Description:
    """Decode the segment of the description.

    Parameters
    ----------
    payload : bytes
        Bytes of the segment, whose CRC was checked.
    where : str
        Name of the segment in messages.
    allowed_bytes : int, optional
        Memory limit of the values, bytes; by default none.

    Raises
    ------
    FormatError
        ``msgpack-``…, or ``root-missing``, ``root-type``, ``root-value``.
    UnsupportedError
        ``root-must-understand``.
    LimitError
        ``decoded-size``: the values exceed `allowed_bytes`.
    """
    value = canonical_msgpack.unpack(
        payload, where, max_values=MAX_CAMERA_VALUES, allowed_bytes=allowed_bytes
    )
    return parse_description(value, where)


def parse_description(value: Value, where: str) -> Description:
    """Parse and check the msgpack map of a description; raises as `unpack_description`."""
    top = CheckedMap(value, where, "5.13")

    def optional(key: str, parse: Callable[[str], _T]) -> _T | None:
        return parse(key) if top.has(key) else None

    def part(key: str) -> CheckedMap:
        clause = "5.14" if key in PICTURES else "5.13"
        return CheckedMap(top.pop(key, dict), f"{where}, {key}", clause)

    texts = {
        key: _text(top, key, most) if top.has(key) else None for key, most in MAX_TEXT_BYTES.items()
    }
    found = Description(
        **texts,
        date=optional("date", lambda key: _date(top, key)),
        metres_per_unit=optional("metres_per_unit", top.positive),
        unit=optional("unit", lambda key: _unit(top, key)),
        background=optional("background", lambda key: _background(top, key)),
        views=_views(top, where) if top.has("views") else (),
        path=optional("path", lambda key: _path(part(key), f"{where}, {key}")),
        annotations=_annotations(top, where) if top.has("annotations") else (),
        georeference=optional("georeference", lambda key: _georeference(part(key))),
        poster=optional("poster", lambda key: _poster(part(key))),
        sky=optional("sky", lambda key: _sky(part(key))),
    )
    top.finish()
    return found


def _text(table: CheckedMap, key: str, most: int, *, least: int = 0) -> str:
    """Remove a key and return its text: at most `most` bytes, no control characters."""
    text = table.word(key)
    size = len(text.encode())
    if not least <= size <= most:
        raise table.error(key, f"{size} bytes, expected {least} to {most}")
    control = _CONTROLS.search(text)
    if control:
        raise table.error(
            key, f"the control character U+{ord(control[0]):04X}, expected text without any"
        )
    return text


def _date(table: CheckedMap, key: str) -> str:
    """Remove a key and return its date."""
    date = _text(table, key, MAX_DATE_BYTES)
    if not _DATE.fullmatch(date):
        raise table.error(key, f"{date!r}, expected a date such as '2026-05-31'")
    return date


def _unit(table: CheckedMap, key: str) -> str:
    """Remove a key and return its unit of length."""
    unit = table.word(key)
    if unit not in UNITS:
        raise table.error(key, f"{unit[:8]!r}, expected one of {', '.join(UNITS)}")
    return unit


def _background(table: CheckedMap, key: str) -> tuple[float, float, float]:
    """Remove a key and return its colour."""
    red, green, blue = table.numbers(key, 3)
    if not all(0 <= part <= 1 for part in (red, green, blue)):
        raise table.error(key, f"{red, green, blue}, expected numbers from 0 to 1")
    return red, green, blue


def _maps(table: CheckedMap, where: str, key: str, most: int, least: int = 0) -> list[CheckedMap]:
    """Remove a key and return the maps of its array."""
    values = table.array(key, most, least=least)
    return [
        CheckedMap(value, f"{where}, {key} {number}", "5.13") for number, value in enumerate(values)
    ]


def _views(table: CheckedMap, where: str) -> tuple[Camera, ...]:
    """Parse the named views."""
    maps = _maps(table, where, "views", MAX_VIEWS)
    return tuple(parse_camera(one, _text(one, "name", MAX_NAME_BYTES)) for one in maps)


def _path(table: CheckedMap, where: str) -> CameraPath:
    """Parse the camera path."""
    loop = table.pop("loop", bool)
    stops: list[PathStop] = []
    for number, stop in enumerate(_maps(table, where, "stops", MAX_STOPS, 2)):
        time = stop.number("time")
        if (time != 0) if not stops else (time <= stops[-1].time):
            after = f"above {stops[-1].time}" if stops else "0"
            raise stop.error("time", f"{time}, expected {after}")
        stops.append(PathStop(time, parse_camera(stop, f"stop {number}")))
    table.finish()
    return CameraPath(tuple(stops), loop)


def _annotations(table: CheckedMap, where: str) -> tuple[Annotation, ...]:
    """Parse the annotations."""
    found = []
    for number, one in enumerate(_maps(table, where, "annotations", MAX_ANNOTATIONS)):
        place = np.array(one.numbers("place", 3))
        title = _text(one, "title", MAX_NAME_BYTES)
        text = _text(one, "text", MAX_ANNOTATION_BYTES)
        view = None
        if one.has("view"):
            inside = CheckedMap(
                one.pop("view", dict), f"{where}, annotations {number}, view", "5.13"
            )
            view = parse_camera(inside, title)
        one.finish()
        found.append(Annotation(place, title, text, view))
    return tuple(found)


def _georeference(table: CheckedMap) -> Georeference:
    """Parse the reference to coordinates on Earth."""
    crs = _text(table, "crs", MAX_CRS_BYTES, least=1)
    numbers = table.numbers("transform", 16)
    (a, b, c, _), (d, e, f, _), (g, h, i, _) = (numbers[row : row + 4] for row in (0, 4, 8))
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    if numbers[12:] != [0, 0, 0, 1]:
        raise table.error("transform", f"the last row {numbers[12:]}, expected 0, 0, 0, 1")
    if not math.isfinite(determinant) or determinant == 0:
        raise table.error("transform", f"of determinant {determinant}, expected an invertible one")
    table.finish()
    return Georeference(crs, np.array(numbers).reshape(4, 4))


def _poster(table: CheckedMap) -> Picture:
    """Parse the entry of the poster."""
    picture = _picture(table)
    table.finish()
    return picture


def _sky(table: CheckedMap) -> Picture:
    """Parse the entry of the sky."""
    picture = _picture(table)
    if picture.width != 2 * picture.height:
        raise table.error(
            "width",
            f"{picture.width}, expected {2 * picture.height}: an equirectangular picture is twice "
            "as wide as high",
        )
    if table.has("rotation"):
        picture = replace(picture, rotation=_rotation(table))
    table.finish()
    return picture


def _rotation(table: CheckedMap) -> NDArray[np.float64]:
    """Parse the rotation of a sky, by the rule of a camera's rotation."""
    rotation = np.array(table.numbers("rotation", 9)).reshape(3, 3)
    try:
        return Camera(1, 1, 1.0, 1.0, 0.5, 0.5, rotation, np.zeros(3), "sky").rotation
    except DataError as error:
        raise table.error("rotation", str(error)) from error


def _picture(table: CheckedMap) -> Picture:
    """Parse type and size of a picture."""
    media_type = table.word("type")
    if media_type not in (JPEG, WEBP):
        raise table.error("type", f"{media_type[:40]!r}, expected {JPEG} or {WEBP}")
    width = table.integer("width", 1, MAX_PICTURE_SIDE)
    return Picture(media_type, width, table.integer("height", 1, MAX_PICTURE_SIDE))


def check_picture(picture: Picture, data: bytes, where: str) -> None:
    """Refuse a picture whose header contradicts the description.

    Parameters
    ----------
    picture : Picture
        Type and size in the description.
    data : bytes
        File of the picture.
    where : str
        Name of the picture in messages.

    Raises
    ------
    FormatError
        ``picture-header``.
    """
    found = picture_header(data, where)
    stated = (picture.media_type, picture.width, picture.height)
    if found != stated:
        raise FormatError(
            "picture-header",
            f"{where}: its header says {found}, expected {stated} as in the description",
            clause="5.14",
        )


def require_pictures(description: Description, rows: Mapping[str, int], where: str) -> None:
    """Refuse a file whose picture segments differ from the pictures of its description.

    Parameters
    ----------
    description : Description
        Description of the file.
    rows : mapping of str to int
        Rows of the picture segments, by name.
    where : str
        Name of the file in messages.

    Raises
    ------
    FormatError
        ``description-segments``.
    """
    stated = set(description.pictures())
    if stated != set(rows):
        raise FormatError(
            "description-segments",
            f"{where}: pictures {sorted(rows)}, expected {sorted(stated)} as in the description",
            clause="5.13",
        )
