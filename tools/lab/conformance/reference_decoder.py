"""Reference decoder, written from SPEC alone; it computes the arrays of the conformance vectors.

It shares no code with the codec or the container. It is slow and decodes only valid files.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

import msgpack

from . import reference_compensation as compensation
from . import reference_streams as streams
from .reference_file import File, IndexPath, Segment
from .reference_streams import (
    BANDS,
    BASIS,
    DIFFERENCES,
    ESCAPE,
    MEANS,
    OPACITIES,
    QUATS,
    SCALE_FACTOR,
    SCALES,
    SH0,
    SHAPE,
    SHN,
    Payload,
    Row,
)

# SPEC 5.2, by number.
_HEAD, _TAIL, _REFINEMENT, _OPACITIES = 1, 2, 7, 8
_CAMERAS, _ATTRIBUTES, _COMPENSATION, _VIEW_TABLE = 128, 129, 130, 131
_DESCRIPTION, _PICTURE = 132, 133
_BAND_VALUES: Final = (9, 15, 21)
_NAMES: Final = ("means", "scales", "quats", "opacities", "sh0", "shN")

Rows = dict[str, list[Row]]
"""Decoded splats: rows of values of each array, by array name."""
Camera = dict[str, str | int | float | list[float]]
Viewpoint = tuple[list[float], list[float]]
"""Position, and share of each chunk."""
Json = None | bool | int | float | str | list["Json"] | dict[str, "Json"]
Picture = tuple[tuple[str, int, int], bytes]
"""Media type, width and height in the header of a picture; and its bytes."""


@dataclass(frozen=True)
class Prefix:
    """Content that can be decoded from the first `size` bytes of a file.

    Parameters
    ----------
    size : int
        Length of the shortest prefix with this content, bytes.
    chunks : int
        Number of first chunks whose heads can be decoded.
    tails : tuple of int
        Numbers of the chunks whose tails can be decoded.
    refined : tuple of int
        Numbers of the chunks whose refinements are in the prefix.
    opacities : tuple of (int, int)
        Number of a chunk and count of its opacities segments in the prefix, if it has any.
    """

    size: int
    chunks: int
    tails: tuple[int, ...]
    refined: tuple[int, ...]
    opacities: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Scene:
    """A decoded file; arrays are lists of rows.

    Parameters
    ----------
    sh_degree : int
    chunk_splats : list of int
    rows : dict of str to list of list of float
        Rows by the array names of `Splats`; ``shN`` in the order coefficient, channel.
    prefixes : list of Prefix
        Prefixes, from the end of the root on.
    attributes : list of (name, type, components)
        Extra attributes, components 0 where none are stated.
    attribute_values : dict of int to list of bytes
        Little-endian values of each attribute, row by row, for each chunk with attributes by
        number.
    cameras : list of dict
        Cameras with the keys of `first_view` and ``name``.
    view_tables : list of (path, list of (list of float, list of float))
        Position and shares of each viewpoint of the table of each index that has one,
        with the path of the index: the rows of pages from the root on.
    parents : list of (int or None)
        Parent of each chunk; empty in a scene that is not cut into cells.
    description : dict or None
        Map of the description; None without one.
    pictures : dict of str to Picture
        Pictures by name.
    compensated : dict of int to list of float
        Compensated log scales, then logits, of the drawn chunks of a prefix, by its chunk count.
    compensated_sets : list of (list of int, list of float)
        For sets of chunks that are not prefixes: chunk numbers; compensated log scales and logits.
    until : list of int
        Prefix length in chunks from which each chunk is no longer drawn, 0 if it never ends.
    levels : list of (float, int, dict of str to list of list of float)
        Scale, chunk count and drawn rows of each level.
    drawn : list of dict of str to list of list of float
        Rows that each of `prefixes` draws; empty if no chunk ends and no level has opacities.
    """

    sh_degree: int
    chunk_splats: list[int]
    rows: dict[str, list[Row]]
    prefixes: list[Prefix]
    attributes: list[tuple[str, str, int]]
    attribute_values: dict[int, list[bytes]]
    cameras: list[Camera]
    view_tables: list[tuple[IndexPath, list[Viewpoint]]]
    parents: list[int | None]
    description: Json
    pictures: dict[str, Picture]
    compensated: dict[int, Row]
    compensated_sets: list[tuple[list[int], Row]]
    until: list[int]
    levels: list[tuple[float, int, Rows]]
    drawn: list[Rows]


def _bands(payload: Payload, degree: int, rows: int, flag: int = 0) -> list[Row]:
    """Return the SH rows above DC, zeros where a band has no stream (SPEC 7.3)."""
    out: list[Row] = [[] for _ in range(rows)]
    for attribute, values in list(zip(BANDS, _BAND_VALUES, strict=True))[:degree]:
        record = payload.get((attribute, flag))
        band = streams.numbers(record) if record else [[0.0] * values] * rows
        for row, part in zip(out, band, strict=True):
            row += part
    return out


def _shapes(payload: Payload, flag: int) -> list[Row]:
    """Return rows of log scales and quaternions; `flag` is ESCAPE for escape rows, else 0."""
    scales = streams.numbers(payload[SCALES, flag])
    quats = streams.quats(payload[QUATS, flag], scales)
    return [row + quat for row, quat in zip(scales, quats, strict=True)]


def _codebook(file: File, book: int) -> list[Row]:
    """Return a codebook's rows: scales then quats, or SH coefficients (SPEC 7.1)."""
    entry = file.root["codebooks"][book]
    if entry["attribute"] == "shape":
        return _shapes(file.payload(file.book_segments(book)[0]), 0)
    merged: Payload = {}
    for segment in file.book_segments(book):
        merged |= file.payload(segment)
    return _bands(merged, file.root["sh_degree"], entry["rows"])


def _head(payload: Payload, books: dict[int, list[Row]], finer: Payload) -> dict[str, list[Row]]:
    """Return the rows of each attribute in a chunk head, read in the order of SPEC 7.2.

    Parameters
    ----------
    payload : Payload
        Streams of the head.
    books : dict of int to list of Row
        Rows of each codebook, by its number.
    finer : Payload
        Streams of the refinement (SPEC 7.4); empty without one.
    """
    shape = payload.get((SHAPE, 0))
    if shape is None:
        coarse = streams.numbers(payload[SCALES, 0])
        scales = streams.numbers(payload[SCALES, 0], None, finer.get((SCALES, 0)))
        quats = streams.quats(payload[QUATS, 0], coarse)
    else:
        number, escape = struct.unpack("<II", shape.params)
        book = books[number] + (_shapes(payload, ESCAPE) if escape else [])
        shapes = [book[i] for i in streams.indices(shape, len(books[number]))]
        factors = streams.numbers(payload[SCALE_FACTOR, 0])
        scales = [
            [streams.f32(value + factor) for value in row[:3]]
            for row, (factor,) in zip(shapes, factors, strict=True)
        ]
        coarse, quats = scales, [row[3:] for row in shapes]
    return {
        "scales": scales,
        "quats": quats,
        "means": streams.numbers(payload[MEANS, 0], coarse, finer.get((MEANS, 0))),
        "opacities": streams.numbers(payload[OPACITIES, 0], None, finer.get((OPACITIES, 0))),
        "sh0": streams.numbers(payload[SH0, 0], None, finer.get((SH0, 0))),
    }


def _opacities(payload: Payload, before: list[Row]) -> list[Row]:
    """Return a chunk's opacities at a later level (SPEC 6.12, 7.5)."""
    record = payload[OPACITIES, 0]
    stored = streams.numbers(record)
    if record.kind != DIFFERENCES:
        return stored
    return [[streams.f32(x + d)] for (x,), (d,) in zip(before, stored, strict=True)]


def _tail(payload: Payload, books: dict[int, list[Row]], degree: int, rows: int) -> list[Row]:
    """Return the rows of a chunk tail, its streams read in the order of SPEC 7.3."""
    colour = payload.get((SHN, 0))
    if colour is None:
        return _bands(payload, degree, rows)
    if colour.kind == BASIS:
        return streams.shn_basis(colour, books[struct.unpack_from("<I", colour.params)[0]])
    number, escape = struct.unpack("<II", colour.params)
    book = books[number] + _bands(payload, degree, escape, ESCAPE)
    return [book[i] for i in streams.indices(colour, len(books[number]))]


def _attribute_types(file: File) -> list[tuple[str, str, int]]:
    """Return name, type and component count of each extra attribute that the root lists."""
    entries = file.root.get("attributes", [])
    return [(entry["name"], entry["type"], entry.get("components", 0)) for entry in entries]


def _attributes(file: File) -> dict[int, list[bytes]]:
    """Return the bytes of each chunk's extra attributes, row by row (SPEC 5.7)."""
    sizes = [max(1, count) * int(kind[1]) for _, kind, count in _attribute_types(file)]
    out: dict[int, list[bytes]] = {}
    for segment in file.segments:
        if segment.kind != _ATTRIBUTES:
            continue
        data = file.data[segment.start : segment.end]
        words = struct.unpack_from(f"<{sum(sizes)}I", data)
        rows, position = file.chunk_splats[segment.owner], 4 * sum(sizes)
        planes = []
        for word in words:
            end = position + (word & 0x3FFFFFFF)
            planes.append(streams.plane(word, data[position:end], rows))
            position = end
        parts = []
        for size in sizes:
            own, planes = planes[:size], planes[size:]
            parts.append(bytes(plane[row] for row in range(rows) for plane in own))
        out[segment.owner] = parts
    return dict(sorted(out.items()))


def _cameras(file: File) -> list[Camera]:
    """Return the cameras of a file (SPEC 5.8)."""
    found = file.segments_of(_CAMERAS, 0)
    if not found:
        return []
    table = msgpack.unpackb(file.data[found[0].start : found[0].end])
    out: list[Camera] = []
    for row, name in enumerate(table["name"]):
        camera: Camera = {"name": name}
        for key in ("width", "height"):
            camera[key] = struct.unpack_from("<H", table[key], 2 * row)[0]
        for key in ("fx", "fy", "cx", "cy"):
            camera[key] = struct.unpack_from("<d", table[key], 8 * row)[0]
        camera["rotation"] = list(struct.unpack_from("<9d", table["rotation"], 72 * row))
        camera["translation"] = list(struct.unpack_from("<3d", table["translation"], 24 * row))
        out.append(camera)
    return out


def _view_tables(file: File) -> list[tuple[IndexPath, list[Viewpoint]]]:
    """Return the view table of each index that lists one, with the path of the index."""
    return [
        (path, _view_table(file, segment, file.columns[path]))
        for segment, path in zip(file.segments, file.paths, strict=True)
        if segment.kind == _VIEW_TABLE
    ]


def _view_table(file: File, segment: Segment, chunks: int) -> list[Viewpoint]:
    """Return the viewpoints of a view table, whose columns are `chunks` (SPEC 5.12)."""
    table = msgpack.unpackb(file.data[segment.start : segment.end])
    views = len(table["position"]) // 12
    (word,) = struct.unpack_from("<I", table["codes"])
    differences = streams.plane(word, table["codes"][4:], views * chunks)
    codes = [0] * chunks
    out: list[Viewpoint] = []
    for view in range(views):
        shares = []
        for chunk in range(chunks):
            codes[chunk] = (codes[chunk] + differences[view * chunks + chunk]) % 256
            exponent, low = divmod(codes[chunk], 2)
            shares.append((2 + low) * 2.0 ** (exponent - 128) if codes[chunk] else 0.0)
        position = list(struct.unpack_from("<3f", table["position"], 12 * view))
        out.append((position, shares))
    return out


def _description(file: File) -> Json:
    """Return the map of a file's description (SPEC 5.13)."""
    found = file.segments_of(_DESCRIPTION, 0)
    if not found:
        return None
    value: Json = msgpack.unpackb(file.data[found[0].start : found[0].end])
    return value


def _pictures(file: File) -> dict[str, Picture]:
    """Return the pictures of a file (SPEC 5.14)."""
    out: dict[str, Picture] = {}
    for owner, name in enumerate(("poster", "sky")):
        for segment in file.segments_of(_PICTURE, owner):
            data = file.data[segment.start : segment.end]
            out[name] = (_jpeg(data) if data[:2] == b"\xff\xd8" else _webp(data), data)
    return out


def _jpeg(data: bytes) -> tuple[str, int, int]:
    """Return type, width and height of a JPEG (SPEC 5.14)."""
    at = 2
    while data[at + 1] not in (0xC0, 0xC1, 0xC2):
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    height, width = struct.unpack_from(">HH", data, at + 5)
    return "image/jpeg", width, height


def _webp(data: bytes) -> tuple[str, int, int]:
    """Return type, width and height of a still WebP (SPEC 5.14)."""
    at = 12
    while data[at : at + 4] not in (b"VP8 ", b"VP8L"):
        length = int.from_bytes(data[at + 4 : at + 8], "little")
        at += 8 + length + length % 2
    if data[at : at + 4] == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, at + 14)
        return "image/webp", width % (1 << 14), height % (1 << 14)
    (bits,) = struct.unpack_from("<I", data, at + 9)
    return "image/webp", bits % (1 << 14) + 1, (bits >> 14) % (1 << 14) + 1


def _compensated(file: File, rows: Rows) -> dict[int, Row]:
    """Return the compensated scales and opacities of each prefix of chunks (SPEC 8.5)."""
    segments = [s for s in file.segments if s.kind == _COMPENSATION]
    payloads = [file.data[s.start : s.end] for s in sorted(segments, key=lambda s: s.owner)]
    owners = [c for c, count in enumerate(file.chunk_splats) for _ in range(count)]
    out: dict[int, Row] = {}
    if payloads and all(file.cells):
        for chunks in range(1, len(file.chunk_splats) + 1):
            out[chunks] = _compensated_set(file, rows, payloads, list(range(chunks)))
        return out
    for chunks in range(1, len(file.chunk_splats) + 1) if payloads else ():
        shifts = compensation.shifts(payloads, file.chunk_splats, chunks)
        scales: Row = []
        opacities: Row = []
        if shifts is None:
            # Rows without shifts keep their bits, also -0 (SPEC 8.5).
            count = sum(file.chunk_splats[:chunks])
            places = [p for p in range(count) if owners[p] in file.drawn(chunks)]
            stored = [rows[name][p] for name in ("scales", "opacities") for p in places]
            out[chunks] = [value for row in stored for value in row]
            continue
        for place, (scale, opacity) in enumerate(shifts):
            if owners[place] not in file.drawn(chunks):
                continue
            scales += compensation.add_shift(rows["scales"][place], scale)
            opacities += compensation.add_shift(rows["opacities"][place], opacity)
        out[chunks] = scales + opacities
    return out


def _compensated_sets(file: File, rows: Rows) -> list[tuple[list[int], Row]]:
    """Return the compensated scales and opacities of each set that is not a prefix (SPEC 8.5)."""
    segments = [s for s in file.segments if s.kind == _COMPENSATION]
    payloads = [file.data[s.start : s.end] for s in sorted(segments, key=lambda s: s.owner)]
    if not payloads or not all(file.cells):
        return []
    return [
        (chosen, _compensated_set(file, rows, payloads, chosen))
        for chosen in compensation.closed_sets(file.parents())
    ]


def _compensated_set(file: File, rows: Rows, payloads: list[bytes], chosen: list[int]) -> Row:
    """Return the compensated scales and opacities of a set of chunks (SPEC 8.5)."""
    starts = [sum(file.chunk_splats[:chunk]) for chunk in range(len(file.chunk_splats))]
    parents = file.parents()
    scales: Row = []
    opacities: Row = []
    for chunk in chosen:
        shifts = compensation.set_shifts(payloads, file.chunk_splats, parents, chosen, chunk)
        for place in range(starts[chunk], starts[chunk] + file.chunk_splats[chunk]):
            if shifts is None:
                scales += rows["scales"][place]
                opacities += rows["opacities"][place]
            else:
                scales += compensation.add_shift(rows["scales"][place], shifts[place][0])
                opacities += compensation.add_shift(rows["opacities"][place], shifts[place][1])
    return scales + opacities


def _prefixes(file: File) -> list[Prefix]:
    """Return the prefixes of a file, one per change of decodable content (SPEC 8.2)."""

    def there(segment: Segment, size: int) -> bool:
        needed = [b for b in range(len(file.root["codebooks"])) if segment.needs >> b & 1]
        parts = [segment, *(s for b in needed for s in file.book_segments(b))]
        return all(s.end <= size and file.known_at[file.segments.index(s)] <= size for s in parts)

    out: list[Prefix] = []
    for size in sorted({file.root_end, *(s.end for s in file.segments), file.length}):
        chunks = 0
        for chunk in range(len(file.chunk_splats)):
            if not there(file.segments_of(_HEAD, chunk)[0], size):
                break
            chunks += 1
        tails, refined = (
            tuple(c for c in range(chunks) for s in file.segments_of(kind, c) if there(s, size))
            for kind in (_TAIL, _REFINEMENT)
        )
        counts = [
            sum(there(s, size) for s in file.segments_of(_OPACITIES, c)) for c in range(chunks)
        ]
        opacities = tuple((c, count) for c, count in enumerate(counts) if count)
        given = Prefix(out[-1].size if out else 0, chunks, tails, refined, opacities)
        if not out or out[-1] != given:
            out.append(replace(given, size=size))
    return out


class _Chunks:
    """Decoder of single chunks of a file."""

    def __init__(self, file: File) -> None:
        self._file = file
        self._degree = file.root["sh_degree"]
        self._books = {book: _codebook(file, book) for book in range(len(file.root["codebooks"]))}

    def decode_chunk(self, chunk: int, *, refine: bool, tail: bool, opacities: int) -> Rows:
        """Decode a chunk, with the opacities of the last of its first `opacities` segments."""
        file, degree = self._file, self._degree
        refinements = file.segments_of(_REFINEMENT, chunk) if refine else []
        finer = file.payload(refinements[0]) if refinements else {}
        rows = _head(file.payload(file.segments_of(_HEAD, chunk)[0]), self._books, finer)
        levels = file.segments_of(_OPACITIES, chunk)[:opacities]
        if levels:
            rows["opacities"] = _opacities(file.payload(levels[-1]), rows["opacities"])
        tails = file.segments_of(_TAIL, chunk) if tail else []
        splats = file.chunk_splats[chunk]
        blank = [[0.0] * (3 * ((degree + 1) ** 2 - 1))] * splats
        rows["shN"] = blank
        if tails:
            rows["shN"] = _tail(file.payload(tails[0]), self._books, degree, splats)
        return rows

    def concatenate(self, parts: Iterable[Rows]) -> Rows:
        """Concatenate the rows of several chunks."""
        rows: Rows = {name: [] for name in _NAMES}
        for part in parts:
            for name in _NAMES:
                rows[name] += part[name]
        return rows

    def level(self, number: int) -> tuple[float, int, Rows]:
        """Return scale, chunk count and drawn splats of a level (SPEC 5.11)."""
        entries = self._file.root["levels"]
        chunks = entries[number]["chunks"]
        parts = []
        for chunk in self._file.drawn(chunks):
            first = next(k for k, entry in enumerate(entries) if chunk < entry["chunks"])
            parts.append(self.decode_chunk(chunk, refine=True, tail=True, opacities=number - first))
        return entries[number]["scale"], chunks, self.concatenate(parts)

    def prefix(self, prefix: Prefix) -> Rows:
        """Return the splats that a prefix draws; chunks that have ended are left out (SPEC 8.2)."""
        counts = dict(prefix.opacities)
        return self.concatenate(
            self.decode_chunk(
                chunk,
                refine=chunk in prefix.refined,
                tail=chunk in prefix.tails,
                opacities=counts.get(chunk, 0),
            )
            for chunk in self._file.drawn(prefix.chunks)
        )


def decode(data: bytes, *, refine: bool = True) -> Scene:
    """Decode a valid file, with or without its refinements."""
    file = File(data)
    made = _Chunks(file)
    every = len(file.segments)
    chunks = range(len(file.chunk_splats))
    parts = [
        made.decode_chunk(chunk, refine=refine, tail=True, opacities=every) for chunk in chunks
    ]
    prefixes = _prefixes(file)
    every_row = made.concatenate(parts)
    is_plain = not any(file.until) and not any(s.kind == _OPACITIES for s in file.segments)
    return Scene(
        sh_degree=file.root["sh_degree"],
        chunk_splats=file.chunk_splats,
        rows=made.concatenate(parts[chunk] for chunk in file.drawn(len(parts))),
        prefixes=prefixes,
        attributes=_attribute_types(file),
        attribute_values=_attributes(file),
        cameras=_cameras(file),
        view_tables=_view_tables(file),
        parents=file.parents() if all(file.cells) else [],
        description=_description(file),
        pictures=_pictures(file),
        compensated=_compensated(file, every_row),
        compensated_sets=_compensated_sets(file, every_row),
        until=file.until,
        levels=[made.level(number) for number in range(len(file.root.get("levels", [])))],
        drawn=[] if is_plain else [made.prefix(prefix) for prefix in prefixes],
    )
