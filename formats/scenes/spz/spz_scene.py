"""Reader of SPZ versions 1 to 4, and writer of versions 2 to 4 (github.com/nianticlabs/spz)."""

from __future__ import annotations

import os
import struct
import warnings
from typing import Final

from cogsplat.codec.errors import CogsplatWarning, FormatError
from cogsplat.codec.geometry.transforms import axes_change, convert_axes
from cogsplat.codec.splats import MAX_SH_DEGREE, SceneInfo, Splats
from cogsplat.formats.scenes.dropped_values import dropped_extras, dropped_info, warn_dropped
from cogsplat.formats.storage.atomic import StrPath, atomic_write, open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits

from .container import FLAG_ANTIALIASED, FLAG_EXTENSIONS, SpzFile, is_spz, pack, unpack
from .spz_values import PRECISIONS, dequantise, quantise

__all__ = ["is_spz", "read_spz", "write_spz"]

VERSIONS: Final = (2, 3, 4)
"""Versions that `write_spz` can write."""

DEFAULT_VERSION: Final = 4

SPZ_AXES: Final = "RUB"
"""Axes of the stored values, unless the file has a coordinate-system extension."""

_AXES: Final = "RDF"

# Axes by the number in the coordinate-system extension (extensions/README). For numbers from 9 on,
# the axes follow the behaviour of the format's library (0.2.2): a quarter turn about x. The names
# in that library (LBD, RBD, LBU, RBU, LFD, …) contradict it and would mirror the scene.
_COORDINATE_SYSTEM: Final = 0xADBE0003
_COORDINATE_SYSTEMS: Final = (
    *("", "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LBU", "RBU", "LFU", "RFU", "LBD", "RBD", "LFD", "RFD"),
)
_EXTENSION_NAMES: Final = {0xADBE0002: "orbit limits", 0x4E530001: "georeference"}

# Fraction of clipped values above which a write warns; every trained scene clips a few.
_CLIPPED_TOLERANCE: Final = 0.01


def read_spz(path: StrPath, *, limits: Limits | None = None) -> Splats:
    """Read a scene from an SPZ file.

    Parameters
    ----------
    path : path
        File of version 1 to 3 (gzip) or 4 (zstd), SH degree 0 to 4, any fractional bits.
    limits : Limits, optional
        Limits on splats and decoded bytes.

    Returns
    -------
    Splats
        Scene converted to RDF, the axes of PLY. Alpha 255 is a logit of +inf, alpha 0 of -inf.
        `Splats.info` has the file's anti-aliasing flag; SPZ stores no kernel size.

    Raises
    ------
    FormatError
        ``spz-`` followed by ``magic``, ``bad-sh``, ``fractional-bits``, ``gzip``, ``toc``,
        ``zstd``, ``extension``, ``trailing-bytes``, ``coordinate-system``.
    TruncatedError
        ``spz-truncated``.
    UnsupportedError
        ``spz-version``, ``spz-lod-tree``.
    LimitError
        ``decoded-size``, ``too-many-splats``.
    StorageError
        See `open_for_read`.

    Warns
    -----
    CogsplatWarning
        SH of degree 4 is cut to 3; an extension or flag is unknown and ignored.

    Notes
    -----
    Counts are checked against the file's size before any allocation.
    """
    where = os.fspath(path)
    with storage_errors(path), open_for_read(path) as file:
        data = file.read()
    spz = unpack(data, where, limits or Limits())
    axes = _read_extensions(spz, where)
    if spz.header.sh_degree > MAX_SH_DEGREE:
        _warn(
            f"{where}: SH of degree {spz.header.sh_degree}, "
            f"expected at most {MAX_SH_DEGREE}: cut to that"
        )
    antialiased = bool(spz.header.flags & FLAG_ANTIALIASED)
    change = axes_change(axes, _AXES)
    if change.only_flips:
        return dequantise(spz, change, SceneInfo(axes=_AXES, antialiased=antialiased))
    stored = dequantise(spz, axes_change(axes, axes), SceneInfo(axes=axes, antialiased=antialiased))
    return convert_axes(stored, _AXES)


def _read_extensions(spz: SpzFile, where: str) -> str:
    """Return the axes of the stored values; warn about ignored extensions and flags."""
    axes = SPZ_AXES
    skipped = []
    for kind, payload in spz.extensions:
        if kind != _COORDINATE_SYSTEM:
            skipped.append(f"extension {kind:#010x} ({_EXTENSION_NAMES.get(kind, 'unknown')})")
            continue
        number = struct.unpack("<I", payload)[0] if len(payload) == 4 else len(_COORDINATE_SYSTEMS)
        if number >= len(_COORDINATE_SYSTEMS):
            raise FormatError(
                "spz-coordinate-system",
                f"{where}: coordinate system {payload[:8].hex(' ') or 'of no bytes'}, "
                f"expected a number below {len(_COORDINATE_SYSTEMS)} in 4 bytes",
            )
        # Number 0 means unspecified, i.e. the default.
        axes = _COORDINATE_SYSTEMS[number] or SPZ_AXES
    flags = spz.header.flags & ~(FLAG_ANTIALIASED | FLAG_EXTENSIONS)
    if flags:
        skipped.append(f"flags {flags:#04x} (unknown)")
    if skipped:
        _warn(f"{where}: holds {', '.join(skipped)}: ignored")
    return axes


def _warn(message: str) -> None:
    """Warn; the warning names the line of code that called `read_spz`."""
    warnings.warn(message, CogsplatWarning, stacklevel=4)


def write_spz(
    splats: Splats,
    path: StrPath,
    *,
    force: bool = False,
    version: int = DEFAULT_VERSION,
    sh1_bits: int = 5,
    sh_rest_bits: int = 4,
    precision: str = "fine",
) -> None:
    """Write a scene as SPZ, atomically.

    Parameters
    ----------
    splats : Splats
        Scene in any axes; stored in RUB, in the same row order.
    path : path
        The output.
    force : bool
        Whether an existing file may be replaced.
    version : int
        Version of the file. 4 uses zstd. 3 uses gzip with the same values, for older readers. 2
        uses gzip with 8-bit components of quaternions, for still older ones.
    sh1_bits, sh_rest_bits : int
        Bits kept of SH coefficients of degree 1, and of degrees above 1; 1 to 8. The defaults are
        those of the reference writer.
    precision : str
        Steps of the means: ``"usual"`` as in other programs, ``"fine"`` finer in small scenes.

    Raises
    ------
    DataError
        ``invalid-rows``: a row cannot be rendered; ``bad-scene-info``: the axes are invalid.
    StorageError
        See `atomic_write`, e.g. ``exists``.
    ValueError
        The version, a number of bits or the precision is unknown.

    Warns
    -----
    CogsplatWarning
        The scene has values that SPZ cannot hold (an origin, a colour space, a kernel, extras),
        means are out of range, or more than 1 % of another attribute's values are clipped.

    Notes
    -----
    ============================  ==========================================  ================
    Values                        Step                                        Range
    ============================  ==========================================  ================
    means                         2^-12 scene units; finer in small scenes    24 bits
                                  with ``"fine"``, coarser in large ones
    scales                        1/16                                        -10 to 5.94
    opacities (activated)         1/255                                       0 to 1
    sh0                           0.026                                       ±3.33
    SH of degree 1                1/16                                        -1 to 1
    SH of degrees above 1         1/8                                         -1 to 1
    quaternions, per component    0.0014; 0.0078 in version 2                 -1 to 1
    ============================  ==========================================  ================

    In version 2 the error of w reaches 0.12 for rotations by nearly 180 degrees.
    """
    if version not in VERSIONS:
        raise ValueError(f"SPZ version {version}, expected one of {VERSIONS}")
    for bits in (sh1_bits, sh_rest_bits):
        if not 1 <= bits <= 8:
            raise ValueError(f"{bits} bits for SH coefficients, expected 1 to 8")
    if precision not in PRECISIONS:
        raise ValueError(f"precision {precision!r}, expected one of {PRECISIONS}")
    stored = convert_axes(splats.require_valid(), SPZ_AXES)
    header, streams, clipped = quantise(stored, version, sh1_bits, sh_rest_bits, precision)
    pieces = pack(header, streams)
    with atomic_write(path, force) as file:
        file.writelines(pieces)
    dropped = dropped_info(splats.info, antialiased=True) + dropped_extras(splats)
    dropped += [
        f"{100 * fraction:.2g} % of the {name} (out of range, clipped)"
        for name, fraction in clipped.items()
        if fraction > (0 if name == "means" else _CLIPPED_TOLERANCE)
    ]
    warn_dropped(path, "SPZ", dropped)
