"""Reader and writer of SOG version 2: splats as lossless images with a ``meta.json``.

The format is PlayCanvas' (developer.playcanvas.com, "The SOG Format", cited here by its sections).
Section 1.2 says that y points up, but PlayCanvas' tools store the axes of the source PLY; this
module does too.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.clustering.hierarchical_kmeans import train_palette
from cogsplat.codec.clustering.scalar_kmeans import nearest_scalars, train_scalars
from cogsplat.codec.errors import FormatError, LimitError, UnsupportedError
from cogsplat.codec.geometry.transforms import convert_axes
from cogsplat.codec.splats import SceneInfo, Splats, sh_coefficients
from cogsplat.codec.threads import ordered_map, thread_count
from cogsplat.formats.scenes.dropped_values import dropped_extras, dropped_info, warn_dropped
from cogsplat.formats.scenes.quantised_values import (
    BYTE_LOGITS,
    from_smallest_three,
    morton_order,
    opacity_bytes,
    to_smallest_three,
)
from cogsplat.formats.storage.atomic import StrPath, atomic_write
from cogsplat.formats.storage.images import MAX_SIDE, decode_image, encode_image, image_size
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.strict_json import JsonObject, parse_object

from .bundle import META_NAME, ZIP_MAGIC, SogFolder, open_files, write_bundle, write_folder

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

MAX_COUNT: Final = MAX_SIDE**2
"""Limit on a file's count of splats; the limits on images are reached earlier."""

_VERSION: Final = 2
_MAX_META_BYTES: Final = 1 << 22
_MAX_IMAGE_BYTES: Final = 1 << 30
_CODEBOOK: Final = 256
_CODE: Final = "sog-bad-meta"

# Measured memory per pixel while an image is decoded: two canvases of libwebp, Pillow's copy, the
# conversion to RGBA, and the final array. Only the array remains afterwards.
_DECODING_BYTES: Final = 24
_PIXEL_BYTES: Final = 4

# Limit on the pixels of an image: about one per splat, up to four if sides are powers of two.
_PIXELS_PER_SPLAT: Final = 4
_FREE_PIXELS: Final = 1 << 16

# Section 3.2: alpha 252 to 255 names the largest component, w first.
_QUAT_ALPHA: Final = 252
_SQRT2: Final = math.sqrt(2)
_QUAT_VALUES: Final = ((np.arange(256) / 255 - 0.5) * _SQRT2).astype(np.float32)

# Section 3.5: entries of the SH palette at most, and entries in a row of its image.
_PALETTE_ENTRIES: Final = 65536
_PALETTE_COLUMNS: Final = 64
# Up to this number of splats a palette saves nothing, so each splat gets its own entry.
_MAX_UNCLUSTERED: Final = 1024


def is_sog(head: bytes) -> bool:
    """Return whether a file that begins with `head` is a SOG bundle or its ``meta.json``."""
    if head.startswith(ZIP_MAGIC):
        return True
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    return start == b"{" and all(f'"{key}"'.encode() in head for key in ("means", "scales"))


@dataclass(frozen=True)
class _Sh:
    """The SH part of ``meta.json``: bands, palette entries, codebook and image files."""

    bands: int
    count: int
    codebook: F32
    files: tuple[str, ...]


@dataclass(frozen=True)
class _Meta:
    """The checked values of ``meta.json``; images are checked when they are read."""

    count: int
    antialiased: bool
    low: list[float]
    high: list[float]
    scales: F32
    sh0: F32
    sh: _Sh | None
    # Images in the order means_l, means_u, scales, quats, sh0, shN_labels.
    files: tuple[str, ...]


def read_sog(path: StrPath, *, limits: Limits | None = None) -> Splats:
    """Read a scene from a SOG bundle, or from the ``meta.json`` of an unpacked one.

    Parameters
    ----------
    path : path
        A ``.sog``, or the ``meta.json`` whose folder holds the images.
    limits : Limits, optional
        Limits on splats and decoded bytes. Decoded bytes are compared with the images' bytes,
        because an image of one colour stays tiny for any number of splats.

    Returns
    -------
    Splats
        Splats in file order, in the axes of PLY, with unit quaternions. Opacity byte 255 is a logit
        of +inf, 0 of -inf.

    Raises
    ------
    FormatError
        ``sog-`` followed by ``magic``, ``zip``, ``missing-file``, ``file-name``, ``bad-meta``,
        ``image-size``, ``bad-index``, ``bad-quaternion``; ``image-damaged``.
    TruncatedError
        ``image-truncated``.
    UnsupportedError
        ``sog-version``, ``sog-model``, ``sog-zip-method``, ``image-format``, ``needs-pillow``.
    LimitError
        ``json-too-long``, ``image-too-large``, ``sog-file-too-large``, ``sog-zip-ratio``,
        ``sog-zip-directory``, ``decoded-size``, ``too-many-splats``.
    StorageError
        See `open_for_read`.

    Notes
    -----
    The size of each image is checked against the count and the file's size before it is decoded.
    """
    where = os.fspath(path)
    limits = limits or Limits()
    with open_files(path, where) as files:
        meta = _parse_meta(files.read(META_NAME, _MAX_META_BYTES), where)
        data = [files.read(name, _MAX_IMAGE_BYTES) for name in meta.files]
        centroids = files.read(meta.sh.files[0], _MAX_IMAGE_BYTES) if meta.sh else b""
        source_bytes = files.source_bytes
    pixels_each = _check_sizes(meta, data, where)
    palette_pixels = _check_palette(centroids, meta.sh, where) if meta.sh else 0
    limits.require_scene(
        meta.count,
        sh_degree=meta.sh.bands if meta.sh else 0,
        source_bytes=source_bytes,
        where=where,
        # The means have two images: one stays in memory while the other is decoded.
        extra_bytes=_DECODING_BYTES * max(pixels_each, palette_pixels) + _PIXEL_BYTES * pixels_each,
    )
    pixels = (
        decode_image(image, f"{where}: {name!r}").reshape(-1, 4)[: meta.count]
        for name, image in zip(meta.files, data, strict=True)
    )
    # `pixels` is a generator, so that only the images in use are in memory.
    means = _unpack_means(next(pixels), next(pixels), meta)
    scales = _look_up(meta.scales, next(pixels)[:, :3], f"{where}: scales")
    quats = _unpack_quats(next(pixels), where)
    colours = next(pixels)
    sh0 = _look_up(meta.sh0, colours[:, :3], f"{where}: sh0")
    opacities = BYTE_LOGITS[colours[:, 3]]
    if meta.sh:
        palette = _unpack_palette(centroids, meta.sh, where)
        labels = next(pixels)
        indices = labels[:, 0] | labels[:, 1].astype(np.uint16) << np.uint16(8)
        shN = _look_up(palette, indices, f"{where}: shN labels")
    else:
        shN = np.empty((meta.count, 0, 3), np.float32)
    info = SceneInfo(antialiased=meta.antialiased)
    return Splats(means, scales, quats, opacities, sh0, shN, info)


def sog_files(path: StrPath) -> list[Path]:
    """Return the paths of a scene's files: the bundle, or ``meta.json`` and its images.

    Raises
    ------
    FormatError, LimitError, StorageError
        See `read_sog`.
    """
    where = os.fspath(path)
    found = [Path(path)]
    with open_files(path, where) as files:
        if isinstance(files, SogFolder):
            meta = _parse_meta(files.read(META_NAME, _MAX_META_BYTES), where)
            names = [*meta.files, *(meta.sh.files[:1] if meta.sh else ())]
            found += [files.path(name) for name in dict.fromkeys(names)]
    return found


def _parse_meta(data: bytes, where: str) -> _Meta:
    """Parse and check a ``meta.json``."""
    root = parse_object(data, f"{where}: {META_NAME}", _CODE)
    version = root.integer("version", 0, 1 << 31, default=1)
    if version != _VERSION:
        raise UnsupportedError(
            "sog-version", f"{where}: SOG version {version}, expected {_VERSION}"
        )
    model = root.text("model", "default")
    if model not in ("default", "antialiased"):
        raise UnsupportedError(
            "sog-model", f"{where}: splats of the model {model!r}, expected 3D Gaussians"
        )
    means, scales, quats = root.child("means"), root.child("scales"), root.child("quats")
    sh0 = root.child("sh0")
    sh = _parse_sh(root.child("shN")) if "shN" in root else None
    return _Meta(
        count=root.integer("count", 0, MAX_COUNT),
        antialiased=root.boolean("antialias", False) or model == "antialiased",
        low=means.numbers("mins", 3),
        high=means.numbers("maxs", 3),
        scales=_codebook(scales),
        sh0=_codebook(sh0),
        sh=sh,
        files=(
            *means.texts("files", 2),
            *scales.texts("files", 1),
            *quats.texts("files", 1),
            *sh0.texts("files", 1),
            *(sh.files[1:] if sh else ()),
        ),
    )


def _parse_sh(node: JsonObject) -> _Sh:
    """Parse and check the SH part of a ``meta.json``."""
    return _Sh(
        bands=node.integer("bands", 1, 3),
        count=node.integer("count", 1, _PALETTE_ENTRIES),
        codebook=_codebook(node),
        files=tuple(node.texts("files", 2)),
    )


def _codebook(node: JsonObject) -> F32:
    """Return the codebook of a part of ``meta.json``: at most 256 float32 values."""
    values = node.values.get("codebook")
    if isinstance(values, list) and len(values) == _CODEBOOK and values[0] is None:
        # Writers of 2025 stored null for a first entry that was not finite. PlayCanvas' engine
        # extrapolates it from the other entries (pull request 8056).
        rest = JsonObject({"codebook": values[1:]}, node.where, node.code).numbers("codebook")
        numbers = [rest[0] + (rest[0] - rest[-1]) / (_CODEBOOK - 1), *rest]
    else:
        numbers = node.numbers("codebook")
    codebook = np.array(numbers, np.float64)
    if not 1 <= len(numbers) <= _CODEBOOK or np.abs(codebook).max() > np.finfo(np.float32).max:
        raise node.wrong("codebook", f"1 to {_CODEBOOK} numbers that fit float32")
    return codebook.astype(np.float32)


def _check_sizes(meta: _Meta, data: list[bytes], where: str) -> int:
    """Check the size of every image against the count; return the pixels of one image."""
    sizes = [
        image_size(image, f"{where}: {name!r}")
        for name, image in zip(meta.files, data, strict=True)
    ]
    most = _PIXELS_PER_SPLAT * meta.count + _FREE_PIXELS
    for (width, height), name in zip(sizes, meta.files, strict=True):
        if (width, height) != sizes[0] or not meta.count <= width * height <= most:
            raise FormatError(
                "sog-image-size",
                f"{where}: {name!r} is {width}x{height}, expected {meta.count} to {most} pixels "
                f"and {sizes[0][0]}x{sizes[0][1]} like {meta.files[0]!r}",
            )
    return sizes[0][0] * sizes[0][1]


def _unpack_means(lower: U8, upper: U8, meta: _Meta) -> F32:
    """Return the (N, 3) means of the images of lower and upper bytes (section 3.1)."""
    means = np.empty((meta.count, 3), np.float32)
    fractions = np.arange(65536) / 65535
    for axis in range(3):
        logs = meta.low[axis] * (1 - fractions) + meta.high[axis] * fractions
        # Ranges of a damaged file may overflow; rows with infinite means are rejected later.
        with np.errstate(over="ignore"):
            values = (np.sign(logs) * np.expm1(np.abs(logs))).astype(np.float32)
        indices = lower[:, axis] | upper[:, axis].astype(np.uint16) << np.uint16(8)
        means[:, axis] = values[indices]
    return means


def _look_up(table: F32, indices: NDArray[np.unsignedinteger], where: str) -> F32:
    """Return the table's rows at some indices, or raise ``sog-bad-index``."""
    highest = int(indices.max(initial=0))
    if highest >= len(table):
        raise FormatError(
            "sog-bad-index", f"{where}: index {highest}, expected less than {len(table)}"
        )
    found: F32 = table.take(indices, axis=0)
    return found


def _unpack_quats(pixels: U8, where: str) -> F32:
    """Return the (N, 4) wxyz quaternions of an image's RGBA pixels (section 3.2)."""
    wrong = np.flatnonzero(pixels[:, 3] < _QUAT_ALPHA)
    if len(wrong):
        raise FormatError(
            "sog-bad-quaternion",
            f"{where}: splat {wrong[0]} has alpha {pixels[wrong[0], 3]} in its quaternion, "
            f"expected {_QUAT_ALPHA} to 255",
        )
    return from_smallest_three(pixels[:, 3] - np.uint8(_QUAT_ALPHA), _QUAT_VALUES[pixels[:, :3]])


def _check_palette(data: bytes, sh: _Sh, where: str) -> int:
    """Check the size of the palette image against the number of entries; return its pixels."""
    name = f"{where}: {sh.files[0]!r}"
    columns, rows = _palette_shape(sh)
    width, height = image_size(data, name)
    most = 4 * rows + 64
    if width != columns or not rows <= height <= most:
        raise FormatError(
            "sog-image-size",
            f"{name} is {width}x{height}, expected {columns} by {rows} to {most} for {sh.count} "
            f"entries of {sh.bands} bands",
        )
    return width * height


def _palette_shape(sh: _Sh) -> tuple[int, int]:
    """Return the width and the smallest height of the palette image, px."""
    coefficients = sh_coefficients(sh.bands) - 1
    return _PALETTE_COLUMNS * coefficients, -(-sh.count // _PALETTE_COLUMNS)


def _unpack_palette(data: bytes, sh: _Sh, where: str) -> F32:
    """Return the SH palette, (entries, K-1, 3) float32."""
    name = f"{where}: {sh.files[0]!r}"
    coefficients = sh_coefficients(sh.bands) - 1
    _, rows = _palette_shape(sh)
    codes = decode_image(data, name)[:rows, :, :3].reshape(-1, coefficients, 3)[: sh.count]
    return _look_up(sh.codebook, codes, name)


def write_sog(splats: Splats, path: StrPath, *, force: bool = False) -> None:
    """Write a scene as a SOG bundle, or as a folder if the output is called ``meta.json``.

    A bundle is written atomically. In a folder ``meta.json`` is written last, so that a folder
    with a ``meta.json`` is complete.

    Parameters
    ----------
    splats : Splats
        Scene, stored in Morton order and in the axes of PLY. SH above DC becomes a palette; its
        entries are the largest power of two within the number of splats, at most 65536.
    path : path
        The output. The folder of a ``meta.json`` must exist.
    force : bool
        Whether existing files may be replaced.

    Raises
    ------
    DataError
        ``invalid-rows``; ``bad-scene-info``.
    LimitError
        ``sog-too-many-splats``: the scene has more splats than an image has pixels.
    UnsupportedError
        ``needs-pillow``.
    StorageError
        See `atomic_write`, e.g. ``exists``.

    Warns
    -----
    CogsplatWarning
        The scene has metadata or extras that SOG cannot hold.
    """
    where = os.fspath(path)
    splats.require_valid()
    if len(splats) > MAX_COUNT:
        raise LimitError(
            "sog-too-many-splats", f"{where}: {len(splats)} splats, expected at most {MAX_COUNT}"
        )
    dropped = dropped_info(splats.info, antialiased=True) + dropped_extras(splats)
    warn_dropped(path, "SOG", dropped)
    splats = convert_axes(splats, "RDF")
    splats = splats.take(morton_order(splats.means))
    meta, images = _pack(splats)
    names = list(images)
    encoded = ordered_map(lambda name: encode_image(images[name], where), names, thread_count(0))
    files = dict(zip(names, encoded, strict=True))
    files[META_NAME] = json.dumps(meta, separators=(",", ":"), allow_nan=False).encode("ascii")
    if Path(path).name.lower() == META_NAME:
        write_folder(Path(path), files, force=force)
        return
    with atomic_write(path, force) as file:
        write_bundle(file, files)


def _pack(splats: Splats) -> tuple[dict[str, object], dict[str, U8]]:
    """Return the contents of ``meta.json``, and the pixels of each image by file name."""
    count = len(splats)
    # Sides are multiples of 4, as in files of other writers.
    width = max(4, 4 * math.ceil(math.sqrt(count) / 4))
    shape = max(4, 4 * math.ceil(count / width / 4)), width

    def image(*columns: NDArray[np.generic]) -> U8:
        pixels = np.zeros((shape[0] * shape[1], sum(c.shape[1] for c in columns)), np.uint8)
        np.concatenate(columns, axis=1, out=pixels[:count], casting="unsafe")
        return pixels.reshape(*shape, -1)

    means, low, high = _pack_means(splats.means)
    scales, scale_codes = _train_codebook(splats.scales)
    sh0, sh0_codes = _train_codebook(splats.sh0)
    largest, others = to_smallest_three(splats.quats)
    quat_codes = np.rint((others / _SQRT2 + 0.5) * 255).clip(0, 255)
    images = {
        "means_l.webp": image(means & 255),
        "means_u.webp": image(means >> 8),
        "scales.webp": image(scale_codes),
        "quats.webp": image(quat_codes, largest[:, None] + _QUAT_ALPHA),
        "sh0.webp": image(sh0_codes, opacity_bytes(splats.opacities)[:, None]),
    }
    meta: dict[str, object] = {
        "version": _VERSION,
        "asset": {"generator": "cogsplat"},
        "count": count,
        "antialias": splats.info.antialiased,
    }
    if splats.info.antialiased:
        # Key of PlayCanvas' tools since their version 3.2.
        meta["model"] = "antialiased"
    meta["means"] = {"mins": low, "maxs": high, "files": ["means_l.webp", "means_u.webp"]}
    meta["scales"] = {"codebook": scales, "files": ["scales.webp"]}
    meta["quats"] = {"files": ["quats.webp"]}
    meta["sh0"] = {"codebook": sh0, "files": ["sh0.webp"]}
    if splats.sh_degree:
        palette, labels = _train_sh_palette(splats.shN)
        codebook, codes = _train_codebook(palette)
        images["shN_centroids.webp"] = _centroid_image(codes)
        images["shN_labels.webp"] = image(
            labels[:, None] & 255, labels[:, None] >> 8, np.zeros((count, 1), np.uint8)
        )
        meta["shN"] = {
            "count": len(palette),
            "bands": splats.sh_degree,
            "codebook": codebook,
            "files": ["shN_centroids.webp", "shN_labels.webp"],
        }
    return meta, images


def _pack_means(means: F32) -> tuple[NDArray[np.uint16], list[float], list[float]]:
    """Quantise means to 16 bits, in the symmetric log of SOG (section 3.1).

    Returns
    -------
    codes : (N, 3) uint16
    low, high : list of float
        Logs, on each axis, that codes 0 and 65535 stand for.
    """
    wide = means.astype(np.float64)
    logs = np.copysign(np.log1p(np.abs(wide)), wide)
    if not len(logs):
        return np.empty((0, 3), np.uint16), [0.0] * 3, [0.0] * 3
    low, high = logs.min(axis=0), logs.max(axis=0)
    extent = np.where(high > low, high - low, 1.0)
    codes = np.rint((logs - low) / extent * 65535).astype(np.uint16)
    return codes, low.tolist(), high.tolist()


def _train_codebook(values: F32) -> tuple[list[float], NDArray[np.intp]]:
    """Return a codebook of 256 scalars, and the index of the nearest scalar for each value."""
    codebook = train_scalars(values.reshape(-1), _CODEBOOK)
    if not len(codebook):
        codebook = np.zeros(1, np.float32)
    codes = nearest_scalars(values, codebook)
    # Readers expect 256 entries: repeat the last one.
    padded = np.pad(codebook, (0, _CODEBOOK - len(codebook)), mode="edge")
    return [float(value) for value in padded], codes


def _train_sh_palette(shN: F32) -> tuple[F32, NDArray[np.uint32]]:
    """Return an (entries, K-1, 3) palette of SH coefficients, and the entry of each splat."""
    count, coefficients = len(shN), shN.shape[1]
    if count <= _MAX_UNCLUSTERED:
        # The format requires an entry, so an empty scene gets an unused one.
        palette = shN if count else np.zeros((1, coefficients, 3), np.float32)
        return palette, np.arange(count, dtype=np.uint32)
    entries = min(1 << (count.bit_length() - 1), _PALETTE_ENTRIES)
    flat, labels = train_palette(shN.reshape(count, -1), entries)
    return flat.reshape(-1, coefficients, 3), labels


def _centroid_image(codes: NDArray[np.intp]) -> U8:
    """Return the palette image: rows of 64 entries, one pixel per coefficient (section 3.5)."""
    count, coefficients, _ = codes.shape
    rows = -(-count // _PALETTE_COLUMNS)
    pixels = np.zeros((rows * _PALETTE_COLUMNS, coefficients, 3), np.uint8)
    pixels[:count] = codes
    return pixels.reshape(rows, _PALETTE_COLUMNS * coefficients, 3)
