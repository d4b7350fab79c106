"""SPZ scenes: versions 1 to 4 read, 2 to 4 written (github.com/nianticlabs/spz)."""

from __future__ import annotations

import os
import struct
import warnings
from typing import Final

from cogsplat.codec.errors import CogsplatWarning, FormatError
from cogsplat.codec.geometry.transforms import axes_change, convert_axes
from cogsplat.codec.splats import MAX_SH_DEGREE, SceneInfo, Splats
from cogsplat.formats.scenes.dropped_values import extra_losses, info_losses, warn_of_losses
from cogsplat.formats.storage.atomic import StrPath, atomic_write, open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits

from .container import FLAG_ANTIALIASED, FLAG_EXTENSIONS, SpzFile, is_spz, pack, unpack
from .spz_values import PRECISIONS, decode, encode

__all__ = ["is_spz", "read_spz", "write_spz"]

VERSIONS: Final = (2, 3, 4)
"""Those that are written."""

DEFAULT_VERSION: Final = 4

SPZ_AXES: Final = "RUB"
"""Frame of values in a file that does not say otherwise."""

_AXES: Final = "RDF"

# extensions/README: the frame of the stored values, as a number in this list. Numbers from 9 on are
# what the format's library (0.2.2) makes of them, which is a quarter turn about x between frames
# with up along y and along z; its own names for these (LBD, RBD, LBU, RBU, LFD ...) would mirror
# what it writes.
_COORDINATE_SYSTEM: Final = 0xADBE0003
_COORDINATE_SYSTEMS: Final = (
    *("", "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LBU", "RBU", "LFU", "RFU", "LBD", "RBD", "LFD", "RFD"),
)
_NAMES: Final = {0xADBE0002: "orbit limits", 0x4E530001: "georeference"}

# Shares of clipped values up to this go without a word: every trained scene has a few.
_CLIPPED: Final = 0.01


def read_spz(path: StrPath, *, limits: Limits | None = None) -> Splats:
    """Read a scene from an SPZ file.

    Parameters
    ----------
    path : path
        Version 1 to 3 (gzip) or 4 (zstd), SH degree 0 to 4, any fractional bits.
    limits : Limits, optional
        What the file may cost.

    Returns
    -------
    Splats
        In RDF, the frame of PLY, whatever the file's own is: RUB, or what its coordinate-system
        extension says. Alpha 255 is a logit of inf, alpha 0 of -inf. `Splats.info` says whether
        the scene is anti-aliased; the file knows nothing of the kernel.

    Raises
    ------
    FormatError
        ``spz-`` and ``magic``, ``bad-sh``, ``fractional-bits``, ``gzip``, ``toc``, ``zstd``,
        ``extension``, ``trailing-bytes``, ``coordinate-system``.
    TruncatedError
        ``spz-truncated``.
    UnsupportedError
        ``spz-version``, ``spz-lod-tree``.
    LimitError
        ``decoded-size``, ``too-many-splats``.
    StorageError
        As `open_for_read`.

    Warns
    -----
    CogsplatWarning
        SH of degree 4, cut to 3; extensions or flags that are left out.

    Notes
    -----
    No array is allocated before its count is checked against the size of the file.
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
        return decode(spz, change, SceneInfo(axes=_AXES, antialiased=antialiased))
    stored = decode(spz, axes_change(axes, axes), SceneInfo(axes=axes, antialiased=antialiased))
    return convert_axes(stored, _AXES)


def _read_extensions(spz: SpzFile, where: str) -> str:
    """Return the axes of the stored values; warn of extensions that are not understood."""
    axes = SPZ_AXES
    skipped = []
    for kind, payload in spz.extensions:
        if kind != _COORDINATE_SYSTEM:
            skipped.append(f"extension {kind:#010x} ({_NAMES.get(kind, 'unknown')})")
            continue
        number = struct.unpack("<I", payload)[0] if len(payload) == 4 else len(_COORDINATE_SYSTEMS)
        if number >= len(_COORDINATE_SYSTEMS):
            raise FormatError(
                "spz-coordinate-system",
                f"{where}: coordinate system {payload[:8].hex(' ') or 'of no bytes'}, "
                f"expected a number below {len(_COORDINATE_SYSTEMS)} in 4 bytes",
            )
        # Number 0 is "unspecified", which means the default.
        axes = _COORDINATE_SYSTEMS[number] or SPZ_AXES
    flags = spz.header.flags & ~(FLAG_ANTIALIASED | FLAG_EXTENSIONS)
    if flags:
        skipped.append(f"flags {flags:#04x} (unknown)")
    if skipped:
        _warn(f"{where}: holds {', '.join(skipped)}: left out")
    return axes


def _warn(message: str) -> None:
    # The caller of `read_spz` is who asked for the file.
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
    """Write a scene as SPZ, whole or not at all.

    Parameters
    ----------
    splats : Splats
        In any axes; stored in RUB. The order of rows is kept.
    path : path
        The output.
    force : bool
        Whether an existing file may be replaced.
    version : int
        4 (zstd), or 3 (gzip) for older readers, with the same values, or 2 (gzip) for those that
        read no quaternions of ten bits a component.
    sh1_bits, sh_rest_bits : int
        Bits that SH coefficients of degree 1 and above keep, 1 to 8; defaults as everybody's.
    precision : str
        ``"fine"`` stores the means of small scenes in finer steps; ``"usual"`` in the steps of
        other programs, for a smaller file.

    Raises
    ------
    DataError
        ``invalid-rows``: a row that cannot be drawn; ``bad-scene-info``: axes that are none.
    StorageError
        As `atomic_write`, ``exists`` among them.
    ValueError
        Another version, number of bits or precision.

    Warns
    -----
    CogsplatWarning
        What SPZ cannot hold: an origin, a colour space, a kernel; means too far out; more than 1 %
        of another attribute's values out of its range and clipped.

    Notes
    -----
    Steps: means 2^-12 scene units, finer in small scenes with the precision ``"fine"``, and coarser
    in large ones; scales 1/16;
    opacities 1/255 of the activated value; sh0 0.026; quaternions 0.0014 per component, 0.0078 in
    version 2, where the w of a turn by nearly half a circle is off by up to 0.12;
    coefficients of degree 1 1/16 and 1/8 above. Ranges: scales -10 to 5.94, sh0 ±3.33,
    coefficients -1 to 1.
    """
    if version not in VERSIONS:
        raise ValueError(f"SPZ version {version}, expected one of {VERSIONS}")
    for bits in (sh1_bits, sh_rest_bits):
        if not 1 <= bits <= 8:
            raise ValueError(f"{bits} bits for SH coefficients, expected 1 to 8")
    if precision not in PRECISIONS:
        raise ValueError(f"precision {precision!r}, expected one of {PRECISIONS}")
    stored = convert_axes(splats.require_valid(), SPZ_AXES)
    header, streams, clipped = encode(stored, version, sh1_bits, sh_rest_bits, precision)
    pieces = pack(header, streams)
    with atomic_write(path, force) as file:
        file.writelines(pieces)
    losses = info_losses(splats.info, antialiased=True) + extra_losses(splats)
    losses += [
        f"{100 * share:.2g} % of the {name} (out of range, clipped)"
        for name, share in clipped.items()
        if share > (0 if name == "means" else _CLIPPED)
    ]
    warn_of_losses(path, "SPZ", losses)
