"""PLY headers: elements, their properties, and the properties that make up a splat."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import BinaryIO

from cogsplat.codec.errors import FormatError, TruncatedError

MAX_HEADER_BYTES = 65536
"""Longest header that is read; SH degree 3 takes about 1500 bytes."""

MAX_COUNT = 2**31 - 1
"""Largest element count, as the INT32 of the PLY description (Turk, 1994) allows."""

# The names of the PLY description, then those that later writers use; sizes in the numpy type.
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
        As in the header.
    dtype : str
        Type of the value, or of a list's items, as numpy writes it without byte order.
    length_dtype : str
        Type of a list's length; empty where the property is no list.
    """

    name: str
    dtype: str
    length_dtype: str = ""

    @property
    def min_bytes(self) -> int:
        """Smallest size of a value in a binary file, in bytes: a scalar, or an empty list."""
        return int((self.length_dtype or self.dtype)[1:])


@dataclass(frozen=True)
class Element:
    """An element of a PLY: `count` rows of its properties."""

    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def has_lists(self) -> bool:
        """Whether rows differ in length."""
        return any(prop.length_dtype for prop in self.properties)

    @property
    def min_stride(self) -> int:
        """Smallest size of a row in a binary file, in bytes; exact where there are no lists."""
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
        Text after the word ``comment``.
    data_offset : int
        Byte where the data begin.
    """

    format: str
    elements: tuple[Element, ...]
    comments: tuple[str, ...]
    data_offset: int

    @property
    def is_canonical(self) -> bool:
        """Whether the vertices come first, little-endian, all in rows of one length."""
        return (
            self.format == "binary_little_endian"
            and self.elements[0].name == "vertex"
            and not self.elements[0].has_lists
        )

    def vertex(self, where: str) -> Element:
        """Return the element that holds the splats, or raise ``ply-no-vertex``."""
        for element in self.elements:
            if element.name == "vertex":
                return element
        names = ", ".join(element.name for element in self.elements) or "none"
        raise FormatError(
            "ply-no-vertex", f"{where}: elements {names}, expected an element 'vertex'"
        )


def is_ply(head: bytes) -> bool:
    """Tell whether a file that starts with these bytes is a PLY."""
    return head.startswith((b"ply\n", b"ply\r\n"))


def read_header(file: BinaryIO, where: str) -> PlyHeader:
    """Read the header at the start of a file, at most `MAX_HEADER_BYTES`.

    Raises
    ------
    FormatError
        As in `parse_header`.
    """
    return parse_header(file.read(MAX_HEADER_BYTES), where)


def parse_header(head: bytes, where: str) -> PlyHeader:
    """Parse the header that these bytes start with.

    Parameters
    ----------
    head : bytes
        The file's first bytes: all of it, or `MAX_HEADER_BYTES`.
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
    # Comments may be in any encoding; names that matter are ASCII.
    lines = head[: end.start()].decode("utf-8", "replace").split("\n")
    return _Parser(where).parse([line.removesuffix("\r") for line in lines[1:]], end.end())


class _Parser:
    def __init__(self, where: str) -> None:
        self.where = where
        self.line = ""
        self.number = 1
        self.format = ""
        self.comments: list[str] = []
        self.elements: list[tuple[str, int, list[Property]]] = []

    def parse(self, lines: Sequence[str], data_offset: int) -> PlyHeader:
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
        if not re.fullmatch("[0-9]{1,10}", count) or int(count) > MAX_COUNT:
            self.refuse("ply-bad-count", f"a count from 0 to {MAX_COUNT}")
        if any(name == known for known, _, _ in self.elements):
            self.refuse("ply-duplicate-element", "each element once")
        self.elements.append((name, int(count), []))

    def property(self, new: Property) -> None:
        if not self.elements:
            self.refuse("ply-bad-header", "an element before its properties")
        properties = self.elements[-1][2]
        if any(new.name == known.name for known in properties):
            self.refuse("ply-duplicate-property", "each property once")
        properties.append(new)

    def refuse(self, code: str, expected: str) -> None:
        shown = self.line if len(self.line) <= 80 else self.line[:77] + "..."
        raise FormatError(
            code, f"{self.where}: header line {self.number} is {shown!r}, expected {expected}"
        )


def check_size(header: PlyHeader, size: int, where: str) -> None:
    """Check that a file of `size` bytes can hold the rows that its header counts.

    Raises
    ------
    TruncatedError
        ``ply-truncated``: it cannot.
    FormatError
        ``ply-trailing-bytes``: binary rows of fixed length end before the file does.
    """
    text = header.format == "ascii"
    needed = header.data_offset
    for element in header.elements:
        # A number in text takes a digit and a separator.
        stride = 2 * len(element.properties) if text else element.min_stride
        needed += element.count * stride
    counts = ", ".join(f"{element.count} {element.name}" for element in header.elements)
    # The last line of a text file may lack its line feed.
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


# Properties of one splat in the order of each array's row, as 3DGS training names them.
_FIXED_FIELDS = {
    "means": ["x", "y", "z"],
    "scales": ["scale_0", "scale_1", "scale_2"],
    "quats": ["rot_0", "rot_1", "rot_2", "rot_3"],
    "opacities": ["opacity"],
    "sh0": ["f_dc_0", "f_dc_1", "f_dc_2"],
}
# 3 channels of (degree + 1)² - 1 coefficients.
_REST_COUNTS = (0, 9, 24, 45)


def splat_fields(rest_count: int) -> dict[str, list[str]]:
    """Return, for each array of `Splats`, the properties of its flattened row, in order.

    The file holds f_rest channel by channel: all of red, all of green, all of blue.
    """
    per_channel = rest_count // 3
    rest = [f"f_rest_{c * per_channel + k}" for k in range(per_channel) for c in range(3)]
    return {**_FIXED_FIELDS, "shN": rest}


def match_fields(vertex: Element, where: str) -> dict[str, list[str]]:
    """Return `splat_fields` of a vertex element that has them all; others are left out.

    Raises
    ------
    FormatError
        ``ply-list-property``, ``ply-bad-sh``, ``ply-missing-property``.
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
