"""glTF 2.0 files: JSON, buffers, accessors, and the transforms of nodes.

Section numbers are those of the glTF 2.0 specification (Khronos, 2.0.1).
"""

from __future__ import annotations

import os
import struct
import urllib.parse
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError, TruncatedError, UnsupportedError
from cogsplat.formats.storage.atomic import StrPath, open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.magic import describe
from cogsplat.formats.storage.siblings import sibling
from cogsplat.formats.storage.strict_json import JsonObject, parse_object

from .embedded_buffers import Embedded, take_out

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

GLB_MAGIC: Final = b"glTF"
GLB_HEADER: Final = struct.Struct("<4sII")
GLB_CHUNK: Final = struct.Struct("<I4s")
JSON_CHUNK: Final = b"JSON"
BIN_CHUNK: Final = b"BIN\0"

BAD_JSON: Final = "gltf-bad-json"

MAX_TEXT_BYTES: Final = 1 << 28
"""Longest ``.gltf`` that is written, with the buffers inside it."""

_MAX_BUFFER_BYTES: Final = (1 << 53) - 1
_MAX_COUNT: Final = (1 << 31) - 1

# Section 3.6.2.2: numpy type of each component type, and what 1.0 is where it is normalised.
_COMPONENTS: Final = {
    5120: ("<i1", 127),
    5121: ("<u1", 255),
    5122: ("<i2", 32767),
    5123: ("<u2", 65535),
    5126: ("<f4", 0),
}
_WIDTHS: Final = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}

# What a reader may meet in extensionsRequired; integer attributes are read anyway.
_KNOWN_EXTENSIONS: Final = frozenset({"KHR_gaussian_splatting", "KHR_mesh_quantization"})


@dataclass(frozen=True)
class Gltf:
    """An open glTF file.

    Parameters
    ----------
    root : JsonObject
        The whole JSON.
    where : str
        Name of the file for messages.
    folder : Path
        Where files beside it lie.
    binary : memoryview or None
        The binary chunk of a GLB.
    embedded : Embedded
        Buffers inside the JSON.
    file_bytes : int
        Of the file, without those beside it.
    """

    root: JsonObject
    where: str
    folder: Path
    binary: memoryview | None
    embedded: Embedded
    file_bytes: int
    _buffers: dict[int, memoryview] = field(default_factory=dict)
    _items: dict[str, list[JsonObject]] = field(default_factory=dict)

    def items(self, key: str) -> list[JsonObject]:
        """Return a top-level array of objects."""
        if key not in self._items:
            self._items[key] = self.root.children(key)
        return self._items[key]

    def source_bytes(self) -> int:
        """Return the bytes of the file and of the buffers beside it, as far as they are there."""
        total = self.file_bytes
        for path in self.beside():
            with storage_errors(path):
                total += path.stat().st_size if path.exists() else 0
        return total

    def beside(self) -> list[Path]:
        """Return the files that buffers name, each once.

        Raises
        ------
        FormatError
            ``gltf-uri``: a name that leads out of the file's folder.
        """
        uris = [node.text("uri", "data:") for node in self.items("buffers")]
        return [
            sibling(self.folder, urllib.parse.unquote(uri), self.where, "gltf-uri")
            for uri in dict.fromkeys(uris)
            if not uri.startswith("data:")
        ]

    def count(self, index: int) -> int:
        """Return how many values an accessor says it has, before any is read."""
        return self._item("accessors", index).integer("count", 1, _MAX_COUNT)

    def accessor(self, index: int, kind: str, name: str) -> F32:
        """Return the values of an accessor.

        Parameters
        ----------
        index : int
            Checked against the file.
        kind : str
            ``SCALAR``, ``VEC3`` or ``VEC4``, which it must be.
        name : str
            Of the attribute, for messages.

        Returns
        -------
        (N, 1, 3 or 4) float32
            A copy; normalised integers as -1 to 1 or 0 to 1.

        Raises
        ------
        FormatError
            ``gltf-bad-accessor``; ``gltf-bad-json``.
        TruncatedError
            ``gltf-truncated``: a buffer is shorter than it says.
        UnsupportedError
            ``gltf-sparse``, ``gltf-compressed``, ``gltf-component-type``.
        StorageError
            As `open_for_read`, for a buffer in a file of its own.
        """
        node = self._item("accessors", index)
        where = f"{node.where} ({name})"
        if "sparse" in node:
            raise UnsupportedError("gltf-sparse", f"{where}: is sparse, expected plain values")
        if node.text("type") != kind:
            raise FormatError("gltf-bad-accessor", f"{where}: is {node.text('type')}, not {kind}")
        component = node.integer("componentType", 0, _MAX_COUNT)
        if component not in _COMPONENTS:
            raise UnsupportedError(
                "gltf-component-type",
                f"{where}: component type {component}, expected one of {sorted(_COMPONENTS)}",
            )
        code, one = _COMPONENTS[component]
        if "bufferView" not in node:
            raise UnsupportedError(
                "gltf-compressed",
                f"{where}: has no bufferView, expected its values as they are, not compressed",
            )
        data, stride = self._view(node.integer("bufferView", 0, _MAX_COUNT))
        values = _strided(
            data,
            np.dtype(code),
            (node.integer("count", 1, _MAX_COUNT), _WIDTHS[kind]),
            node.integer("byteOffset", 0, _MAX_BUFFER_BYTES, default=0),
            stride,
            where,
        )
        # A copy in any case: the file's bytes may lie at odd addresses, and are read-only.
        wide: F32 = np.array(values, np.float32, order="C")
        if one and node.boolean("normalized", False):
            # Section 3.6.2.2: the one more negative value is -1 as well.
            wide = np.maximum(wide / np.float32(one), np.float32(-1))
        return wide

    def _item(self, key: str, index: int) -> JsonObject:
        items = self.items(key)
        if not 0 <= index < len(items):
            raise FormatError(
                BAD_JSON, f"{self.where}: index {index} into {len(items)} {key}, expected less"
            )
        return items[index]

    def _view(self, index: int) -> tuple[memoryview, int]:
        """Return the bytes of a buffer view and its stride, 0 where values lie close together."""
        node = self._item("bufferViews", index)
        extensions = node.child("extensions") if "extensions" in node else None
        if extensions and any("compression" in name for name in extensions.values):
            raise UnsupportedError(
                "gltf-compressed",
                f"{node.where}: is compressed ({', '.join(extensions.values)}), expected it plain",
            )
        data = self._buffer(node.integer("buffer", 0, _MAX_COUNT))
        start = node.integer("byteOffset", 0, _MAX_BUFFER_BYTES, default=0)
        length = node.integer("byteLength", 1, _MAX_BUFFER_BYTES)
        if start + length > len(data):
            raise FormatError(
                "gltf-bad-accessor",
                f"{node.where}: bytes {start} to {start + length} of a buffer of {len(data)}",
            )
        stride = node.integer("byteStride", 4, 252, default=4) if "byteStride" in node else 0
        return data[start : start + length], stride

    def _buffer(self, index: int) -> memoryview:
        if index not in self._buffers:
            node = self._item("buffers", index)
            length = node.integer("byteLength", 1, _MAX_BUFFER_BYTES)
            data = self._load(node, length, is_first=index == 0)
            if len(data) < length:
                raise TruncatedError(
                    "gltf-truncated", f"{node.where}: {len(data)} bytes, expected {length}"
                )
            self._buffers[index] = data[:length]
        return self._buffers[index]

    def _load(self, node: JsonObject, length: int, *, is_first: bool) -> memoryview:
        if "uri" not in node:
            if self.binary is None or not is_first:
                raise FormatError(
                    "gltf-bad-buffer", f"{node.where}: has no uri, expected one or a binary chunk"
                )
            return self.binary
        uri = node.text("uri")
        if uri.startswith("data:"):
            return self.embedded.decode(uri, node.where)
        path = sibling(self.folder, urllib.parse.unquote(uri), node.where, "gltf-uri")
        with storage_errors(path), open_for_read(path) as file:
            # Never more than the file has, whatever the JSON says.
            size = os.fstat(file.fileno()).st_size
            return memoryview(file.read(min(length, size)))


def gltf_files(path: StrPath) -> list[Path]:
    """Return the files that a scene consists of: a ``.glb`` or ``.gltf``, and buffers beside it.

    Raises
    ------
    FormatError, LimitError, StorageError, TruncatedError, UnsupportedError
        As `open_gltf`; ``gltf-uri``.
    """
    return [Path(path), *open_gltf(path).beside()]


def _strided(
    data: memoryview,
    dtype: np.dtype[np.generic],
    shape: tuple[int, int],
    offset: int,
    stride: int,
    where: str,
) -> NDArray[np.generic]:
    """Return a view of values, or raise where they leave their buffer view."""
    count, width = shape
    element = width * dtype.itemsize
    stride = stride or element
    end = offset + stride * (count - 1) + element
    if stride < element or end > len(data):
        raise FormatError(
            "gltf-bad-accessor",
            f"{where}: {count} values of {element} bytes every {stride} from byte {offset}, "
            f"expected them inside {len(data)} bytes and apart",
        )
    return np.ndarray(shape, dtype, data, offset, (stride, dtype.itemsize))


def open_gltf(path: StrPath, *, limits: Limits | None = None) -> Gltf:
    """Read a ``.glb`` or ``.gltf``, without the files beside it.

    Parameters
    ----------
    path : path
    limits : Limits, optional
        What the parsed JSON may take.

    Raises
    ------
    FormatError
        ``gltf-magic``, ``gltf-bad-glb``, ``gltf-bad-json``.
    TruncatedError
        ``gltf-truncated``.
    UnsupportedError
        ``gltf-version``; ``gltf-extension`` or ``gltf-compressed``: the file requires one that is
        not read.
    LimitError
        ``json-too-long``.
    StorageError
        As `open_for_read`.
    """
    where = os.fspath(path)
    with storage_errors(path), open_for_read(path) as file:
        data = file.read()
    if data.startswith(GLB_MAGIC):
        _check_header(data[: GLB_HEADER.size], len(data), where)
        chunk, binary = _chunks(memoryview(data), where)
        embedded = take_out(bytes(chunk))
    else:
        if data.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] != b"{":
            raise FormatError(
                "gltf-magic", f"{where}: is {describe(data[:64])}, expected a .glb or .gltf"
            )
        embedded, binary = take_out(data), None
    root = parse_object(embedded.text, where, BAD_JSON, limits=limits)
    version = root.child("asset").text("version")
    if not version.startswith("2."):
        raise UnsupportedError("gltf-version", f"{where}: glTF {version[:20]!r}, expected 2.x")
    _check_extensions(root, where)
    return Gltf(root, where, Path(path).parent, binary, embedded, len(data))


def _check_header(head: bytes, size: int, where: str) -> None:
    """Check the 12 bytes of a GLB header (section 4.4.2) against the file's size."""
    if len(head) < GLB_HEADER.size:
        raise TruncatedError("gltf-truncated", f"{where}: ends in its header, expected 12 bytes")
    _, version, length = GLB_HEADER.unpack(head)
    if version != 2:
        raise UnsupportedError("gltf-version", f"{where}: GLB version {version}, expected 2")
    if size < length:
        raise TruncatedError(
            "gltf-truncated", f"{where}: {size} bytes, expected {length}", needed=length
        )
    if size > length:
        raise FormatError(
            "gltf-bad-glb", f"{where}: {size} bytes, expected {length}", offset=length
        )


def _chunks(data: memoryview, where: str) -> tuple[memoryview, memoryview | None]:
    """Return the JSON and the binary chunk of a GLB (section 4.4.3)."""
    chunks: list[tuple[bytes, memoryview]] = []
    offset = GLB_HEADER.size
    # What lies behind the two is for others.
    while offset < len(data) and len(chunks) < 2:
        if offset + GLB_CHUNK.size > len(data):
            raise TruncatedError("gltf-truncated", f"{where}: ends in a chunk's header")
        length, kind = GLB_CHUNK.unpack_from(data, offset)
        offset += GLB_CHUNK.size
        if offset + length > len(data):
            raise TruncatedError(
                "gltf-truncated", f"{where}: a chunk of {length} bytes at {offset} leaves the file"
            )
        chunks.append((kind, data[offset : offset + length]))
        offset += length
    if not chunks or chunks[0][0] != JSON_CHUNK:
        raise FormatError("gltf-bad-glb", f"{where}: expected JSON as its first chunk")
    binary = chunks[1][1] if len(chunks) == 2 and chunks[1][0] == BIN_CHUNK else None
    return chunks[0][1], binary


def _check_extensions(root: JsonObject, where: str) -> None:
    required = set(root.texts("extensionsRequired")) - _KNOWN_EXTENSIONS
    if required:
        compressed = any("compression" in name for name in required)
        raise UnsupportedError(
            "gltf-compressed" if compressed else "gltf-extension",
            f"{where}: requires {', '.join(sorted(required)[:6])[:200]}, expected nothing but "
            f"{', '.join(sorted(_KNOWN_EXTENSIONS))}",
        )


def instances(gltf: Gltf) -> Iterator[tuple[int, F64]]:
    """Yield every mesh of the scene with the transform from its node to the world.

    The default scene counts, the first where none is named, all nodes where there is no scene.

    Yields
    ------
    mesh : int
        Index, not checked.
    matrix : (4, 4) float64
        Local to world.

    Raises
    ------
    FormatError
        ``gltf-bad-json``; ``gltf-node-tree``: a node reached twice; ``gltf-bad-transform``.
    """
    nodes, scenes = gltf.items("nodes"), gltf.items("scenes")
    children = [node.integers("children", 0, len(nodes) - 1) for node in nodes]
    if scenes:
        scene = scenes[gltf.root.integer("scene", 0, len(scenes) - 1, default=0)]
        roots = scene.integers("nodes", 0, len(nodes) - 1)
    else:
        below = {child for group in children for child in group}
        roots = [index for index in range(len(nodes)) if index not in below]
    waiting = [(index, np.eye(4)) for index in reversed(roots)]
    seen: set[int] = set()
    while waiting:
        index, outer = waiting.pop()
        node = nodes[index]
        if index in seen:
            raise FormatError(
                "gltf-node-tree", f"{node.where}: reached twice, expected nodes to form trees"
            )
        seen.add(index)
        with np.errstate(over="ignore", invalid="ignore"):
            matrix = outer @ _local_matrix(node)
        if not np.isfinite(matrix).all():
            raise FormatError("gltf-bad-transform", f"{node.where}: leaves the range of numbers")
        if "mesh" in node:
            yield node.integer("mesh", 0, _MAX_COUNT), matrix
        waiting += [(child, matrix) for child in reversed(children[index])]


def _local_matrix(node: JsonObject) -> F64:
    """Return a node's transform (section 3.5.3): a matrix by columns, or T·R·S."""
    if "matrix" in node:
        return np.array(node.numbers("matrix", 16)).reshape(4, 4).T
    matrix = np.eye(4)
    if "rotation" in node:
        x, y, z, w = node.numbers("rotation", 4)
        norm = x * x + y * y + z * z + w * w
        if not norm > 0:
            raise FormatError("gltf-bad-transform", f"{node.where}: has a quaternion of zeros")
        s = 2 / norm
        matrix[:3, :3] = [
            [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
            [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
            [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
        ]
    if "scale" in node:
        matrix[:3, :3] *= node.numbers("scale", 3)
    if "translation" in node:
        matrix[:3, 3] = node.numbers("translation", 3)
    return matrix
