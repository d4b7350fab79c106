"""Must-reject vectors of two faults in a file; the earlier step sets the code (SPEC 8.1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from cogsplat.formats.cogs.canonical_msgpack import Value, pack
from cogsplat.formats.cogs.layout import PREAMBLE_BYTES, SegmentKind
from cogsplat.formats.cogs.writer import Segment

from .attribute_vectors import camera_columns
from .file_builder import (
    Draft,
    Index,
    build,
    column,
    poke,
    preamble_field,
    root_keys,
    split_root,
    table,
)
from .invalid import (
    Invalid,
    build_edited,
    chunk_with_codebooks,
    key_setter,
    paged_chunks,
    two_chunks,
    uniform_chunk,
    with_segments,
)

Change = Callable[[Index], object]


def _poke(name: str, key: str, offset: int, layout: str, value: float) -> Change:
    """Return a function that overwrites one number in a column of an index's table."""

    def change(index: Index) -> None:
        table(index, name)[key] = poke(column(index, name, key), offset, layout, value)

    return change


def _all(*changes: Change) -> Change:
    """Return a function that applies several changes to an index in order."""

    def change(index: Index) -> None:
        for each in changes:
            each(index)

    return change


def _cut_to_root(data: bytes) -> bytes:
    """Return a file without the bytes behind its root."""
    root, _ = split_root(data)
    return data[: PREAMBLE_BYTES + len(root)]


def invalid() -> list[Invalid]:
    """Return the vectors of two faults in a file, in the order of the steps of SPEC 8.1."""
    head, tail, second, second_tail = two_chunks().groups[0].segments
    shape, _, *drawn = chunk_with_codebooks().groups[0].segments
    unknown = _poke("segments", "kind", 0, "B", 99)
    short = _poke("segments", "length", 0, "I", 100)
    more = key_setter("splats", 9)
    none_needed = _poke("segments", "needs", 0, "I", 1)
    camera = Segment(SegmentKind.CAMERAS, 0, pack(camera_columns(1)))

    def bad(name: str, data: bytes, code: str, clause: str, note: str) -> Invalid:
        return Invalid(f"order-{name}", data, code, clause, note)

    def with_order(
        segments: Sequence[Segment], change: Change, draft: Draft | None = None
    ) -> bytes:
        return build_edited(with_segments(draft or two_chunks(), segments), change)

    flat = replace(two_chunks(), root=root_keys(4, 0))
    versions = preamble_field(preamble_field(build(uniform_chunk()), 8, "H", 1), 28, "I", 1)
    flipped = poke(versions, 60, "B", versions[60] ^ 1)
    return [
        bad("crc-version", flipped, "preamble-crc", "3.1",
            "another version in a preamble of a wrong CRC"),
        bad("version-reserved", versions, "version-major", "3.2",
            "another version, and reserved bytes set"),
        bad("kind-trailing", build_edited(uniform_chunk(), unknown) + b"\0",
            "segment-kind-unknown", "5.2",
            "an unknown kind, and a byte behind the end"),
        bad("trailing-heads", build(with_segments(two_chunks(), [head, tail, second_tail])) + b"\0",
            "file-trailing", "3.3", "a byte behind the end, and a chunk without a head"),
        bad("page-end", build_edited(paged_chunks(), _all(_poke("pages", "crc", 0, "I", 1), short)),
            "segments-length", "5.1",
            "an end that is not the file's; a page elsewhere than its place, and so another CRC"),
        bad("root-page", build_edited(paged_chunks(), _all(_poke("pages", "crc", 0, "I", 1),
                                                           none_needed)),
            "needs-range", "5.3", "a codebook needed that is not there; another CRC of a page"),
        bad("pages-values", build_edited(paged_chunks(), _all(
                _poke("pages", "box", 0, "f", 9.0), _poke("pages", "span", 0, "Q", 0),
                key_setter("cell", b"", within="pages"))),
            "root-columns", "5.6", "a box and a span out of range, and no cell of one page"),
        bad("end-heads", with_order([second, second_tail, head, tail], short), "segments-length",
            "5.1", "bytes that no segment holds, and heads out of order"),
        bad("heads-tails", build(with_segments(flat, [second, head, tail])), "chunk-heads", "5.4",
            "heads out of order, and a tail at SH degree 0"),
        bad("splats-tails", with_order([tail, head, second], more), "splat-count", "5.4",
            "another number of splats, and a tail before its head"),
        bad("splats-needs", build_edited(uniform_chunk(), _all(more, none_needed)), "splat-count",
            "5.4",
            "another number of splats, and a codebook needed where there are none"),
        bad("needs-books", with_order([shape, *drawn], _poke("segments", "needs", 0, "I", 4),
                                      chunk_with_codebooks()),
            "needs-range", "5.3", "a codebook needed that is not there, and another incomplete"),
        bad("books-cameras", build(with_segments(chunk_with_codebooks(), [shape, *drawn, camera,
            camera])),
            "codebook-segments", "5.5", "a codebook incomplete, and cameras twice"),
        bad("cut-splats", _cut_to_root(build_edited(paged_chunks(), key_setter("splats", 1))),
            "file-truncated", "3.3",
            "a file cut before its page, and more splats in the root's chunks than in the scene"),
        *_key_order(),
    ]  # fmt: skip


def _key_order() -> list[Invalid]:
    """Return vectors of two faults in the maps of a root, whose keys are read one by one."""

    def bad(
        name: str, code: str, clause: str, note: str, *changes: Change, draft: Draft | None = None
    ) -> Invalid:
        data = build_edited(draft or uniform_chunk(), _all(*changes))
        return Invalid(f"order-{name}", data, code, clause, note)

    def without(name: str) -> Change:
        def change(index: Index) -> None:
            del index[name]

        return change

    unknown: dict[str, Value] = {"unit!": "m"}
    shape: dict[str, Value] = {"attribute": "shape", "rows": 1}
    view: dict[str, Value] = {
        "width": 64, "height": 64, "fx": 50.0, "fy": 50.0, "cx": 32.0, "cy": 32.0,
        "rotation": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], "translation": [0.0, 0.0, 0.0],
    }  # fmt: skip
    sheared: list[Value] = [1.0, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    level: dict[str, Value] = {"chunks": 1, "scale": 2.0}
    return [
        bad("kernel-antialiased", "root-value", "4.2",
            "a negative kernel, and no key behind it",
            key_setter("kernel_px", -1.0), without("antialiased")),
        bad("codebooks-33", "root-value", "4.2", "33 codebooks, the first of them unknown",
            key_setter("codebooks", [shape | {"attribute": "depth"}, *[shape] * 32])),
        bad("codebook-rows", "codebook-unknown", "5.5", "an unknown codebook, of 0 rows",
            key_setter("codebooks", [{"attribute": "depth", "rows": 0}])),
        bad("codebooks-text", "root-value", "5.5", "a codebook of 0 rows, then one that is no map",
            key_setter("codebooks", [shape | {"rows": 0}, "shape"])),
        bad("view-focal", "root-value", "4.4", "a negative focal length, and no principal point",
            key_setter("first_view",
                       {**{key: view[key] for key in view if key != "cx"}, "fx": -1.0})),
        bad("view-rotation", "root-value", "4.4", "a sheared rotation, and an unknown key with !",
            key_setter("first_view", view | {"rotation": sheared} | unknown)),
        bad("view-target", "root-value", "4.4",
            "a target behind the camera, and an unknown key with !",
            key_setter("first_view", view | {"target": [0.0, 0.0, -1.0]} | unknown)),
        bad("up-attributes", "root-value", "4.2", "an up of zeros, and a text for attributes",
            key_setter("up", [0.0, 0.0, 0.0]), key_setter("attributes", "none")),
        bad("view-core-box", "root-type", "4.4", "a text for a width, and a core box outside",
            key_setter("core_box", [-9.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
            key_setter("first_view", view | {"width": "64"})),
        bad("capture-attributes", "root-columns", "4.2",
            "three bytes of a viewpoint, and a text for attributes",
            key_setter("capture", b"abc"), key_setter("attributes", "none")),
        bad("level-chunks", "root-value", "5.11",
            "two levels of one chunk, the second without a scale",
            key_setter("levels", [level, {"chunks": 1}])),
        bad("level-scale", "root-value", "5.11",
            "a scale below 0, and an unknown key with !",
            key_setter("levels", [level | {"scale": -1.0} | unknown])),
        bad("kind-length", "segment-kind-unknown", "5.2",
            "a segment of 0 bytes, then one of an unknown kind",
            _poke("segments", "length", 0, "I", 0), _poke("segments", "kind", 1, "B", 99),
            draft=two_chunks()),
    ]  # fmt: skip
