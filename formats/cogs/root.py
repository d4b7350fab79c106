"""Root of a file: what it states of the scene, encoding and parsing (SPEC 4, 5)."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.capture import MAX_VIEWPOINTS, Capture
from cogsplat.codec.errors import DataError, UnsupportedError
from cogsplat.codec.segments.attributes import AttributeType
from cogsplat.codec.splats import (
    EXTRA_DTYPES,
    MAX_EXTRA_COMPONENTS,
    MAX_EXTRAS,
    MAX_SH_DEGREE,
    SceneInfo,
)
from cogsplat.codec.streams.payload_limits import MAX_CODEBOOK_ROWS
from cogsplat.codec.views.pose import down_direction

from . import layout
from .canonical_msgpack import Value
from .index_tables import (
    ChunkTable,
    IndexTables,
    PageTable,
    SegmentTable,
    column_bytes,
    parse_chunks,
    parse_pages,
    parse_segments,
)
from .msgpack_map import CheckedMap

F64 = NDArray[np.float64]

# Largest difference between the squared length of a direction and 1 (SPEC 4.2).
_UNIT_TOLERANCE: Final = 1e-3

# Maximum length of an unknown word in messages, characters.
_SHOWN: Final = 40

CODEBOOK_ATTRIBUTES: Final = ("shape", "colour")
COLOUR_SPACES: Final = ("srgb", "linear")


@dataclass(frozen=True)
class CodebookEntry:
    """Codebook: attribute of its rows (``shape`` or ``colour``) and their number (SPEC 5.5)."""

    attribute: str
    rows: int


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
    pages : PageTable
        Pages listed in the root.
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
    pages: PageTable = field(default_factory=lambda: PageTable.zeros(0))
    attributes: Sequence[AttributeType] = field(default=())
    levels: Sequence[Level] = field(default=())
    up: NDArray[np.float64] | None = None
    core_box: NDArray[np.float64] | None = None
    unknown: Mapping[str, Value] = field(default_factory=dict)

    @property
    def tables(self) -> IndexTables:
        """Tables of the root as of any index."""
        return IndexTables(self.segments, self.chunks, self.pages)

    @property
    def upward(self) -> NDArray[np.float64]:
        """Unit vector against gravity, (3,) float64: `up`, or the ``U`` of the axes."""
        return -down_direction(self.info.axes) + 0.0 if self.up is None else self.up


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
        "segments": root.segments.columns(),
        "chunks": root.chunks.columns(),
    }
    if root.first_view is not None:
        value["first_view"] = camera_map(root.first_view)
    if root.up is not None:
        value["up"] = [float(x) for x in root.up]
    if root.core_box is not None:
        value["core_box"] = [float(x) for x in root.core_box]
    if info.capture:
        value["capture"] = column_bytes(np.array(info.capture), "<f4")
    if root.attributes:
        value["attributes"] = [_attribute_value(kind) for kind in root.attributes]
    if root.levels:
        value["levels"] = [
            {"chunks": level.chunks, "scale": float(level.scale)} for level in root.levels
        ]
    if len(root.pages):
        value["pages"] = root.pages.columns()
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
    pages = parse_pages(root, where, layout.MAX_PAGES)
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
