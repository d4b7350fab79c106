"""Reader and writer of glTF with KHR_gaussian_splatting: splats as point primitives.

Source: the extension as ratified by Khronos in 2026 (github.com/KhronosGroup/glTF). Scales are
linear, opacities 0 to 1, SH coefficients as in 3DGS. glTF's axes are x left, y up, z front (glTF
2.0, section 3.4), "LUF" here: the axes of PLY rotated by 180 degrees about z.
"""

from __future__ import annotations

import base64
import json
import os
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import (
    CogsplatWarning,
    DataError,
    FormatError,
    LimitError,
    UnsupportedError,
)
from cogsplat.codec.geometry.rotations import unit
from cogsplat.codec.geometry.sh import C0, COLOUR_OFFSET
from cogsplat.codec.geometry.transforms import convert_axes, transform
from cogsplat.codec.splats import MAX_SH_DEGREE, SceneInfo, Splats, concatenate, sh_coefficients
from cogsplat.formats.scenes.dropped_values import dropped_extras, dropped_info, warn_dropped
from cogsplat.formats.scenes.quantised_values import opacity_bytes, opacity_logits, unit_opacities
from cogsplat.formats.storage.atomic import StrPath, atomic_write
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.strict_json import JsonObject

from .file import (
    BIN_CHUNK,
    GLB_CHUNK,
    GLB_HEADER,
    GLB_MAGIC,
    JSON_CHUNK,
    MAX_TEXT_BYTES,
    Gltf,
    instances,
    open_gltf,
)

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

GLTF_AXES: Final = "LUF"

_AXES: Final = "RDF"
_EXTENSION: Final = "KHR_gaussian_splatting"
_POINTS: Final = 0
_TRIANGLES: Final = 4
_COLOUR_SPACES: Final = {"srgb_rec709_display": "srgb", "lin_rec709_display": "linear"}

# Limit on primitives in the scene; exporters write far fewer.
_MAX_PRIMITIVES: Final = 1 << 12

# Copies of the scene in memory at the peak: as read, transformed, concatenated, and in our axes.
_COPIES: Final = 4

# Limit on the splats of all instances, as a multiple of the distinct splats. Scans have 1; a small
# file with many instances would exhaust memory.
_MAX_REPEATS: Final = 16

# Relative tolerance for the lengths of a node's axes, which JSON rounds.
_SIMILARITY_TOLERANCE: Final = 1e-4

# Tolerance for opacities outside 0 to 1, from rounding.
_OPACITY_TOLERANCE: Final = 1e-5

_SMALLEST_SCALE: Final = float(np.finfo(np.float32).tiny)
_LARGEST_SCALE: Final = float(np.finfo(np.float32).max)

_MAX_DOCUMENT_BYTES: Final = 1 << 14
_MAX_GLB_BYTES: Final = (1 << 32) - 1

# Section 3.6.2.2, and WebGL's ARRAY_BUFFER.
_UNSIGNED_BYTE: Final = 5121
_FLOAT: Final = 5126
_ARRAY_BUFFER: Final = 34962


def is_gltf(head: bytes) -> bool:
    """Return whether a file that begins with `head` is a GLB, or a glTF with splats."""
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    return head.startswith(GLB_MAGIC) or (start == b"{" and _EXTENSION.encode() in head)


def read_gltf(path: StrPath, *, limits: Limits | None = None) -> Splats:
    """Read all splats of a glTF scene.

    Parameters
    ----------
    path : path
        A ``.glb``, or a ``.gltf`` with embedded or external buffers. Attributes may be floats or
        integers. Primitives without splats are skipped.
    limits : Limits, optional
        Limits on splats and decoded bytes.

    Returns
    -------
    Splats
        Splats of all primitives in RDF, the axes of PLY, with nodes' transforms applied, at the
        highest SH degree of any primitive. Opacity 1 is a logit of +inf, 0 of -inf.

    Raises
    ------
    FormatError
        ``gltf-`` followed by ``no-splats``, ``mode``, ``missing-attribute``, ``bad-sh``, ``count``,
        ``bad-opacity``; other codes as in `open_gltf`, `Gltf.accessor`, `instances`.
    TruncatedError
        ``gltf-truncated``.
    UnsupportedError
        ``gltf-`` followed by ``spz``, ``compressed``, ``extension``, ``kernel``, ``colour-space``,
        ``projection``, ``shear``, ``sparse``, ``component-type``, ``uri``, ``version``.
    LimitError
        ``gltf-too-many-instances``; ``json-too-long``; ``decoded-size``, ``too-many-splats``.
    StorageError
        See `open_for_read`.

    Warns
    -----
    CogsplatWarning
        Scales are negative, and so read as logarithms, which drafts of the extension stored.

    Notes
    -----
    Counts are checked against the buffers' sizes before any allocation.
    """
    limits = limits or Limits()
    gltf = open_gltf(path, limits=limits)
    placed = _placed_primitives(gltf)
    if not placed:
        raise FormatError(
            "gltf-no-splats", f"{gltf.where}: no primitive with {_EXTENSION}, expected one"
        )
    _check_cost(gltf, [node for node, _ in placed], limits)
    read: dict[int, Splats] = {}
    for node, _ in placed:
        if id(node.values) not in read:
            read[id(node.values)] = _read_primitive(gltf, node)
    spaces = {splats.info.colour_space for splats in read.values()}
    if len(spaces) > 1:
        raise UnsupportedError(
            "gltf-colour-space", f"{gltf.where}: splats in several colour spaces, expected one"
        )
    degree = max(splats.sh_degree for splats in read.values())
    parts = [
        _transformed(_with_degree(read[id(node.values)], degree), matrix, node.where)
        for node, matrix in placed
    ]
    return convert_axes(concatenate(parts) if len(parts) > 1 else parts[0], _AXES)


def _check_cost(gltf: Gltf, placed: list[JsonObject], limits: Limits) -> None:
    """Check the splats and bytes of all primitives against the limits, before reading any."""
    counts: dict[int, int] = {}
    total = degree = 0
    for node in placed:
        attributes = node.child("attributes")
        degree = max(degree, _sh_degree(attributes))
        index = _accessor_index(attributes, "POSITION")
        # Primitives with the same positions are instances of the same splats.
        if index not in counts:
            counts[index] = gltf.count(index)
        total += counts[index]
    distinct = sum(counts.values())
    if total > _MAX_REPEATS * distinct:
        raise LimitError(
            "gltf-too-many-instances",
            f"{gltf.where}: {total} splats in the instances of {distinct}, expected at most "
            f"{_MAX_REPEATS} times the distinct splats",
        )
    limits.require_scene(
        total,
        sh_degree=degree,
        source_bytes=gltf.source_bytes(),
        where=gltf.where,
        copies=_COPIES,
    )


def _placed_primitives(gltf: Gltf) -> list[tuple[JsonObject, F64]]:
    """Return the scene's primitives with splats, each with its local-to-world transform."""
    meshes = gltf.items("meshes")
    primitives: dict[int, list[JsonObject]] = {}
    placed: list[tuple[JsonObject, F64]] = []
    for mesh, matrix in instances(gltf):
        if mesh >= len(meshes):
            raise FormatError(
                "gltf-bad-json", f"{gltf.where}: a node names mesh {mesh}, expected {len(meshes)}"
            )
        if mesh not in primitives:
            primitives[mesh] = [
                node
                for node in meshes[mesh].children("primitives")
                if "extensions" in node and _EXTENSION in node.child("extensions")
            ]
        placed += [(node, matrix) for node in primitives[mesh]]
        if len(placed) > _MAX_PRIMITIVES:
            raise LimitError(
                "gltf-too-many-instances",
                f"{gltf.where}: more than {_MAX_PRIMITIVES} primitives of splats, expected fewer",
            )
    return placed


def _read_primitive(gltf: Gltf, node: JsonObject) -> Splats:
    """Return the splats of a primitive in glTF's axes and local coordinates."""
    colour_space = _check_extension(node)
    if node.integer("mode", 0, 6, default=_TRIANGLES) != _POINTS:
        raise FormatError("gltf-mode", f"{node.where}: mode is not {_POINTS}, expected points")
    attributes = node.child("attributes")
    degree = _sh_degree(attributes)
    means = _attribute(gltf, attributes, "POSITION", "VEC3", None)
    count = len(means)
    quats = _attribute(gltf, attributes, f"{_EXTENSION}:ROTATION", "VEC4", count)
    scales = _attribute(gltf, attributes, f"{_EXTENSION}:SCALE", "VEC3", count)
    opacities_unit = _attribute(gltf, attributes, f"{_EXTENSION}:OPACITY", "SCALAR", count)
    sh0 = _attribute(gltf, attributes, _sh_name(0, 0), "VEC3", count)
    shN = np.empty((count, sh_coefficients(degree) - 1, 3), np.float32)
    for k, (band, index) in enumerate(_sh_band_indices(degree)):
        shN[:, k] = _attribute(gltf, attributes, _sh_name(band, index), "VEC3", count)
    return Splats(
        means=means,
        scales=_log_scales(scales, node.where),
        quats=np.roll(quats, 1, axis=1),
        opacities=_logits(opacities_unit[:, 0], node.where),
        sh0=sh0,
        shN=shN,
        info=SceneInfo(axes=GLTF_AXES, colour_space=colour_space),
    )


# Reason codes of unsupported values in the extension.
_VALUE_CODES: Final = {"kernel": "gltf-kernel", "projection": "gltf-projection"}


def _check_extension(node: JsonObject) -> str:
    """Return the extension's colour space, or raise if its splats are of an unsupported kind."""
    extension = node.child("extensions").child(_EXTENSION)
    inner = list(extension.child("extensions").values) if "extensions" in extension else []
    if inner:
        spz = any("spz" in name.lower() for name in inner)
        raise UnsupportedError(
            "gltf-spz" if spz else "gltf-extension",
            f"{extension.where}: extended by {', '.join(inner[:4])[:200]}, expected the plain "
            "extension" + (" (its SPZ can be extracted and read)" if spz else ""),
        )
    for key, known in (("kernel", "ellipse"), ("projection", "perspective")):
        if extension.text(key, known) != known:
            raise UnsupportedError(
                _VALUE_CODES[key],
                f"{extension.where}: {key} {extension.text(key)!r}, expected {known}",
            )
    colour_space = extension.text("colorSpace", "srgb_rec709_display")
    if colour_space not in _COLOUR_SPACES:
        raise UnsupportedError(
            "gltf-colour-space",
            f"{extension.where}: colour space {colour_space[:60]!r}, expected "
            f"{' or '.join(_COLOUR_SPACES)}",
        )
    return _COLOUR_SPACES[colour_space]


def _sh_name(band: int, index: int) -> str:
    """Return the attribute name of an SH coefficient, given by band and index within the band."""
    return f"{_EXTENSION}:SH_DEGREE_{band}_COEF_{index}"


def _sh_band_indices(degree: int) -> Iterator[tuple[int, int]]:
    """Yield the band, and the index within the band, of each SH coefficient above DC."""
    for band in range(1, degree + 1):
        for index in range(2 * band + 1):
            yield band, index


def _sh_degree(attributes: JsonObject) -> int:
    """Return the SH degree of a primitive, after checking that all coefficients exist."""
    names = {name for name in attributes.values if name.startswith(f"{_EXTENSION}:SH_DEGREE_")}
    for degree in range(MAX_SH_DEGREE + 1):
        if names == {_sh_name(0, 0), *(_sh_name(*pair) for pair in _sh_band_indices(degree))}:
            return degree
    bands = {int(m[1]) for m in (re.search("_DEGREE_([0-9]{1,3})_", name) for name in names) if m}
    raise FormatError(
        "gltf-bad-sh" if names else "gltf-missing-attribute",
        f"{attributes.where}: {len(names)} SH attributes of the bands {sorted(bands)}, expected "
        f"all {' or '.join(str(sh_coefficients(d)) for d in range(MAX_SH_DEGREE + 1))} of a degree",
    )


def _accessor_index(attributes: JsonObject, name: str) -> int:
    """Return the index of an attribute's accessor, or raise ``gltf-missing-attribute``."""
    if name not in attributes:
        raise FormatError(
            "gltf-missing-attribute",
            f"{attributes.where}: no {name}, expected it next to "
            f"{', '.join(list(attributes.values)[:8])[:300]}",
        )
    return attributes.integer(name, 0, (1 << 31) - 1)


def _attribute(gltf: Gltf, attributes: JsonObject, name: str, kind: str, count: int | None) -> F32:
    """Return an attribute's values, after checking their number against `count`."""
    values = gltf.accessor(_accessor_index(attributes, name), kind, name)
    if count is not None and len(values) != count:
        raise FormatError(
            "gltf-count", f"{attributes.where}: {len(values)} values of {name}, expected {count}"
        )
    return values


def _log_scales(scales: F32, where: str) -> F32:
    """Return log scales of linear scales, or of the log scales of drafts of the extension."""
    if (scales < 0).any():
        warnings.warn(
            f"{where}: negative scales, as drafts of {_EXTENSION} wrote: read as logarithms",
            CogsplatWarning,
            stacklevel=4,
        )
        return scales
    # Scales of zero are legal in glTF, so clip them before the logarithm. Rows with NaN are kept.
    with np.errstate(invalid="ignore"):
        logs: F32 = np.log(np.maximum(scales, np.float32(_SMALLEST_SCALE)))
    return logs


def _logits(opacities_unit: F32, where: str) -> F32:
    """Return the logits of opacities, or raise ``gltf-bad-opacity``."""
    outside = np.abs(opacities_unit - np.float32(0.5)) > 0.5 + _OPACITY_TOLERANCE
    if outside.any():
        raise FormatError(
            "gltf-bad-opacity",
            f"{where}: splat {int(outside.argmax())} has the opacity "
            f"{opacities_unit[outside.argmax()]}, expected 0 to 1",
        )
    return opacity_logits(opacities_unit.clip(0, 1))


def _with_degree(splats: Splats, degree: int) -> Splats:
    """Return a scene padded with zero SH coefficients to a degree."""
    missing = sh_coefficients(degree) - 1 - splats.shN.shape[1]
    return replace(splats, shN=np.pad(splats.shN, ((0, 0), (0, missing), (0, 0))))


def _transformed(splats: Splats, matrix: F64, where: str) -> Splats:
    """Return splats transformed by a node's matrix, which must be a similarity transform."""
    if np.array_equal(matrix, np.eye(4)):
        return splats
    largest = float(np.abs(matrix[:3, :3]).max())
    # Normalise first: the determinant of very large or small axes over- or underflows.
    linear = matrix[:3, :3] / largest if largest > 0 else matrix[:3, :3]
    if np.linalg.det(linear) < 0:
        # A mirroring: flip x of the splats, and apply the rest as a rotation.
        mirrored = convert_axes(splats, "R" + GLTF_AXES[1:])
        splats = replace(mirrored, info=splats.info)
        linear = linear * np.array([-1.0, 1.0, 1.0])
    left, lengths, right = np.linalg.svd(linear)
    longest, shortest = float(lengths[0]), float(lengths[2])
    if not longest > 0 or longest - shortest > _SIMILARITY_TOLERANCE * longest:
        raise UnsupportedError(
            "gltf-shear",
            f"{where}: its node scales axes by {largest * shortest:g} to "
            f"{largest * longest:g}, expected one factor",
        )
    scale = largest * float(lengths.mean())
    x, y, z = (float(value) for value in matrix[:3, 3])
    if not (
        _SMALLEST_SCALE <= scale <= _LARGEST_SCALE and max(abs(x), abs(y), abs(z)) <= _LARGEST_SCALE
    ):
        raise FormatError(
            "gltf-bad-transform",
            f"{where}: its node scales by {scale:g} and moves by ({x:g}, {y:g}, {z:g}), expected "
            "values within float32",
        )
    return transform(splats, scale, left @ right, (x, y, z))


def write_gltf(splats: Splats, path: StrPath, *, force: bool = False) -> None:
    """Write a scene as glTF with KHR_gaussian_splatting, atomically.

    Parameters
    ----------
    splats : Splats
        Scene with at least one splat, stored as floats in the same row order. ``COLOR_0`` holds
        colours for viewers without the extension, which draw points.
    path : path
        The output: JSON with an embedded buffer if the name ends in ``.gltf``, otherwise a GLB.
    force : bool
        Whether an existing file may be replaced.

    Raises
    ------
    DataError
        ``invalid-rows``; ``bad-scene-info``; ``no-splats``.
    LimitError
        ``gltf-too-large``: a GLB would exceed 4 GiB, or a ``.gltf`` `MAX_TEXT_BYTES`.
    StorageError
        See `atomic_write`, e.g. ``exists``.

    Warns
    -----
    CogsplatWarning
        The scene has metadata or extras that glTF cannot hold.
    """
    where = os.fspath(path)
    splats.require_valid()
    if not len(splats):
        raise DataError("no-splats", f"{where}: no splats, expected one: glTF has no empty arrays")
    # glTF stores the colour space, so exclude it from the dropped values.
    dropped = dropped_info(replace(splats.info, colour_space=SceneInfo().colour_space))
    dropped += dropped_extras(splats)
    warn_dropped(path, "glTF", dropped)
    splats = convert_axes(splats, GLTF_AXES)
    layout = _layout(splats.sh_degree)
    length = len(splats) * sum(attribute.nbytes for attribute in layout)
    document = _document(splats, layout, length)
    with atomic_write(path, force) as file:
        if where.lower().endswith(".gltf"):
            # Base64 turns three bytes into four; `_MAX_DOCUMENT_BYTES` bounds the JSON.
            if length // 3 * 4 + _MAX_DOCUMENT_BYTES > MAX_TEXT_BYTES:
                raise LimitError(
                    "gltf-too-large",
                    f"{where}: {length} bytes of values, expected a .glb for more than "
                    f"{MAX_TEXT_BYTES} bytes of text",
                )
            data = base64.b64encode(b"".join(map(np.ndarray.tobytes, _values(splats))))
            uri = "data:application/octet-stream;base64," + data.decode("ascii")
            document["buffers"] = [{"byteLength": length, "uri": uri}]
            file.write(_json(document))
        else:
            _write_glb(file, document, _values(splats), length, where)


@dataclass(frozen=True)
class _Attribute:
    """A written attribute: name, accessor type, component type, bytes per splat."""

    name: str
    kind: str
    component: int
    nbytes: int


def _layout(degree: int) -> list[_Attribute]:
    """Return the attributes to write, in the order in which `_values` yields their values."""
    return [
        _Attribute("POSITION", "VEC3", _FLOAT, 12),
        _Attribute("COLOR_0", "VEC4", _UNSIGNED_BYTE, 4),
        _Attribute(f"{_EXTENSION}:ROTATION", "VEC4", _FLOAT, 16),
        _Attribute(f"{_EXTENSION}:SCALE", "VEC3", _FLOAT, 12),
        _Attribute(f"{_EXTENSION}:OPACITY", "SCALAR", _FLOAT, 4),
        _Attribute(_sh_name(0, 0), "VEC3", _FLOAT, 12),
        *(_Attribute(_sh_name(*pair), "VEC3", _FLOAT, 12) for pair in _sh_band_indices(degree)),
    ]


def _values(splats: Splats) -> Iterator[NDArray[np.generic]]:
    """Yield the stored values of each attribute, in the order of `_layout`."""
    yield splats.means.astype("<f4", copy=False)
    colours = (splats.sh0 * np.float32(C0) + np.float32(COLOUR_OFFSET)).clip(0, 1)
    rgba = np.empty((len(splats), 4), np.uint8)
    rgba[:, :3] = np.rint(colours * 255)
    rgba[:, 3] = opacity_bytes(splats.opacities)
    yield rgba
    yield np.roll(unit(splats.quats), -1, axis=1).astype("<f4", copy=False)
    # exp of a large log scale overflows float32, so clip it.
    with np.errstate(over="ignore"):
        scales = np.exp(splats.scales.astype(np.float64)).clip(_SMALLEST_SCALE, _LARGEST_SCALE)
    yield scales.astype("<f4")
    yield unit_opacities(splats.opacities).astype("<f4")
    yield splats.sh0.astype("<f4", copy=False)
    for k in range(splats.shN.shape[1]):
        yield splats.shN[:, k].astype("<f4", order="C")


def _document(splats: Splats, layout: list[_Attribute], length: int) -> dict[str, object]:
    """Return the glTF JSON of a scene with one buffer of `length` bytes."""
    views, accessors, offset = [], [], 0
    for index, attribute in enumerate(layout):
        nbytes = len(splats) * attribute.nbytes
        views.append(
            {"buffer": 0, "byteOffset": offset, "byteLength": nbytes, "target": _ARRAY_BUFFER}
        )
        offset += nbytes
        accessor: dict[str, object] = {
            "bufferView": index,
            "componentType": attribute.component,
            "count": len(splats),
            "type": attribute.kind,
        }
        if attribute.component != _FLOAT:
            accessor["normalized"] = True
        if attribute.name == "POSITION":
            # Required for positions only (section 3.7.2.1).
            accessor["min"] = [float(value) for value in splats.means.min(axis=0)]
            accessor["max"] = [float(value) for value in splats.means.max(axis=0)]
        accessors.append(accessor)
    spaces = {ours: theirs for theirs, ours in _COLOUR_SPACES.items()}
    extension = {
        "kernel": "ellipse",
        "colorSpace": spaces[splats.info.colour_space],
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    primitive = {
        "attributes": {attribute.name: index for index, attribute in enumerate(layout)},
        "mode": _POINTS,
        "extensions": {_EXTENSION: extension},
    }
    return {
        "asset": {"version": "2.0", "generator": "cogsplat"},
        "extensionsUsed": [_EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": length}],
    }


def _json(document: dict[str, object]) -> bytes:
    """Serialise a document as compact ASCII JSON."""
    return json.dumps(document, separators=(",", ":"), allow_nan=False).encode("ascii")


def _write_glb(
    file: BinaryIO,
    document: dict[str, object],
    values: Iterator[NDArray[np.generic]],
    length: int,
    where: str,
) -> None:
    """Write a GLB: header, JSON chunk, binary chunk of `length` bytes."""
    text = _json(document)
    # Lengths of chunks are multiples of 4; that of the values always is.
    text += b" " * (-len(text) % 4)
    total = GLB_HEADER.size + 2 * GLB_CHUNK.size + len(text) + length
    if total > _MAX_GLB_BYTES:
        raise LimitError(
            "gltf-too-large", f"{where}: {total} bytes, expected at most {_MAX_GLB_BYTES} of a GLB"
        )
    file.write(GLB_HEADER.pack(GLB_MAGIC, 2, total))
    file.write(GLB_CHUNK.pack(len(text), JSON_CHUNK) + text)
    file.write(GLB_CHUNK.pack(length, BIN_CHUNK))
    for array in values:
        file.write(array.data)
