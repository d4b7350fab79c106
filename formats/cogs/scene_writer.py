"""Write an encoded scene as a COGS file: build its root, order its segments."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.encoded import EncodedChunk, EncodedScene
from cogsplat.codec.partition.nested_cells import WHOLE
from cogsplat.codec.rate.segment_order import OrderedKind, OrderedSegment
from cogsplat.codec.segments.attributes import attribute_types
from cogsplat.codec.segments.payloads import Payloads
from cogsplat.codec.views.first_look import FirstLook

from . import layout
from .camera_segment import pack_cameras
from .compensation_segment import pack_layer
from .description import Description
from .description_segment import pack_segments
from .index_tables import ChunkTable, SegmentTable
from .layout import SegmentKind
from .root import CodebookEntry, Level, Root
from .view_table_segment import pack_view_table
from .writer import Segment, lay_out, write_cogs

NO_LOOK: Final = FirstLook()
"""The look of a file that leaves up direction and first view to viewers."""


def save(
    scene: EncodedScene,
    path: Path,
    *,
    writer: str,
    look: FirstLook = NO_LOOK,
    cameras: Sequence[Camera] = (),
    description: Description | None = None,
    force: bool = False,
) -> int:
    """Write an encoded scene as a COGS file.

    Parameters
    ----------
    scene : EncodedScene
        Scene to store.
    path : Path
        Output file.
    writer : str
        Name and version of the program, for the root.
    look : FirstLook
        Up direction, first view and core box for viewers.
    cameras : sequence of Camera
        Cameras to store.
    description : Description, optional
        Description to store, with the files of its pictures.
    force : bool
        Whether to replace an existing file.

    Returns
    -------
    int
        Length of the written file, bytes.

    Raises
    ------
    StorageError
        ``exists``, ``disk-full``, ``permission``, ``not-found`` or ``io``.
    DataError
        ``root-size``, ``bad-scene-info``, ``too-many-cameras``, ``bad-camera`` or
        ``bad-description``.
    """
    root = build_root(scene, writer, look)
    return write_cogs(root, segments(scene, cameras, description), path, force=force)


def build_root(scene: EncodedScene, writer: str, look: FirstLook = NO_LOOK) -> Root:
    """Return the root of an encoded scene, with an empty segment table for `writer.lay_out`.

    The core box is cut to the box of the stored splats.
    """
    chunks = scene.chunks
    count = len(chunks)
    table = ChunkTable(
        splats=np.array([chunk.splats for chunk in chunks], np.uint32),
        box=_boxes_float32(chunks),
        contribution=np.array([chunk.contribution for chunk in chunks], np.float64),
        quality=np.array([chunk.quality_db for chunk in chunks], np.float32),
        layer=np.array([_level_of(scene, number) for number in range(count)], np.uint32),
        cell=np.array([chunk.cell for chunk in chunks], np.uint32),
        object=np.array([chunk.object for chunk in chunks], np.uint32),
        until=np.array([chunk.until for chunk in chunks], np.uint32),
    )
    return Root(
        writer=writer,
        splats=scene.splats,
        sh_degree=scene.scene.sh_degree,
        info=scene.scene.info,
        box=scene.box,
        codebooks=[CodebookEntry(book.attribute, book.rows) for book in scene.codebooks],
        first_view=look.view,
        up=look.up,
        core_box=None if look.core_box is None else _within(look.core_box, scene.box),
        segments=SegmentTable.zeros(0),
        chunks=table,
        attributes=attribute_types(scene.scene.extras),
        levels=[Level(level.chunks, level.scale) for level in scene.levels],
    )


def size_bytes(
    scene: EncodedScene,
    *,
    writer: str,
    look: FirstLook = NO_LOOK,
    cameras: Sequence[Camera] = (),
    description: Description | None = None,
) -> int:
    """Return the length of the file that `save` would write, bytes."""
    stored = segments(scene, cameras, description)
    parts = lay_out(build_root(scene, writer, look), stored)
    return sum(len(part) for part in parts)


def _within(inner: NDArray[np.float64], outer: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the part of a bounding box that lies inside another."""
    low, high = np.tile(outer[:3], 2), np.tile(outer[3:], 2)
    return np.clip(inner, low, high)


def _boxes_float32(chunks: Sequence[EncodedChunk]) -> NDArray[np.float32]:
    """Return the chunks' bounding boxes as float32, rounded outward to still contain the splats."""
    wide = np.array([chunk.box for chunk in chunks], np.float64).reshape(-1, 6)
    limit = float(np.finfo(np.float32).max)
    narrow = np.clip(wide, -limit, limit).astype(np.float32)
    low = np.where(narrow[:, :3] > wide[:, :3], np.nextafter(narrow[:, :3], -np.inf), narrow[:, :3])
    high = np.where(narrow[:, 3:] < wide[:, 3:], np.nextafter(narrow[:, 3:], np.inf), narrow[:, 3:])
    return np.concatenate([low, high], axis=1).astype(np.float32)


def segments(
    scene: EncodedScene, cameras: Sequence[Camera] = (), description: Description | None = None
) -> list[Segment]:
    """Return the segments of a scene in the order of the file (SPEC 5.1).

    A compensation layer comes before the first chunk that earlier layers do not cover. The
    opacities of a level come before the last chunk of the level. The view table comes before the
    first chunk of a cell: from there on, clients choose chunks by view. Cameras, extra attributes,
    description and pictures come last.
    """
    out: list[Segment] = []
    layers, opacities, view_table = _layers(scene), _opacities(scene), _view_table(scene)
    codebooks: list[Segment] = []
    for number, book in enumerate(scene.codebooks):
        if book.attribute == "shape":
            out.append(Segment(SegmentKind.SHAPE_CODEBOOK, number, book.payloads[0]))
        else:
            for kind, payload in zip(layout.COLOUR_BANDS, book.payloads, strict=False):
                codebooks.append(Segment(kind, number, payload))
    for place in scene.ordered_segments():
        if place.kind is OrderedKind.CODEBOOKS:
            out += codebooks
        else:
            if place.kind is OrderedKind.HEAD:
                out += layers.get(place.chunk, [])
                out += opacities.get(place.chunk, [])
                out += view_table.get(place.chunk, [])
            out.append(_segment(place, scene.chunks[place.chunk].payloads))
    if cameras:
        out.append(Segment(SegmentKind.CAMERAS, 0, pack_cameras(cameras)))
    for number, chunk in enumerate(scene.chunks):
        if chunk.attributes is not None:
            out.append(Segment(SegmentKind.ATTRIBUTES, number, chunk.attributes))
    return [*out, *pack_segments(description)]


def _layers(scene: EncodedScene) -> dict[int, list[Segment]]:
    """Return the compensation layers' segments, by the chunk before which each is written."""
    found: dict[int, list[Segment]] = {}
    first = 0
    for number, layer in enumerate(scene.compensation.layers if scene.compensation else ()):
        found[first] = [Segment(SegmentKind.COMPENSATION, number, pack_layer(layer))]
        first = layer.chunks
    return found


def _level_of(scene: EncodedScene, chunk: int) -> int:
    """Return the number of the first level that contains a chunk; 0 in a scene without levels."""
    return sum(level.chunks <= chunk for level in scene.levels)


def _opacities(scene: EncodedScene) -> dict[int, list[Segment]]:
    """Return the later levels' opacity segments, by the chunk before which each is written."""
    found: dict[int, list[Segment]] = {}
    for number, chunk in enumerate(scene.chunks):
        for level, payload in enumerate(chunk.opacities, start=_level_of(scene, number) + 1):
            last = scene.levels[level].chunks - 1
            found.setdefault(last, []).append(Segment(SegmentKind.OPACITIES, number, payload))
    return found


def _view_table(scene: EncodedScene) -> dict[int, list[Segment]]:
    """Return the view table's segment, if any, by the chunk before which it is written."""
    if scene.view_table is None:
        return {}
    parts = (number for number, chunk in enumerate(scene.chunks) if chunk.cell > WHOLE)
    payload = pack_view_table(scene.view_table)
    # In a scene without cells, the view table comes before the last chunk.
    before = next(parts, len(scene.chunks) - 1)
    return {before: [Segment(SegmentKind.VIEW_TABLE, 0, payload)]}


def _segment(place: OrderedSegment, parts: Payloads) -> Segment:
    """Return the head, refinement or tail of a chunk at a place in the segment order."""
    if place.kind is OrderedKind.REFINEMENT and parts.refinement is not None:
        return Segment(SegmentKind.REFINEMENT, place.chunk, parts.refinement)
    if place.kind is OrderedKind.TAIL and parts.tail is not None:
        return Segment(SegmentKind.TAIL, place.chunk, parts.tail, parts.tail_needs)
    return Segment(SegmentKind.HEAD, place.chunk, parts.head, parts.head_needs)
