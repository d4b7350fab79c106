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
from cogsplat.formats.storage.atomic import StrPath, exists, open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.magic import describe
from cogsplat.formats.storage.siblings import sibling
from cogsplat.formats.storage.strict_json import JsonObject, parse_object

from .embedded_buffers import EmbeddedBuffers, extract_buffers

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

GLB_MAGIC: Final = b"glTF"
GLB_HEADER: Final = struct.Struct("<4sII")
GLB_CHUNK: Final = struct.Struct("<I4s")
JSON_CHUNK: Final = b"JSON"
BIN_CHUNK: Final = b"BIN\0"

BAD_JSON: Final = "gltf-bad-json"

MAX_TEXT_BYTES: Final = 1 << 28
"""Size limit for writing a ``.gltf``, including its embedded buffers, bytes."""

_MAX_BUFFER_BYTES: Final = (1 << 53) - 1
_MAX_COUNT: Final = (1 << 31) - 1

# Section 3.6.2.2: numpy type of each component type, and the integer that is 1.0 if normalised.
_COMPONENTS: Final = {
    5120: ("<i1", 127),
    5121: ("<u1", 255),
    5122: ("<i2", 32767),
    5123: ("<u2", 65535),
    5126: ("<f4", 0),
}
_WIDTHS: Final = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}

# Longest credits of a description, bytes (SPEC 5.13).
_MAX_COPYRIGHT_BYTES: Final = 1024

# Values of extensionsRequired that are accepted; KHR_mesh_quantization allows integer attributes.
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
        Folder of the file, to which buffers' URIs are relative.
    binary : memoryview or None
        The binary chunk of a GLB.
    embedded : EmbeddedBuffers
        Buffers inside the JSON.
    file_bytes : int
        Size of the file without external buffers, bytes.
    """

    root: JsonObject
    where: str
    folder: Path
    binary: memoryview | None
    embedded: EmbeddedBuffers
    file_bytes: int
    _buffers: dict[int, memoryview] = field(default_factory=dict)
    _items: dict[str, list[JsonObject]] = field(default_factory=dict)

    def items(self, key: str) -> list[JsonObject]:
        """Return the objects of a top-level array, e.g. ``"nodes"``; parsed once."""
        if key not in self._items:
            self._items[key] = self.root.children(key)
        return self._items[key]

    def source_bytes(self) -> int:
        """Return the size of the file and of its existing external buffers, bytes."""
        total = self.file_bytes
        for path in self.external_files():
            with storage_errors(path):
                total += path.stat().st_size if exists(path) else 0
        return total

    def external_files(self) -> list[Path]:
        """Return the paths of the external buffers, each once.

        Raises
        ------
        FormatError
            ``gltf-uri``: a path lies outside the file's folder.
        """
        uris = [node.text("uri", "data:") for node in self.items("buffers")]
        return [
            sibling(self.folder, urllib.parse.unquote(uri), self.where, "gltf-uri")
            for uri in dict.fromkeys(uris)
            if not uri.startswith("data:")
        ]

    def count(self, index: int) -> int:
        """Return an accessor's declared number of values, without reading the values."""
        return self._item("accessors", index).integer("count", 1, _MAX_COUNT)

    def accessor(self, index: int, kind: str, name: str) -> F32:
        """Return the values of an accessor.

        Parameters
        ----------
        index : int
            Index of the accessor; checked against the file.
        kind : str
            Expected type of the accessor: ``SCALAR``, ``VEC3`` or ``VEC4``.
        name : str
            Name of the attribute for messages.

        Returns
        -------
        (N, 1, 3 or 4) float32
            A copy of the values; normalised integers are scaled to -1 to 1 or 0 to 1.

        Raises
        ------
        FormatError
            ``gltf-bad-accessor``; ``gltf-bad-json``.
        TruncatedError
            ``gltf-truncated``: a buffer is shorter than its declared length.
        UnsupportedError
            ``gltf-sparse``, ``gltf-compressed``, ``gltf-component-type``.
        StorageError
            An external buffer cannot be read; see `open_for_read`.
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
                f"{where}: has no bufferView, expected uncompressed values",
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
        # Always a copy: the file's bytes are read-only and may be unaligned.
        wide: F32 = np.array(values, np.float32, order="C")
        if one and node.boolean("normalized", False):
            # Section 3.6.2.2: the most negative integer is -1, too.
            wide = np.maximum(wide / np.float32(one), np.float32(-1))
        return wide

    def _item(self, key: str, index: int) -> JsonObject:
        """Return an object of a top-level array, after checking its index."""
        items = self.items(key)
        if not 0 <= index < len(items):
            raise FormatError(
                BAD_JSON, f"{self.where}: index {index} into {len(items)} {key}, expected less"
            )
        return items[index]

    def _view(self, index: int) -> tuple[memoryview, int]:
        """Return the bytes of a buffer view and its stride, 0 for tightly packed values."""
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
        """Return the bytes of a buffer; loaded once."""
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
        """Load a buffer from the binary chunk, from a data URI, or from an external file."""
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
            # Read at most the file's size, even if the JSON declares a larger length.
            size = os.fstat(file.fileno()).st_size
            return memoryview(file.read(min(length, size)))


def gltf_files(path: StrPath) -> list[Path]:
    """Return the paths of a scene's files: the ``.glb`` or ``.gltf``, and its external buffers.

    Raises
    ------
    FormatError, LimitError, StorageError, TruncatedError, UnsupportedError
        See `open_gltf`; ``gltf-uri``.
    """
    return [Path(path), *open_gltf(path).external_files()]


def _strided(
    data: memoryview,
    dtype: np.dtype[np.generic],
    shape: tuple[int, int],
    offset: int,
    stride: int,
    where: str,
) -> NDArray[np.generic]:
    """Return a view of strided values, or raise if they exceed their buffer view."""
    count, width = shape
    element = width * dtype.itemsize
    stride = stride or element
    end = offset + stride * (count - 1) + element
    if stride < element or end > len(data):
        raise FormatError(
            "gltf-bad-accessor",
            f"{where}: {count} values of {element} bytes every {stride} from byte {offset}, "
            f"expected no overlap and an end within {len(data)} bytes",
        )
    return np.ndarray(shape, dtype, data, offset, (stride, dtype.itemsize))


def open_gltf(path: StrPath, *, limits: Limits | None = None) -> Gltf:
    """Open a ``.glb`` or ``.gltf`` and parse its JSON, without reading external buffers.

    Parameters
    ----------
    path : path
        The file.
    limits : Limits, optional
        Limits on the JSON's size.

    Raises
    ------
    FormatError
        ``gltf-magic``, ``gltf-bad-glb``, ``gltf-bad-json``.
    TruncatedError
        ``gltf-truncated``.
    UnsupportedError
        ``gltf-version``; ``gltf-extension`` or ``gltf-compressed``: the file requires an
        unsupported extension.
    LimitError
        ``json-too-long``.
    StorageError
        See `open_for_read`.
    """
    where = os.fspath(path)
    with storage_errors(path), open_for_read(path) as file:
        data = file.read()
    if data.startswith(GLB_MAGIC):
        _check_header(data[: GLB_HEADER.size], len(data), where)
        chunk, binary = _chunks(memoryview(data), where)
        embedded = extract_buffers(bytes(chunk))
    else:
        if data.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] != b"{":
            raise FormatError(
                "gltf-magic", f"{where}: is {describe(data[:64])}, expected a .glb or .gltf"
            )
        embedded, binary = extract_buffers(data), None
    root = parse_object(embedded.text, where, BAD_JSON, limits=limits)
    version = root.child("asset").text("version")
    if not version.startswith("2."):
        raise UnsupportedError("gltf-version", f"{where}: glTF {version[:20]!r}, expected 2.x")
    _check_extensions(root, where)
    return Gltf(root, where, Path(path).parent, binary, embedded, len(data))


def read_copyright(path: StrPath, *, limits: Limits | None = None) -> str:
    """Return the copyright of a glTF asset as a text of SPEC 5.13; empty for none.

    Control characters become spaces, and a text of more than 1,024 bytes is cut.

    Raises
    ------
    CogsplatError
        See `open_gltf`.
    """
    text = open_gltf(path, limits=limits).root.child("asset").text("copyright", "")
    plain = "".join(letter if letter.isprintable() else " " for letter in text).strip()
    return plain.encode()[:_MAX_COPYRIGHT_BYTES].decode(errors="ignore")


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
    # Further chunks belong to extensions (section 4.4.3) and are ignored.
    while offset < len(data) and len(chunks) < 2:
        if offset + GLB_CHUNK.size > len(data):
            raise TruncatedError("gltf-truncated", f"{where}: ends in a chunk's header")
        length, kind = GLB_CHUNK.unpack_from(data, offset)
        offset += GLB_CHUNK.size
        if offset + length > len(data):
            raise TruncatedError(
                "gltf-truncated",
                f"{where}: a chunk of {length} bytes at {offset} exceeds the file",
            )
        chunks.append((kind, data[offset : offset + length]))
        offset += length
    if not chunks or chunks[0][0] != JSON_CHUNK:
        raise FormatError("gltf-bad-glb", f"{where}: expected JSON as its first chunk")
    binary = chunks[1][1] if len(chunks) == 2 and chunks[1][0] == BIN_CHUNK else None
    return chunks[0][1], binary


def _check_extensions(root: JsonObject, where: str) -> None:
    """Raise `UnsupportedError` if the file requires an unknown extension."""
    required = set(root.texts("extensionsRequired")) - _KNOWN_EXTENSIONS
    if required:
        compressed = any("compression" in name for name in required)
        raise UnsupportedError(
            "gltf-compressed" if compressed else "gltf-extension",
            f"{where}: requires {', '.join(sorted(required)[:6])[:200]}, expected at most "
            f"{', '.join(sorted(_KNOWN_EXTENSIONS))}",
        )


def instances(gltf: Gltf) -> Iterator[tuple[int, F64]]:
    """Yield the meshes of the scene, each with its transform from local to world coordinates.

    The nodes come from the default scene, or from the first scene if there is no default. A file
    without scenes shows all of its nodes.

    Yields
    ------
    mesh : int
        Index of the mesh, unchecked.
    matrix : (4, 4) float64
        Transform from local to world coordinates.

    Raises
    ------
    FormatError
        ``gltf-bad-json``; ``gltf-node-tree``: two paths lead to a node; ``gltf-bad-transform``.
    """
    nodes, scenes = gltf.items("nodes"), gltf.items("scenes")
    children = [node.integers("children", 0, len(nodes) - 1) for node in nodes]
    if scenes:
        scene = scenes[gltf.root.integer("scene", 0, len(scenes) - 1, default=0)]
        roots = scene.integers("nodes", 0, len(nodes) - 1)
    else:
        below = {child for group in children for child in group}
        roots = [index for index in range(len(nodes)) if index not in below]
    stack = [(index, np.eye(4)) for index in reversed(roots)]
    seen: set[int] = set()
    while stack:
        index, outer = stack.pop()
        node = nodes[index]
        if index in seen:
            raise FormatError(
                "gltf-node-tree", f"{node.where}: reached twice, expected nodes to form trees"
            )
        seen.add(index)
        with np.errstate(over="ignore", invalid="ignore"):
            matrix = outer @ _local_matrix(node)
        if not np.isfinite(matrix).all():
            raise FormatError(
                "gltf-bad-transform", f"{node.where}: its transform overflows, expected finite"
            )
        if "mesh" in node:
            yield node.integer("mesh", 0, _MAX_COUNT), matrix
        stack += [(child, matrix) for child in reversed(children[index])]


def _local_matrix(node: JsonObject) -> F64:
    """Return a node's local transform (section 3.5.3): its column-major matrix, or T·R·S."""
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
