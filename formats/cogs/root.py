"""Root and index pages of a file: their tables, encoding and parsing (SPEC 4, 5)."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.capture import MAX_VIEWPOINTS, Capture
from cogsplat.codec.errors import DataError, FormatError, UnsupportedError
from cogsplat.codec.metrics import PSNR_CAP_DB
from cogsplat.codec.segments.attributes import AttributeType
from cogsplat.codec.splats import (
    EXTRA_DTYPES,
    MAX_EXTRA_COMPONENTS,
    MAX_EXTRAS,
    MAX_SH_DEGREE,
    SceneInfo,
)
from cogsplat.codec.streams.payload_limits import MAX_CHUNK_SPLATS, MAX_CODEBOOK_ROWS
from cogsplat.codec.views.pose import down_direction

from . import layout
from .canonical_msgpack import Value
from .msgpack_map import CheckedMap

U32 = NDArray[np.uint32]
F64 = NDArray[np.float64]

HASH_BYTES: Final = 16
"""Bytes of a segment's SHA-256 that are stored (SPEC 5.3)."""

# Largest difference between the squared length of a direction and 1 (SPEC 4.2).
_UNIT_TOLERANCE: Final = 1e-3

# Maximum length of an unknown word in messages, characters.
_SHOWN: Final = 40

CODEBOOK_ATTRIBUTES: Final = ("shape", "colour")
COLOUR_SPACES: Final = ("srgb", "linear")


@dataclass(frozen=True, eq=False)
class SegmentTable:
    """Segments of an index in file order, one row each (SPEC 5.3).

    Parameters
    ----------
    kind : (s,) uint8
        `SegmentKind`, or an unknown kind from 128 on.
    owner : (s,) uint32
        Number of the chunk or codebook that the segment belongs to.
    length : (s,) uint32
        Length of the segment, bytes.
    crc : (s,) uint32
        CRC-32 of the segment.
    hash : (s, 16) uint8
        First 16 bytes of the segment's SHA-256.
    needs : (s,) uint32
        Bit mask of the codebooks needed to decode the segment.
    """

    kind: NDArray[np.uint8]
    owner: U32
    length: U32
    crc: U32
    hash: NDArray[np.uint8]
    needs: U32

    def __len__(self) -> int:
        return len(self.kind)


def no_segments() -> SegmentTable:
    """Return a segment table without rows."""
    none = np.zeros(0, np.uint32)
    kinds = np.zeros(0, np.uint8)
    return SegmentTable(kinds, none, none, none, np.zeros((0, HASH_BYTES), np.uint8), none)


@dataclass(frozen=True, eq=False)
class ChunkTable:
    """Chunks of an index in order, one row each (SPEC 5.4).

    Parameters
    ----------
    splats : (c,) uint32
        Number of splats.
    box : (c, 6) float32
        Bounding box of the splats with their extents: minimum corner, maximum corner; scene units.
    contribution : (c,) float64
        Sum of the splats' contributions; 0 in a scene without scores.
    layer, cell, object : (c,) uint32
        Layer, cell and object number; 0 in a scene without them.
    quality : (c,) float32
        Predicted PSNR of the prefix that ends with the chunk, dB; 0 for no prediction.
    until : (c,) uint32
        Prefixes of this number of chunks or more do not draw the chunk; 0 if all prefixes draw it
        (SPEC 5.10).
    """

    splats: U32
    box: NDArray[np.float32]
    contribution: NDArray[np.float64]
    layer: U32
    cell: U32
    object: U32
    quality: NDArray[np.float32]
    until: U32

    def __len__(self) -> int:
        return len(self.splats)


@dataclass(frozen=True)
class CodebookEntry:
    """Codebook: attribute of its rows (``shape`` or ``colour``) and their number (SPEC 5.5)."""

    attribute: str
    rows: int


@dataclass(frozen=True)
class PageEntry:
    """Root's entry of an index page (SPEC 5.6).

    Parameters
    ----------
    length : int
        Length of the page, bytes.
    crc : int
        CRC-32 of the page.
    segments, chunks : int
        Numbers of segments and chunks in the page.
    span : int
        Total length of the page's segments, which follow the page, bytes.
    """

    length: int
    crc: int
    segments: int
    chunks: int
    span: int


@dataclass(frozen=True)
class Level:
    """Level of detail of a scene (SPEC 5.11).

    Parameters
    ----------
    chunks : int
        Number of leading chunks of the file that the level consists of.
    scale : float
        Divisor of the full picture's width and height at which the level is shown.
    """

    chunks: int
    scale: float


@dataclass(frozen=True, eq=False)
class Root:
    """Root of a file (SPEC 4).

    Parameters
    ----------
    writer : str
        Name and version of the program that wrote the file.
    splats : int
        Number of splats.
    sh_degree : int
        SH degree, 0 to 3.
    info : SceneInfo
        Conventions of the scene: origin, axes, colour space, kernel, capture viewpoints.
    box : (6,) float64
        Bounding box of the splats with their extents: minimum corner, maximum corner; scene units.
    codebooks : sequence of CodebookEntry
        Codebooks of the file.
    first_view : Camera or None
        Camera where a viewer starts; its target is what an orbit turns around.
    segments : SegmentTable
        Segments listed in the root; pages list the others.
    chunks : ChunkTable
        Chunks listed in the root; pages list the others.
    pages : sequence of PageEntry
        Index pages.
    attributes : sequence of AttributeType
        Types of the splats' extra attributes.
    levels : sequence of Level
        Levels of detail, coarsest first; may be empty.
    up : (3,) float64 or None
        Unit vector against gravity in the frame of the means; None for the ``U`` of the axes.
    core_box : (6,) float64 or None
        Bounding box as `box`, without stray splats such as floaters and sky.
    unknown : mapping of str to Value
        Keys that readers skip (SPEC 4.3), which a changed description keeps.
    """

    writer: str
    splats: int
    sh_degree: int
    info: SceneInfo
    box: NDArray[np.float64]
    codebooks: Sequence[CodebookEntry]
    first_view: Camera | None
    segments: SegmentTable
    chunks: ChunkTable
    pages: Sequence[PageEntry] = field(default=())
    attributes: Sequence[AttributeType] = field(default=())
    levels: Sequence[Level] = field(default=())
    up: NDArray[np.float64] | None = None
    core_box: NDArray[np.float64] | None = None
    unknown: Mapping[str, Value] = field(default_factory=dict)

    @property
    def upward(self) -> NDArray[np.float64]:
        """Unit vector against gravity, (3,) float64: `up`, or the ``U`` of the axes."""
        return -down_direction(self.info.axes) + 0.0 if self.up is None else self.up


def _column(values: NDArray[np.generic], dtype: str) -> bytes:
    """Return a table column as little-endian bytes."""
    return np.ascontiguousarray(values).astype(dtype).tobytes()


def segment_columns(table: SegmentTable) -> dict[str, Value]:
    """Return a segment table as msgpack columns."""
    return {
        "kind": _column(table.kind, "u1"),
        "owner": _column(table.owner, "<u4"),
        "length": _column(table.length, "<u4"),
        "crc": _column(table.crc, "<u4"),
        "hash": _column(table.hash, "u1"),
        "needs": _column(table.needs, "<u4"),
    }


def chunk_columns(table: ChunkTable) -> dict[str, Value]:
    """Return a chunk table as msgpack columns; optional columns of zeros are left out."""
    value: dict[str, Value] = {
        "splats": _column(table.splats, "<u4"),
        "box": _column(table.box, "<f4"),
        "contribution": _column(table.contribution, "<f8"),
    }
    for name in ("layer", "cell", "object"):
        column = getattr(table, name)
        if column.any():
            value[name] = _column(column, "<u4")
    if table.quality.any():
        value["quality"] = _column(table.quality, "<f4")
    if table.until.any():
        value["until"] = _column(table.until, "<u4")
    return value


def root_map(root: Root) -> dict[str, Value]:
    """Return the root as a msgpack map (SPEC 4.2)."""
    info = root.info
    value: dict[str, Value] = {
        "writer": root.writer,
        "splats": root.splats,
        "sh_degree": root.sh_degree,
        "origin": [float(x) for x in info.origin],
        "axes": info.axes,
        "colour_space": info.colour_space,
        "kernel_px": float(info.kernel_px),
        "antialiased": info.antialiased,
        "box": [float(x) for x in root.box],
        "codebooks": [{"attribute": c.attribute, "rows": c.rows} for c in root.codebooks],
        "segments": segment_columns(root.segments),
        "chunks": chunk_columns(root.chunks),
    }
    if root.first_view is not None:
        value["first_view"] = camera_map(root.first_view)
    if root.up is not None:
        value["up"] = [float(x) for x in root.up]
    if root.core_box is not None:
        value["core_box"] = [float(x) for x in root.core_box]
    if info.capture:
        value["capture"] = _column(np.array(info.capture), "<f4")
    if root.attributes:
        value["attributes"] = [_attribute_value(kind) for kind in root.attributes]
    if root.levels:
        value["levels"] = [
            {"chunks": level.chunks, "scale": float(level.scale)} for level in root.levels
        ]
    if root.pages:
        value["pages"] = [
            {
                "length": page.length,
                "crc": page.crc,
                "segments": page.segments,
                "chunks": page.chunks,
                "span": page.span,
            }
            for page in root.pages
        ]
    return {**value, **root.unknown}


def _attribute_value(kind: AttributeType) -> dict[str, Value]:
    """Return the type of an extra attribute as a msgpack map (SPEC 5.7)."""
    value: dict[str, Value] = {"name": kind.name, "type": kind.dtype}
    if kind.components:
        value["components"] = kind.components
    return value


def camera_map(camera: Camera) -> dict[str, Value]:
    """Return a camera, and its target if it has one, as a msgpack map (SPEC 4.4)."""
    value: dict[str, Value] = {
        "width": camera.width,
        "height": camera.height,
        "fx": float(camera.fx),
        "fy": float(camera.fy),
        "cx": float(camera.cx),
        "cy": float(camera.cy),
        "rotation": [float(x) for x in camera.rotation.reshape(-1)],
        "translation": [float(x) for x in camera.translation],
    }
    if camera.target is not None:
        value["target"] = [float(x) for x in camera.target]
    return value


def parse_segments(value: Value, where: str) -> SegmentTable:
    """Parse and check a segment table.

    Parameters
    ----------
    value : Value
        Unpacked msgpack map.
    where : str
        Name of the root or page in messages.

    Raises
    ------
    FormatError
        ``root-missing``, ``root-type``, ``root-columns``, ``root-value``.
    UnsupportedError
        ``segment-kind-unknown``, ``root-must-understand``.
    """
    table = CheckedMap(value, f"{where}, segments", "5.3")
    kind = table.column("kind", "u1", None).astype(np.uint8)
    rows = len(kind)
    owner = table.column("owner", "<u4", rows)
    length = table.column("length", "<u4", rows)
    crc = table.column("crc", "<u4", rows)
    digest = table.column("hash", "u1", rows, HASH_BYTES)
    needs = table.column("needs", "<u4", rows)
    table.finish()
    known = [int(k) for k in layout.SegmentKind]
    unknown = np.flatnonzero((kind < layout.SKIPPABLE_KIND) & ~np.isin(kind, known))
    if len(unknown):
        raise UnsupportedError(
            "segment-kind-unknown",
            f"{where}, segment {unknown[0]}: kind {kind[unknown[0]]}, expected {known} or "
            f"{layout.SKIPPABLE_KIND} and above (SPEC 5.2)",
        )
    if rows and int(length.min()) == 0:
        raise table.error("length", "a segment of 0 bytes, expected at least 1")
    return SegmentTable(
        kind,
        owner.astype(np.uint32),
        length.astype(np.uint32),
        crc.astype(np.uint32),
        digest.astype(np.uint8).reshape(rows, HASH_BYTES),
        needs.astype(np.uint32),
    )


def parse_chunks(value: Value, where: str) -> ChunkTable:
    """Parse and check a chunk table; raises as `parse_segments`."""
    table = CheckedMap(value, f"{where}, chunks", "5.4")
    splats = table.column("splats", "<u4", None).astype(np.uint32)
    rows = len(splats)
    box = table.column("box", "<f4", rows, 6).astype(np.float32).reshape(rows, 6)
    contribution = table.column("contribution", "<f8", rows).astype(np.float64)
    optional = {
        name: (
            table.column(name, "<u4", rows).astype(np.uint32)
            if table.has(name)
            else np.zeros(rows, np.uint32)
        )
        for name in ("layer", "cell", "object")
    }
    quality = np.zeros(rows, np.float32)
    if table.has("quality"):
        quality = table.column("quality", "<f4", rows).astype(np.float32)
    until = np.zeros(rows, np.uint32)
    if table.has("until"):
        until = table.column("until", "<u4", rows).astype(np.uint32)
    table.finish()
    if rows and not 1 <= int(splats.min()) <= int(splats.max()) <= MAX_CHUNK_SPLATS:
        raise table.error(
            "splats",
            f"{int(splats.min())} to {int(splats.max())} in a chunk, "
            f"expected 1 to {MAX_CHUNK_SPLATS}",
        )
    if not (np.isfinite(box).all() and (box[:, :3] <= box[:, 3:]).all()):
        raise table.error("box", "corners not finite or not ordered, expected minimum, maximum")
    if not (np.isfinite(contribution).all() and (contribution >= 0).all()):
        raise table.error("contribution", "not finite or negative, expected 0 or more")
    if not ((quality >= 0) & (quality <= PSNR_CAP_DB)).all():
        raise table.error("quality", f"out of range, expected 0 to {PSNR_CAP_DB:g} dB")
    return ChunkTable(splats, box, contribution, **optional, quality=quality, until=until)


def parse_root(value: Value, where: str) -> Root:
    """Parse and check the root (SPEC 4.2); raises as `parse_segments`."""
    root = CheckedMap(value, where, "4.2")
    writer = root.text("writer")
    splats = root.integer("splats", 0, layout.MAX_SPLATS)
    sh_degree = root.integer("sh_degree", 0, MAX_SH_DEGREE)
    origin = root.numbers("origin", 3)
    info = SceneInfo(
        origin=(origin[0], origin[1], origin[2]),
        axes=_axes(root),
        colour_space=_colour_space(root),
        kernel_px=_kernel_px(root),
        antialiased=root.pop("antialiased", bool),
    )
    box = _box(root, "box")
    codebooks = [_codebook(v, where) for v in root.array("codebooks", layout.MAX_CODEBOOKS)]
    first_view = None
    if root.has("first_view"):
        first_view = parse_camera(
            CheckedMap(root.pop("first_view", dict), f"{where}, first_view", "4.4"), "first view"
        )
    up = _up(root) if root.has("up") else None
    core_box = _box(root, "core_box", within=box) if root.has("core_box") else None
    if root.has("capture"):
        info = replace(info, capture=_capture(root))
    attributes = _attributes(root, where)
    levels = _levels(root, where)
    entries = root.array("pages", layout.MAX_PAGES) if root.has("pages") else []
    pages = [_page(value, where) for value in entries]
    segments = parse_segments(root.pop("segments", dict), where)
    chunks = parse_chunks(root.pop("chunks", dict), where)
    return Root(
        writer=writer,
        splats=splats,
        sh_degree=sh_degree,
        info=info,
        box=box,
        codebooks=codebooks,
        first_view=first_view,
        segments=segments,
        chunks=chunks,
        pages=pages,
        attributes=attributes,
        levels=levels,
        up=up,
        core_box=core_box,
        unknown=root.finish(),
    )


def parse_page(value: Value, entry: PageEntry, where: str) -> tuple[SegmentTable, ChunkTable]:
    """Parse an index page and check it against the root's entry (SPEC 5.6)."""
    page = CheckedMap(value, where, "5.6")
    segments = parse_segments(page.pop("segments", dict), where)
    chunks = parse_chunks(page.pop("chunks", dict), where)
    page.finish()
    span = int(segments.length.sum(dtype=np.uint64))
    found = (len(segments), len(chunks), span)
    expected = (entry.segments, entry.chunks, entry.span)
    if found != expected:
        raise FormatError(
            "page-entry",
            f"{where}: segments, chunks and span {found}, expected {expected}",
            clause="5.6",
        )
    return segments, chunks


def _box(root: CheckedMap, name: str, *, within: F64 | None = None) -> F64:
    """Return a checked bounding box, which lies inside another if one is given."""
    box = np.array(root.numbers(name, 6))
    if not (box[:3] <= box[3:]).all():
        raise root.error(name, "corners not ordered, expected minimum, maximum")
    if within is not None and not ((within[:3] <= box[:3]).all() and (box[3:] <= within[3:]).all()):
        raise root.error(name, f"{box.tolist()}, expected corners inside {within.tolist()}")
    return box


def _up(root: CheckedMap) -> F64:
    """Return the checked direction against gravity, a unit vector."""
    up = root.numbers("up", 3)
    square = up[0] * up[0] + up[1] * up[1] + up[2] * up[2]
    if not abs(square - 1.0) <= _UNIT_TOLERANCE:
        raise root.error("up", f"{up}, of squared length {square:g}, expected a unit vector")
    return np.array(up)


def _capture(root: CheckedMap) -> Capture:
    """Return the checked capture viewpoints."""
    rows = root.column("capture", "<f4", None, 4).astype(np.float64)
    if not 1 <= len(rows) <= MAX_VIEWPOINTS:
        raise root.error("capture", f"{len(rows)} viewpoints, expected 1 to {MAX_VIEWPOINTS}")
    if not (np.isfinite(rows).all() and (rows[:, 3] > 0).all()):
        raise root.error(
            "capture",
            "NaN, infinite, or a focal length of 0 or less, expected finite positions "
            "and positive focal lengths",
        )
    return tuple((x, y, z, focal) for x, y, z, focal in rows.tolist())


def _axes(root: CheckedMap) -> str:
    """Return the checked axis letters, such as ``RDF``."""
    axes = root.text("axes")
    pairs = ["RL", "UD", "FB"]
    if len(axes) != 3 or {next((p for p in pairs if a in p), "") for a in axes} != set(pairs):
        raise root.error("axes", f"{axes!r}, expected one of R/L, U/D and F/B each, such as 'RDF'")
    return axes


def _kernel_px(root: CheckedMap) -> float:
    """Return the checked variance that a renderer adds to projected covariances, px²."""
    variance = root.number("kernel_px")
    if variance < 0:
        raise root.error("kernel_px", f"{variance}, expected 0 or more")
    return variance


def _colour_space(root: CheckedMap) -> str:
    """Return the checked name of the colour space."""
    name = root.word("colour_space")
    if name not in COLOUR_SPACES:
        raise UnsupportedError(
            "colour-space-unknown",
            root.error(
                "colour_space", f"{name[:_SHOWN]!r}, expected one of {COLOUR_SPACES}"
            ).message,
        )
    return name


def _codebook(value: Value, where: str) -> CodebookEntry:
    """Parse the entry of a codebook (SPEC 5.5)."""
    book = CheckedMap(value, f"{where}, codebooks", "5.5")
    attribute = book.word("attribute")
    if attribute not in CODEBOOK_ATTRIBUTES:
        raise UnsupportedError(
            "codebook-unknown",
            f"{where}: a codebook of {attribute[:_SHOWN]!r}, expected {CODEBOOK_ATTRIBUTES} "
            "(SPEC 5.5)",
        )
    rows = book.integer("rows", 1, MAX_CODEBOOK_ROWS)
    book.finish()
    return CodebookEntry(attribute, rows)


def _attributes(root: CheckedMap, where: str) -> list[AttributeType]:
    """Parse the types of the extra attributes (SPEC 5.7)."""
    if not root.has("attributes"):
        return []
    found: dict[str, AttributeType] = {}
    for value in root.array("attributes", MAX_EXTRAS):
        kind = _attribute(value, found, where)
        found[kind.name] = kind
    return list(found.values())


def _attribute(value: Value, before: Container[str], where: str) -> AttributeType:
    """Parse the type of one extra attribute, whose name must not be in `before` (SPEC 5.7)."""
    entry = CheckedMap(value, f"{where}, attributes", "5.7")
    name = entry.text("name")
    if not name:
        raise entry.error("name", "empty, expected a name")
    if name in before:
        raise entry.error("name", f"{name!r} twice, expected each name once")
    dtype = entry.word("type")
    if dtype not in EXTRA_DTYPES:
        raise UnsupportedError(
            "attribute-type-unknown",
            f"{where}: attribute {name!r} of type {dtype[:_SHOWN]!r}, expected one of "
            f"{', '.join(EXTRA_DTYPES)} (SPEC 5.7)",
        )
    components = 0
    if entry.has("components"):
        components = entry.integer("components", 1, MAX_EXTRA_COMPONENTS)
    entry.finish()
    return AttributeType(name, dtype, components)


def _levels(root: CheckedMap, where: str) -> list[Level]:
    """Parse the levels of detail (SPEC 5.11)."""
    if not root.has("levels"):
        return []
    found: list[Level] = []
    for value in root.array("levels", layout.MAX_LEVELS, least=1):
        entry = CheckedMap(value, f"{where}, levels", "5.11")
        before = found[-1] if found else Level(0, np.inf)
        chunks = entry.integer("chunks", before.chunks + 1, layout.MAX_SEGMENTS)
        scale = entry.positive("scale")
        if scale >= before.scale:
            raise entry.error("scale", f"{scale} after {before.scale}, expected less")
        entry.finish()
        found.append(Level(chunks, scale))
    return found


def _page(value: Value, where: str) -> PageEntry:
    """Parse the entry of an index page (SPEC 5.6)."""
    page = CheckedMap(value, f"{where}, pages", "5.6")
    entry = PageEntry(
        length=page.integer("length", 1, layout.MAX_PAGE_BYTES),
        crc=page.integer("crc", 0, (1 << 32) - 1),
        segments=page.integer("segments", 1, layout.MAX_SEGMENTS),
        chunks=page.integer("chunks", 0, layout.MAX_SEGMENTS),
        span=page.integer("span", 1, layout.MAX_FILE_BYTES),
    )
    page.finish()
    return entry


def parse_camera(view: CheckedMap, name: str) -> Camera:
    """Parse a camera, and its target if it has one (SPEC 4.4).

    Parameters
    ----------
    view : CheckedMap
        Map with the keys of a camera. Keys of its own the caller has read before, such as ``name``;
        any further key is unknown.
    name : str
        Name of the camera that is returned.

    Raises
    ------
    FormatError
        ``root-missing``, ``root-type``, ``root-value``.
    UnsupportedError
        ``root-must-understand``.
    """
    width = view.integer("width", 1, 65535)
    height = view.integer("height", 1, 65535)
    fx, fy = view.positive("fx"), view.positive("fy")
    cx, cy = view.number("cx"), view.number("cy")
    rotation = np.array(view.numbers("rotation", 9)).reshape(3, 3)
    try:
        camera = Camera(width, height, fx, fy, cx, cy, rotation, np.zeros(3), name)
    except DataError as error:
        raise view.error("rotation", str(error)) from error
    camera = replace(camera, translation=np.array(view.numbers("translation", 3)))
    if view.has("target"):
        target = np.array(view.numbers("target", 3))
        try:
            camera = replace(camera, target=target)
        except DataError as error:
            raise view.error("target", str(error)) from error
    view.finish()
    return camera
