"""PLY headers: elements, their properties, and the properties of a 3DGS splat."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import BinaryIO

from cogsplat.codec.errors import FormatError, TruncatedError

MAX_HEADER_BYTES = 65536
"""Limit on a header's length; a scene of SH degree 3 has about 1500 bytes."""

MAX_COUNT = 2**31 - 1
"""Limit on an element's count: the INT32 of the PLY description (Turk, 1994)."""

# numpy type of each PLY type: names of the PLY description first, then names of later writers.
_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
_FORMATS = ("binary_little_endian", "binary_big_endian", "ascii")


@dataclass(frozen=True)
class Property:
    """A property of an element: its name and type.

    Parameters
    ----------
    name : str
        Name in the header.
    dtype : str
        numpy type of the value, or of a list's items, without byte order, e.g. ``"f4"``.
    length_dtype : str
        numpy type of a list's length; empty for a scalar property.
    """

    name: str
    dtype: str
    length_dtype: str = ""

    @property
    def min_bytes(self) -> int:
        """Size of the value in a binary file, bytes; for a list, the size of an empty one."""
        return int((self.length_dtype or self.dtype)[1:])


@dataclass(frozen=True)
class Element:
    """An element of a PLY: its name, its number of rows, and the properties of a row."""

    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def has_lists(self) -> bool:
        """Whether a property is a list, so that rows may differ in length."""
        return any(prop.length_dtype for prop in self.properties)

    @property
    def min_stride(self) -> int:
        """Smallest size of a row in a binary file, bytes; the exact size without lists."""
        return sum(prop.min_bytes for prop in self.properties)


@dataclass(frozen=True)
class PlyHeader:
    """The header of a PLY: format, comments, elements.

    Parameters
    ----------
    format : str
        ``binary_little_endian``, ``binary_big_endian`` or ``ascii``.
    elements : tuple of Element
        In file order.
    comments : tuple of str
        Text of each comment, without the word ``comment``.
    data_offset : int
        Offset of the first row, bytes.
    """

    format: str
    elements: tuple[Element, ...]
    comments: tuple[str, ...]
    data_offset: int

    @property
    def is_canonical(self) -> bool:
        """Whether vertices are the first element, little-endian, without lists."""
        return (
            self.format == "binary_little_endian"
            and self.elements[0].name == "vertex"
            and not self.elements[0].has_lists
        )

    def vertex(self, where: str) -> Element:
        """Return the element ``vertex``, which holds the splats, or raise ``ply-no-vertex``."""
        for element in self.elements:
            if element.name == "vertex":
                return element
        names = ", ".join(element.name for element in self.elements) or "none"
        raise FormatError(
            "ply-no-vertex", f"{where}: elements {names}, expected an element 'vertex'"
        )


def is_ply(head: bytes) -> bool:
    """Return whether a file that begins with `head` is a PLY."""
    return head.startswith((b"ply\n", b"ply\r\n"))


def read_header(file: BinaryIO, where: str) -> PlyHeader:
    """Read and parse the header of an open file.

    Raises
    ------
    FormatError
        See `parse_header`.
    """
    return parse_header(file.read(MAX_HEADER_BYTES), where)


def parse_header(head: bytes, where: str) -> PlyHeader:
    """Parse the header at the start of a file.

    Parameters
    ----------
    head : bytes
        First `MAX_HEADER_BYTES` of the file, or the whole file if it is shorter.
    where : str
        Name of the file for messages.

    Raises
    ------
    FormatError
        ``ply-magic``, ``ply-header-too-long``, ``ply-bad-header``, ``ply-bad-count``,
        ``ply-duplicate-property``, ``ply-duplicate-element``, ``ply-empty-element``.
    TruncatedError
        ``ply-no-end-header``: the file ends inside its header.
    """
    if not is_ply(head):
        raise FormatError("ply-magic", f"{where}: starts with {head[:8]!r}, expected 'ply'")
    end = re.search(rb"\nend_header\r?\n", head)
    if end is None:
        if len(head) >= MAX_HEADER_BYTES:
            raise FormatError(
                "ply-header-too-long",
                f"{where}: no end_header, expected one within {MAX_HEADER_BYTES} bytes",
            )
        raise TruncatedError(
            "ply-no-end-header", f"{where}: ends after {len(head)} bytes, expected end_header"
        )
    # Comments may have any encoding; the names that we look up are ASCII.
    lines = head[: end.start()].decode("utf-8", "replace").split("\n")
    return _Parser(where).parse([line.removesuffix("\r") for line in lines[1:]], end.end())


def with_count(head: bytes, count: int) -> bytes:
    """Return a header whose element ``vertex`` has another number of rows; all else is kept.

    Parameters
    ----------
    head : bytes
        Header that `parse_header` accepts, up to and with its last line.
    count : int
        Number of rows.
    """
    lines = head.split(b"\n")
    for number, line in enumerate(lines):
        if line.split()[:2] == [b"element", b"vertex"]:
            lines[number] = b"element vertex %d" % count + b"\r" * line.endswith(b"\r")
    return b"\n".join(lines)


class _Parser:
    """Parser of the lines of a PLY header."""

    def __init__(self, where: str) -> None:
        self.where = where
        self.line = ""
        self.number = 1
        self.format = ""
        self.comments: list[str] = []
        self.elements: list[tuple[str, int, list[Property]]] = []

    def parse(self, lines: Sequence[str], data_offset: int) -> PlyHeader:
        """Return the header of its lines, from the second line to the one before end_header."""
        for self.line in lines:
            self.number += 1
            word, *rest = self.line.split(maxsplit=1) or [""]
            if word == "comment":
                self.comments.append("".join(rest))
            elif word != "obj_info":
                self.statement(self.line.split())
        if not self.format or not self.elements:
            missing = "elements" if self.format else "format line"
            raise FormatError("ply-bad-header", f"{self.where}: the header has no {missing}")
        elements = tuple(Element(name, count, tuple(props)) for name, count, props in self.elements)
        for element in elements:
            if element.count and not element.properties:
                raise FormatError(
                    "ply-empty-element",
                    f"{self.where}: {element.count} rows of element '{element.name}' hold no "
                    "properties, expected at least one",
                )
        return PlyHeader(self.format, elements, tuple(self.comments), data_offset)

    def statement(self, words: list[str]) -> None:
        """Parse a line that declares the format, an element or a property."""
        match words:
            case ["format", name, "1.0"] if name in _FORMATS and not self.format:
                self.format = name
            case ["element", name, count]:
                self.element(name, count)
            case ["property", "list", length, item, name] if (
                _TYPES.get(length, "f")[0] != "f" and item in _TYPES
            ):
                self.property(Property(name, _TYPES[item], _TYPES[length]))
            case ["property", dtype, name] if dtype in _TYPES:
                self.property(Property(name, _TYPES[dtype]))
            case _:
                self.refuse("ply-bad-header", "a format, element, property or comment")

    def element(self, name: str, count: str) -> None:
        """Add an element, after checking its count and its name."""
        if not re.fullmatch("[0-9]{1,10}", count) or int(count) > MAX_COUNT:
            self.refuse("ply-bad-count", f"a count from 0 to {MAX_COUNT}")
        if any(name == known for known, _, _ in self.elements):
            self.refuse("ply-duplicate-element", "each element once")
        self.elements.append((name, int(count), []))

    def property(self, new: Property) -> None:
        """Add a property to the last element."""
        if not self.elements:
            self.refuse("ply-bad-header", "an element before its properties")
        properties = self.elements[-1][2]
        if any(new.name == known.name for known in properties):
            self.refuse("ply-duplicate-property", "each property once")
        properties.append(new)

    def refuse(self, code: str, expected: str) -> None:
        """Raise a `FormatError` about the current line."""
        shown = self.line if len(self.line) <= 80 else self.line[:77] + "..."
        raise FormatError(
            code, f"{self.where}: header line {self.number} is {shown!r}, expected {expected}"
        )


def check_size(header: PlyHeader, size: int, where: str) -> None:
    """Check the size of a file against the element counts of its header.

    Parameters
    ----------
    header : PlyHeader
        The file's header.
    size : int
        Size of the file, bytes.
    where : str
        Name of the file for messages.

    Raises
    ------
    TruncatedError
        ``ply-truncated``: the file is too small for its rows.
    FormatError
        ``ply-trailing-bytes``: a binary file without lists has bytes behind its last row.
    """
    text = header.format == "ascii"
    needed = header.data_offset
    for element in header.elements:
        # A number in text takes at least a digit and a separator.
        stride = 2 * len(element.properties) if text else element.min_stride
        needed += element.count * stride
    counts = ", ".join(f"{element.count} {element.name}" for element in header.elements)
    # Subtract 1 for text: the last line may lack its line feed.
    if size < needed - text:
        raise TruncatedError(
            "ply-truncated",
            f"{where}: {size} bytes, expected at least {needed} for {counts}",
            offset=size,
            needed=needed,
        )
    if not text and size > needed and not any(element.has_lists for element in header.elements):
        raise FormatError(
            "ply-trailing-bytes",
            f"{where}: {size} bytes, expected {needed} for {counts}",
            offset=needed,
        )


# PLY properties of each array's columns, in order, under the names of 3DGS training.
_FIXED_FIELDS = {
    "means": ["x", "y", "z"],
    "scales": ["scale_0", "scale_1", "scale_2"],
    "quats": ["rot_0", "rot_1", "rot_2", "rot_3"],
    "opacities": ["opacity"],
    "sh0": ["f_dc_0", "f_dc_1", "f_dc_2"],
}
# Possible numbers of f_rest properties: 3 channels of (degree + 1)² - 1 coefficients.
_REST_COUNTS = (0, 9, 24, 45)


def splat_fields(rest_count: int) -> dict[str, list[str]]:
    """Return the PLY properties of each array of `Splats`, in the order of its flattened row.

    PLY stores f_rest channel by channel (all of red, then green, then blue), whereas `Splats.shN`
    is coefficient by coefficient.

    Parameters
    ----------
    rest_count : int
        Number of f_rest properties: 0, 9, 24 or 45.
    """
    per_channel = rest_count // 3
    rest = [f"f_rest_{c * per_channel + k}" for k in range(per_channel) for c in range(3)]
    return {**_FIXED_FIELDS, "shN": rest}


def match_fields(vertex: Element, where: str) -> dict[str, list[str]]:
    """Return `splat_fields` for a vertex element, after checking that it has every property.

    Raises
    ------
    FormatError
        ``ply-list-property``: the element has lists; ``ply-bad-sh``: the number of f_rest
        properties fits no SH degree; ``ply-missing-property``.
    """
    names = [prop.name for prop in vertex.properties]
    if vertex.has_lists:
        lists = ", ".join(prop.name for prop in vertex.properties if prop.length_dtype)
        raise FormatError(
            "ply-list-property", f"{where}: vertex holds the lists {lists}, expected plain numbers"
        )
    rest_count = sum(1 for name in names if re.fullmatch("f_rest_[0-9]+", name))
    if rest_count not in _REST_COUNTS:
        raise FormatError(
            "ply-bad-sh",
            f"{where}: vertex has {rest_count} f_rest properties, expected one of {_REST_COUNTS}",
        )
    fields = splat_fields(rest_count)
    found = set(names)
    missing = sorted({name for group in fields.values() for name in group} - found)
    if missing:
        others = ", ".join(names[:12]) or "none"
        raise FormatError(
            "ply-missing-property",
            f"{where}: vertex lacks {', '.join(missing)}; it has {others}"
            + (", ..." if len(names) > 12 else "")
            + "; expected the properties of a 3DGS scene",
        )
    return fields
