"""Conformance vectors of descriptions and pictures (SPEC 5.13, 5.14)."""

from __future__ import annotations

import base64
import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from cogsplat.formats.cogs.canonical_msgpack import Value, pack
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment

from .file_builder import Draft, Group, build
from .invalid import Invalid, paged_chunks, uniform_chunk, with_segments
from .valid import Valid

# Pictures of 4x2 px: a grey baseline JPEG, a grey progressive one, a lossy WebP, a lossless one,
# and a lossy one with alpha, in the extended format.
_JPEG: Final = base64.b64decode(
    "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDABALDA4MChAODQ4SERATGCgaGBYWGDEjJR0oOjM9PDkzODdASFxOQERXRTc4UG1R"
    "V19iZ2hnPk1xeXBkeFxlZ2P/wAALCAACAAQBAREA/8QAFAABAAAAAAAAAAAAAAAAAAAAAP/EABQQAQAAAAAAAAAAAAAAAAAA"
    "AAD/2gAIAQEAAD8AP//Z"
)
_PROGRESSIVE: Final = base64.b64decode(
    "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDABALDA4MChAODQ4SERATGCgaGBYWGDEjJR0oOjM9PDkzODdASFxOQERXRTc4UG1R"
    "V19iZ2hnPk1xeXBkeFxlZ2P/wgALCAACAAQBAREA/8QAFAABAAAAAAAAAAAAAAAAAAAAAP/aAAgBAQAAAAF//8QAFBABAAAA"
    "AAAAAAAAAAAAAAAAAP/aAAgBAQABBQJ//8QAFBABAAAAAAAAAAAAAAAAAAAAAP/aAAgBAQAGPwJ//8QAFBABAAAAAAAAAAAA"
    "AAAAAAAAAP/aAAgBAQABPyF//9oACAEBAAAAEH//xAAUEAEAAAAAAAAAAAAAAAAAAAAA/9oACAEBAAE/EH//2Q=="
)
_LOSSY: Final = base64.b64decode(
    "UklGRjAAAABXRUJQVlA4ICQAAABwAQCdASoEAAIAB0CWJaACdAFAAAD8yuuLmyMNepWEN2TIAAA="
)
_LOSSLESS: Final = base64.b64decode("UklGRh4AAABXRUJQVlA4TBEAAAAvA0AAAAdQsiJXpv+BiOh/AAA=")
_ALPHA: Final = base64.b64decode(
    "UklGRlQAAABXRUJQVlA4WAoAAAAQAAAAAwAAAQAAQUxQSAkAAAAAgICAgICAgIAAVlA4ICQAAABwAQCdASoEAAIAB0CW"
    "JaACdAFAAAD8yuuLmyMNepWEN2TIAAA="
)

Map = dict[str, Value]

_VIEW: Final[Map] = {
    "width": 640,
    "height": 480,
    "fx": 500.5,
    "fy": 501.25,
    "cx": 320.0,
    "cy": -7.5,
    "rotation": [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
    "translation": [0.1, -0.2, 3e5],
}
_TARGET: Final[Map] = {**_VIEW, "target": [0.0, 1.0, -2.5]}
_STOPS: Final[list[Value]] = [{"time": 0.0, **_VIEW}, {"time": 2.5, **_TARGET}]
_PATH: Final[Map] = {"loop": True, "stops": _STOPS}
_ANNOTATION: Final[Map] = {"place": [1.0, -2.0, 0.5], "title": "Door", "text": "Built 1904."}
_GEOREFERENCE: Final[Map] = {
    "crs": "EPSG:4978",
    "transform": [0.0, -2.0, 0.0, 4e6, 2.0, 0.0, 0.0, 1e5, 0.0, 0.0, 2.0, -5e6, 0.0, 0.0, 0.0, 1.0],
}
_MARKUP: Final = (
    '<img src=x onerror="alert(1)"></script><a href="javascript:alert(2)">Garden</a> & co'
)


def _picture(media_type: str, width: int = 4, height: int = 2, **others: Value) -> Map:
    """Return the entry of a picture in a description."""
    return {"type": media_type, "width": width, "height": height, **others}


def _all_keys() -> Map:
    """Return a description with every key, without pictures."""
    return {
        "title": "Jardín — 庭 🌳",
        "text": "Two lines,\n\tthe second indented.",
        "licence": "CC-BY-4.0",
        "credits": "The maintainers",
        "date": "2026-05-31T10:20:30.5+02:00",
        "metres_per_unit": 0.25,
        "unit": "ft",
        "background": [0.0, 0.5, 1.0],
        "views": [{"name": "Front", **_VIEW}, {"name": "", **_TARGET}],
        "path": _PATH,
        "annotations": [_ANNOTATION, {**_ANNOTATION, "view": _TARGET}],
        "georeference": _GEOREFERENCE,
    }


def _description(value: Map) -> Segment:
    """Return the segment of a description."""
    return Segment(SegmentKind.DESCRIPTION, 0, pack(value))


def _file(value: Map, *pictures: bytes) -> bytes:
    """Return the file of one chunk with a description, a poster and a sky, as far as given."""
    segments = [Segment(SegmentKind.PICTURE, i, data) for i, data in enumerate(pictures)]
    return _with(_description(value), *segments)


def _with(*segments: Segment) -> bytes:
    """Return the file of one chunk with segments behind its head."""
    draft = uniform_chunk()
    return build(with_segments(draft, [*draft.groups[0].segments, *segments]))


def _paged(root: Sequence[Segment], last: Sequence[Segment]) -> bytes:
    """Return the file of two chunks, the second in a page, with segments at the end of each."""
    draft = paged_chunks()
    first, second = draft.groups
    return build(
        replace(
            draft,
            groups=[
                Group([*first.segments, *root], first.chunks),
                Group([*second.segments, *last], second.chunks),
            ],
        )
    )


def valid() -> list[Valid]:
    """Return the valid vectors of descriptions and pictures."""
    poster: Map = {"poster": _picture("image/jpeg")}
    sky: Map = {"sky": _picture("image/webp")}
    upright: list[Value] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    turned: Map = {"sky": _picture("image/webp", rotation=upright)}
    dates = ["2026", "2026-05", "2026-05-31", "2026-05-31T10:20Z", "2026-05-31T10:20:30-11:30"]
    both: Map = {**poster, **sky}
    pictures = [Segment(SegmentKind.PICTURE, i, data) for i, data in enumerate((_JPEG, _LOSSY))]
    empty = Draft(uniform_chunk().root | {"splats": 0}, [Group([_description({})], [])])
    return [
        Valid("description", _file(_all_keys()), ("5.13",), "every key but pictures"),
        Valid("description-empty", build(empty), ("5.13",),
              "a description of no keys, in a file of no splats"),
        Valid("description-markup", _file({"title": _MARKUP, "text": _MARKUP}), ("5.13",),
              "markup in texts, to be shown as the characters that it is"),
        Valid("description-later", _file({"title": "Garden", "mood": {"later": 1}}),
              ("4.3", "5.13"), "a key of a later version"),
        *(
            Valid(f"description-date-{i}", _file({"date": date}), ("5.13",), f"the date {date}")
            for i, date in enumerate(dates)
        ),
        Valid("description-ends", _file(_ends()), ("5.13",), "256 views and 1,024 stops"),
        Valid("pictures", _file(both, _JPEG, _LOSSY), ("5.13", "5.14"), "a poster and a sky"),
        Valid("pictures-progressive", _file({**poster, **turned}, _PROGRESSIVE, _LOSSLESS),
              ("5.14",), "a progressive JPEG; a lossless WebP as a sky that is turned"),
        Valid("pictures-alpha", _with(_description(sky), replace(pictures[1], payload=_ALPHA)),
              ("5.14",), "a sky alone, a WebP of the extended format"),
        Valid("pictures-pages", _paged([_description(both)], pictures), ("5.6", "5.13", "5.14"),
              "a description in the root, its pictures in the last page"),
    ]  # fmt: skip


def _ends() -> Map:
    """Return a description of as many views and stops as there may be."""
    views: list[Value] = [{"name": f"{i}", **_VIEW} for i in range(256)]
    stops: list[Value] = [{"time": i / 8, **_VIEW} for i in range(1024)]
    return {"views": views, "path": {"loop": False, "stops": stops}}


def invalid() -> list[Invalid]:
    """Return the must-reject vectors of descriptions and pictures."""
    return [*_invalid_segments(), *_invalid_texts(), *_invalid_parts(), *_invalid_pictures()]


def _body(name: str, value: Map, code: str, note: str, clause: str = "5.13") -> Invalid:
    """Return a file with a description that a verifier must refuse."""
    return Invalid(name, _file(value), code, clause, note, "verify")


def _invalid_segments() -> list[Invalid]:
    """Return the vectors of misplaced descriptions and pictures."""
    one, poster = _description({"title": "Garden"}), Segment(SegmentKind.PICTURE, 0, _JPEG)
    described = _description({"poster": _picture("image/jpeg")})
    long = _description({"text": "x" * (1 << 20)})

    def order(name: str, data: bytes, note: str) -> Invalid:
        return Invalid(name, data, "description-segments", "5.13", note)

    return [
        order("description-twice", _with(one, one), "two descriptions"),
        order("description-owner", _with(replace(one, owner=1)), "a description of owner 1"),
        order("description-page", _paged([], [one]), "a description that a page lists"),
        order("description-long", _with(long), "a description of more than 1 MiB of text"),
        order("picture-owner", _with(described, replace(poster, owner=2)), "a picture of owner 2"),
        order("picture-twice", _with(described, poster, poster), "two posters"),
        order("picture-alone", _with(poster), "a poster without a description"),
        order("picture-root", _paged([described, poster], []),
              "a poster that the root lists, in a file with a page"),
        replace(order("picture-unstated", _with(one, poster),
                      "a poster that the description does not have"), stage="verify"),
        replace(order("picture-missing", _with(described),
                      "a description of a poster that is not there"), stage="verify"),
    ]  # fmt: skip


def _invalid_texts() -> list[Invalid]:
    """Return the vectors of texts, dates and numbers out of range."""

    def value(name: str, note: str, **keys: Value) -> Invalid:
        return _body(name, keys, "root-value", note)

    good = pack({"title": "Garden"})
    cut = Segment(SegmentKind.DESCRIPTION, 0, good[:-1])
    return [
        Invalid("description-cut", _with(cut), "msgpack-truncated", "4.1", "the last byte missing",
                "verify"),
        _body("description-must-understand", {"title": "Garden", "veil!": 1},
              "root-must-understand", "a key with !", "4.3"),
        _body("description-title-bin", {"title": b"Garden"}, "root-type", "a title of bytes"),
        value("description-title-256", "a title of 256 bytes", title="é" * 128),
        value("description-text-16385", "a text of 16,385 bytes", text="x" * 16_385),
        value("description-nul", "U+0000 in a title", title="Gar\0den"),
        value("description-escape", "U+001B, as terminals take orders from it", text="\x1b]0;x\7"),
        value("description-return", "U+000D in a text", text="one\r\ntwo"),
        value("description-delete", "U+007F in the credits", credits="\x7f"),
        value("description-c1", "U+0085 in a licence", licence="CC\x85BY"),
        value("description-date-month", "a month 13", date="2026-13"),
        value("description-date-words", "a date in words", date="31 May 2026"),
        value("description-date-digits", "digits that are not those of ASCII", date="２０２６"),
        value("description-scale-0", "a unit of no length", metres_per_unit=0.0),
        value("description-scale-nan", "a unit of NaN", metres_per_unit=float("nan")),
        _body("description-scale-integer", {"metres_per_unit": 1}, "root-type", "an integer"),
        value("description-unit", "an unknown unit", unit="yd"),
        value("description-background-two", "a colour of two numbers", background=[0.0, 1.0]),
        value("description-background-2", "a colour beyond 1", background=[0.0, 1.0, 1.5]),
        value("description-background-nan", "a colour of NaN",
              background=[0.0, 1.0, float("nan")]),
    ]  # fmt: skip


def _invalid_parts() -> list[Invalid]:
    """Return the vectors of wrong views, paths, annotations and georeferences."""

    def views(name: str, code: str, note: str, clause: str = "5.13", **keys: Value) -> Invalid:
        return _body(name, {"views": [{"name": "Front", **_VIEW, **keys}]}, code, note, clause)

    def stops(name: str, note: str, *times: float) -> Invalid:
        made: list[Value] = [{"time": time, **_VIEW} for time in times]
        return _body(name, {"path": {"loop": False, "stops": made}}, "root-value", note)

    def annotation(name: str, code: str, note: str, **keys: Value) -> Invalid:
        return _body(name, {"annotations": [{**_ANNOTATION, **keys}]}, code, note)

    def georeference(name: str, note: str, **keys: Value) -> Invalid:
        return _body(name, {"georeference": {**_GEOREFERENCE, **keys}}, "root-value", note)

    nameless: Map = {"views": [dict(_VIEW)]}
    many: list[Value] = [{"name": "", **_VIEW}] * 257
    flat: list[Value] = [
        1.0,
        0.0,
        0.0,
        0.0,
        0.0,
        1.0,
        0.0,
        0.0,
        1.0,
        1.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        1.0,
    ]
    huge: list[Value] = [
        1e200,
        0.0,
        0.0,
        0.0,
        0.0,
        1e200,
        0.0,
        0.0,
        0.0,
        0.0,
        1.0,
        0.0,
        0.0,
        0.0,
        0.0,
        1.0,
    ]
    perspective: list[Value] = [*flat[:10], 2.0, 0.0, 0.0, 0.0, 0.5, 1.0]
    return [
        _body("description-views-257", {"views": many}, "root-value", "257 views"),
        _body("description-view-nameless", nameless, "root-missing", "a view without a name"),
        views("description-view-nan", "root-value", "NaN in a view",
              translation=[float("nan"), 0.0, 0.0]),
        views("description-view-mirrored", "root-value", "a mirrored view",
              rotation=[-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        views("description-view-target", "root-value", "a target behind the camera",
              target=[0.0, 0.0, -4e5]),
        views("description-view-key", "root-must-understand", "a key with ! in a view", "4.3",
              **{"lens!": 1}),
        _body("description-path-loop", {"path": {"stops": _STOPS}}, "root-missing", "no loop"),
        stops("description-path-one", "one stop", 0.0),
        stops("description-path-late", "a first stop that is not at 0", 1.0, 2.0),
        stops("description-path-back", "times that go back", 0.0, 2.0, 1.0),
        stops("description-path-same", "two stops at one time", 0.0, 1.0, 1.0),
        stops("description-path-nan", "a time of NaN", 0.0, float("nan")),
        stops("description-path-infinite", "a time without end", 0.0, float("inf")),
        stops("description-path-1025", "1,025 stops", *(i / 8 for i in range(1025))),
        annotation("description-place-two", "root-value", "a place of two numbers",
                   place=[1.0, 2.0]),
        annotation("description-place-infinite", "root-value", "a place far away",
                   place=[1.0, 2.0, float("inf")]),
        annotation("description-annotation-4097", "root-value", "a text of 4,097 bytes",
                   text="x" * 4097),
        annotation("description-annotation-view", "root-type", "a view that is no map", view=1),
        _body("description-annotations-map", {"annotations": {}}, "root-type",
              "annotations in a map"),
        georeference("description-crs-empty", "no reference system", crs=""),
        georeference("description-transform-flat", "a matrix that flattens", transform=flat),
        georeference("description-transform-huge", "a determinant beyond binary64",
                     transform=huge),
        georeference("description-transform-row", "a last row that divides",
                     transform=perspective),
        georeference("description-transform-twelve", "twelve numbers", transform=flat[:12]),
    ]  # fmt: skip


def _bomb(side: int) -> bytes:
    """Return the JPEG with another width and height in its header."""
    at = _JPEG.index(b"\xff\xc0") + 5
    return _JPEG[:at] + struct.pack(">HH", side, side) + _JPEG[at + 4 :]


def _webp(*chunks: tuple[bytes, bytes]) -> bytes:
    """Return a WebP of chunks, which need not make sense."""
    body = b"".join(
        kind + struct.pack("<I", len(data)) + data + bytes(len(data) % 2) for kind, data in chunks
    )
    return b"RIFF" + struct.pack("<I", 4 + len(body)) + b"WEBP" + body


def _invalid_pictures() -> list[Invalid]:
    """Return the vectors of pictures whose entry or header is wrong."""
    jpeg, webp = _picture("image/jpeg"), _picture("image/webp")

    def entry(name: str, code: str, note: str, **value: Value) -> Invalid:
        return _body(name, value, code, note, "5.14")

    def header(name: str, stated: Map, data: bytes, note: str) -> Invalid:
        return Invalid(
            name, _file({"poster": stated}, data), "picture-header", "5.14", note, "verify"
        )

    at = _JPEG.index(b"\xff\xc0")
    lossy, lossless = _LOSSY[20:], _LOSSLESS[20:]
    canvas = struct.pack("<I", 0) + bytes([255, 63, 0, 255, 63, 0])
    moving = struct.pack("<I", 2) + bytes([3, 0, 0, 1, 0, 0])
    padding = [(b"JUNK", b"")] * 16
    png = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBB", 13, b"IHDR", 4, 2, 8, 2, 0, 0, 0)
    return [
        entry("picture-png", "root-value", "a PNG", poster=_picture("image/png")),
        entry("picture-svg", "root-value", "an SVG, which may hold scripts",
              poster=_picture("image/svg+xml")),
        entry("picture-width-0", "root-value", "no width", poster=_picture("image/jpeg", 0)),
        entry("picture-60000", "root-value", "60,000 px",
              poster=_picture("image/jpeg", 60_000, 60_000)),
        entry("picture-no-type", "root-missing", "no type", poster={"width": 4, "height": 2}),
        entry("sky-square", "root-value", "a sky as high as wide",
              sky=_picture("image/webp", 4, 4)),
        entry("sky-mirrored", "root-value", "a mirrored sky",
              sky=_picture("image/webp",
                           rotation=[-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])),
        header("picture-bomb", jpeg, _bomb(60_000), "a header of 60,000 px"),
        header("picture-webp-bomb", webp,
               _webp((b"VP8L", b"\x2f" + struct.pack("<I", 0x0FFFFFFF) + lossless[5:])),
               "a header of 16,384 px"),
        header("picture-canvas", webp, _webp((b"VP8X", canvas), (b"VP8 ", lossy)),
               "a canvas of 16,384 px around 4"),
        header("picture-type", webp, _JPEG, "a JPEG that is stated as a WebP"),
        header("picture-other", jpeg, png, "a PNG that is stated as a JPEG"),
        header("picture-text", jpeg, b"<svg onload=alert(1)>", "markup"),
        header("picture-short", jpeg, b"\xff", "one byte"),
        header("picture-cut", jpeg, _JPEG[:-1], "a JPEG without its last byte"),
        header("picture-cut-header", jpeg, _JPEG[: at + 6] + b"\xff\xd9",
               "a JPEG that ends inside its frame header"),
        header("picture-markers", jpeg, _JPEG[:2] + b"\xff\xe0\0\1" + _JPEG[2:],
               "a marker segment of one byte"),
        header("picture-lossless-jpeg", jpeg, _JPEG[: at + 1] + b"\xc3" + _JPEG[at + 2 :],
               "a frame that browsers do not decode"),
        header("picture-12-bit", jpeg, _JPEG[: at + 4] + b"\x0c" + _JPEG[at + 5 :],
               "twelve bits a sample"),
        header("picture-webp-cut", webp, _LOSSY[:-2], "a WebP without its last bytes"),
        header("picture-webp-long", webp, _LOSSY + b"PK\3\4", "bytes behind a WebP"),
        header("picture-webp-chunk", webp, _webp((b"VP8 ", lossy))[:16]
               + struct.pack("<I", 1 << 31) + lossy, "a chunk longer than the picture"),
        header("picture-webp-moving", webp, _webp((b"VP8X", moving), (b"VP8 ", lossy)),
               "an animation"),
        header("picture-webp-frames", webp, _webp((b"ANMF", b""), (b"VP8 ", lossy)),
               "a frame of an animation"),
        header("picture-webp-chunks", webp, _webp(*padding, (b"VP8 ", lossy)),
               "16 chunks before the picture"),
        header("picture-webp-start", webp, _webp((b"VP8 ", lossy[:3] + b"\0\0\0" + lossy[6:])),
               "no start of a frame"),
    ]  # fmt: skip
