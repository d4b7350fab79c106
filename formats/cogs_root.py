"""The root and the index pages: what a reader must know before any chunk (SPEC 4, 5)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.chunking import MAX_CHUNK_SPLATS
from cogsplat.codec.errors import DataError, FormatError, UnsupportedError
from cogsplat.codec.metrics import PSNR_CAP_DB
from cogsplat.codec.splats import MAX_SH_DEGREE, SceneInfo
from cogsplat.codec.streams import MAX_CODEBOOK_ROWS

from . import cogs_layout as layout
from .strict_msgpack import Value

U32 = NDArray[np.uint32]

HASH_BYTES: Final = 16
"""First bytes of a segment's SHA-256 (SPEC 5.3)."""

CODEBOOK_ATTRIBUTES: Final = ("shape", "colour")
COLOUR_SPACES: Final = ("srgb", "linear")

_MAX_TEXT: Final = 255
_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class SegmentTable:
    """Rows in file order (SPEC 5.3).

    Parameters
    ----------
    kind : (s,) uint8
        `SegmentKind`, or 128 and above.
    owner : (s,) uint32
        Chunk or codebook the segment belongs to.
    length : (s,) uint32
        Bytes in the file.
    crc : (s,) uint32
        CRC-32 of those bytes.
    hash : (s, 16) uint8
        First 16 bytes of their SHA-256.
    needs : (s,) uint32
        Bit i: codebook i is needed to decode the segment.
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
    """Rows in chunk order (SPEC 5.4).

    Parameters
    ----------
    splats : (c,) uint32
        Rows of each chunk.
    box : (c, 6) float32
        Minimum then maximum corner of what its splats reach, scene units.
    contribution : (c,) float64
        Sum of its splats' contributions; zeros where the scene was not scored.
    layer, cell, object : (c,) uint32
        Zeros where the scene has none.
    quality : (c,) float32
        Predicted PSNR, dB, of a scene that ends with the chunk; 0 where nothing was predicted.
    """

    splats: U32
    box: NDArray[np.float32]
    contribution: NDArray[np.float64]
    layer: U32
    cell: U32
    object: U32
    quality: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.splats)


@dataclass(frozen=True)
class CodebookEntry:
    """One codebook: what its rows are and how many (SPEC 5.5)."""

    attribute: str
    rows: int


@dataclass(frozen=True)
class PageEntry:
    """One index page (SPEC 5.6).

    Parameters
    ----------
    length, crc : int
        Of the page's bytes.
    segments, chunks : int
        Rows in the page.
    span : int
        Bytes of the page's segments, which stand right behind it.
    """

    length: int
    crc: int
    segments: int
    chunks: int
    span: int


@dataclass(frozen=True, eq=False)
class Root:
    """Everything the root states.

    Parameters
    ----------
    writer : str
        Name and version of what wrote the file.
    splats : int
    sh_degree : int
    info : SceneInfo
    box : (6,) float64
        Minimum then maximum corner of what the scene's splats reach, scene units.
    codebooks : sequence of CodebookEntry
    first_view : Camera or None
    segments : SegmentTable
        Of the root alone; pages add theirs.
    chunks : ChunkTable
        Likewise.
    pages : sequence of PageEntry
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


def _column(values: NDArray[np.generic], dtype: str) -> bytes:
    return np.ascontiguousarray(values).astype(dtype).tobytes()


def segments_value(table: SegmentTable) -> dict[str, Value]:
    """Return a segment table as msgpack columns."""
    return {
        "kind": _column(table.kind, "u1"),
        "owner": _column(table.owner, "<u4"),
        "length": _column(table.length, "<u4"),
        "crc": _column(table.crc, "<u4"),
        "hash": _column(table.hash, "u1"),
        "needs": _column(table.needs, "<u4"),
    }


def chunks_value(table: ChunkTable) -> dict[str, Value]:
    """Return a chunk table as msgpack columns; columns of zeros are left out."""
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
    return value


def root_value(root: Root) -> dict[str, Value]:
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
        "segments": segments_value(root.segments),
        "chunks": chunks_value(root.chunks),
    }
    if root.first_view is not None:
        value["first_view"] = _camera_value(root.first_view)
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
    return value


def _camera_value(camera: Camera) -> dict[str, Value]:
    return {
        "width": camera.width,
        "height": camera.height,
        "fx": float(camera.fx),
        "fy": float(camera.fy),
        "cx": float(camera.cx),
        "cy": float(camera.cy),
        "rotation": [float(x) for x in camera.rotation.reshape(-1)],
        "translation": [float(x) for x in camera.translation],
    }


class _Map:
    """A map whose keys are taken one by one, each with its type."""

    def __init__(self, value: Value, where: str, clause: str) -> None:
        if not isinstance(value, dict):
            raise FormatError(
                "root-type", f"{where}: {type(value).__name__}, expected a map", clause=clause
            )
        self._value = dict(value)
        self._where = where
        self._clause = clause

    def error(self, key: str, message: str, code: str = "root-value") -> FormatError:
        return FormatError(code, f"{self._where}, {key}: {message}", clause=self._clause)

    def has(self, key: str) -> bool:
        return key in self._value

    def take(self, key: str, kind: type[_T]) -> _T:
        if key not in self._value:
            raise FormatError(
                "root-missing", f"{self._where}: no key {key!r}, expected one", clause=self._clause
            )
        value = self._value.pop(key)
        # bool is an int in Python, and never one here.
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise self.error(key, f"{type(value).__name__}, expected {kind.__name__}", "root-type")
        return value

    def integer(self, key: str, low: int, high: int) -> int:
        value = self.take(key, int)
        if not low <= value <= high:
            raise self.error(key, f"{value}, expected {low} to {high}")
        return value

    def text(self, key: str) -> str:
        value = self.take(key, str)
        if len(value.encode()) > _MAX_TEXT:
            raise self.error(key, f"{len(value)} characters, expected at most {_MAX_TEXT} bytes")
        return value

    def number(self, key: str) -> float:
        value = self.take(key, float)
        if not math.isfinite(value):
            raise self.error(key, f"{value}, expected a finite number")
        return value

    def numbers(self, key: str, count: int) -> list[float]:
        values = self.take(key, list)
        if len(values) != count or not all(
            isinstance(v, float) and math.isfinite(v) for v in values
        ):
            raise self.error(key, f"expected {count} finite float64 numbers")
        return [float(v) for v in values if isinstance(v, float)]

    def column(self, key: str, dtype: str, rows: int | None, width: int = 1) -> NDArray[np.generic]:
        data = self.take(key, bytes)
        item = np.dtype(dtype).itemsize * width
        if len(data) % item or (rows is not None and len(data) != rows * item):
            expected = f"{rows} rows" if rows is not None else "whole rows"
            raise self.error(
                key, f"{len(data)} bytes, expected {expected} of {item}", "root-columns"
            )
        flat = np.frombuffer(data, dtype)
        return flat.reshape(-1, width) if width > 1 else flat

    def finish(self) -> None:
        """Refuse what must be understood and is not: unknown keys that end in ``!`` (SPEC 4.3)."""
        for key in self._value:
            if key.endswith("!"):
                raise UnsupportedError(
                    "root-must-understand",
                    f"{self._where}: the key {key!r} must be understood (SPEC 4.3)",
                )


def parse_segments(value: Value, where: str) -> SegmentTable:
    """Read a segment table.

    Raises
    ------
    FormatError
        ``root-missing``, ``root-type``, ``root-columns``, ``root-value``.
    UnsupportedError
        ``segment-kind-unknown``, ``root-must-understand``.
    """
    table = _Map(value, f"{where}, segments", "5.3")
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
    """Read a chunk table; raises as `parse_segments` does."""
    table = _Map(value, f"{where}, chunks", "5.4")
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
    table.finish()
    if rows and not 1 <= int(splats.min()) <= int(splats.max()) <= MAX_CHUNK_SPLATS:
        raise table.error(
            "splats",
            f"{int(splats.min())} to {int(splats.max())} in a chunk, "
            f"expected 1 to {MAX_CHUNK_SPLATS}",
        )
    if not (np.isfinite(box).all() and (box[:, :3] <= box[:, 3:]).all()):
        raise table.error("box", "corners not finite or in the wrong order")
    if not (np.isfinite(contribution).all() and (contribution >= 0).all()):
        raise table.error("contribution", "not finite or negative")
    if not ((quality >= 0) & (quality <= PSNR_CAP_DB)).all():
        raise table.error("quality", f"expected 0 to {PSNR_CAP_DB:g} dB")
    return ChunkTable(splats, box, contribution, **optional, quality=quality)


def parse_root(value: Value, where: str) -> Root:
    """Read the root map (SPEC 4.2); raises as `parse_segments` does."""
    root = _Map(value, where, "4.2")
    writer = root.text("writer")
    splats = root.integer("splats", 0, layout.MAX_SPLATS)
    sh_degree = root.integer("sh_degree", 0, MAX_SH_DEGREE)
    origin = root.numbers("origin", 3)
    info = SceneInfo(
        origin=(origin[0], origin[1], origin[2]),
        axes=_axes(root),
        colour_space=_colour_space(root),
        kernel_px=root.number("kernel_px"),
        antialiased=root.take("antialiased", bool),
    )
    if info.kernel_px < 0:
        raise root.error("kernel_px", f"{info.kernel_px}, expected 0 or more")
    box = np.array(root.numbers("box", 6))
    if not (box[:3] <= box[3:]).all():
        raise root.error("box", "corners in the wrong order")
    codebooks = [_codebook(v, where) for v in root.take("codebooks", list)]
    if len(codebooks) > layout.MAX_CODEBOOKS:
        raise root.error("codebooks", f"{len(codebooks)}, expected at most {layout.MAX_CODEBOOKS}")
    first_view = _camera(root.take("first_view", dict), where) if root.has("first_view") else None
    pages = [_page(v, where) for v in root.take("pages", list)] if root.has("pages") else []
    if len(pages) > layout.MAX_PAGES:
        raise root.error("pages", f"{len(pages)}, expected at most {layout.MAX_PAGES}")
    segments = parse_segments(root.take("segments", dict), where)
    chunks = parse_chunks(root.take("chunks", dict), where)
    root.finish()
    return Root(
        writer, splats, sh_degree, info, box, codebooks, first_view, segments, chunks, pages
    )


def parse_page(value: Value, entry: PageEntry, where: str) -> tuple[SegmentTable, ChunkTable]:
    """Read an index page and check it against the root's entry (SPEC 5.6)."""
    page = _Map(value, where, "5.6")
    segments = parse_segments(page.take("segments", dict), where)
    chunks = parse_chunks(page.take("chunks", dict), where)
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


def _axes(root: _Map) -> str:
    axes = root.text("axes")
    pairs = ["RL", "UD", "FB"]
    if len(axes) != 3 or {next((p for p in pairs if a in p), "") for a in axes} != set(pairs):
        raise root.error("axes", f"{axes!r}, expected one of R/L, U/D and F/B each, such as 'RDF'")
    return axes


def _colour_space(root: _Map) -> str:
    name = root.text("colour_space")
    if name not in COLOUR_SPACES:
        raise UnsupportedError(
            "colour-space-unknown",
            root.error("colour_space", f"{name!r}, expected one of {COLOUR_SPACES}").message,
        )
    return name


def _codebook(value: Value, where: str) -> CodebookEntry:
    book = _Map(value, f"{where}, codebooks", "5.5")
    entry = CodebookEntry(book.text("attribute"), book.integer("rows", 1, MAX_CODEBOOK_ROWS))
    book.finish()
    if entry.attribute not in CODEBOOK_ATTRIBUTES:
        raise UnsupportedError(
            "codebook-unknown",
            f"{where}: a codebook of {entry.attribute!r}, expected {CODEBOOK_ATTRIBUTES} "
            "(SPEC 5.5)",
        )
    return entry


def _page(value: Value, where: str) -> PageEntry:
    page = _Map(value, f"{where}, pages", "5.6")
    entry = PageEntry(
        length=page.integer("length", 1, layout.MAX_PAGE_BYTES),
        crc=page.integer("crc", 0, (1 << 32) - 1),
        segments=page.integer("segments", 1, layout.MAX_SEGMENTS),
        chunks=page.integer("chunks", 0, layout.MAX_SEGMENTS),
        span=page.integer("span", 1, layout.MAX_FILE_BYTES),
    )
    page.finish()
    return entry


def _camera(value: Value, where: str) -> Camera:
    view = _Map(value, f"{where}, first_view", "4.4")
    width = view.integer("width", 1, 65535)
    height = view.integer("height", 1, 65535)
    fx, fy, cx, cy = (view.number(key) for key in ("fx", "fy", "cx", "cy"))
    rotation = np.array(view.numbers("rotation", 9)).reshape(3, 3)
    translation = np.array(view.numbers("translation", 3))
    view.finish()
    try:
        return Camera(width, height, fx, fy, cx, cy, rotation, translation, "first view")
    except DataError as error:
        raise FormatError("root-value", f"{where}, first_view: {error}", clause="4.4") from error
