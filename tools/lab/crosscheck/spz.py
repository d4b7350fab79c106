"""Cross-check of SPZ, .splat and .ksplat with third-party implementations.

Run ``python -m cogsplat.tools.lab.crosscheck.spz NODE_MODULES`` after, in that folder's parent,
``npm install @playcanvas/splat-transform@2 @adobe/spz @mkkellogg/gaussian-splats-3d three``. The
second is the SPZ library, which the first uses; the third is the origin of .ksplat.
"""

from __future__ import annotations

import struct
import sys
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NoReturn

import click
import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.geometry.rotations import matrices, unit
from cogsplat.codec.splats import Splats
from cogsplat.formats.scenes.ksplat import read_ksplat
from cogsplat.formats.scenes.ply.ply_scene import read_ply, write_ply
from cogsplat.formats.scenes.quantised_values import unit_opacities
from cogsplat.formats.scenes.splat import read_splat, write_splat
from cogsplat.formats.scenes.spz.spz_scene import read_spz, write_spz
from cogsplat.tools.lab.synthetic.terrace import synth
from cogsplat.tools.terminal.options import json_option
from cogsplat.tools.terminal.output import print_json, print_line, print_table
from cogsplat.tools.terminal.standard_streams import PATH

from .converter import convert, run

F64 = NDArray[np.float64]

_VIEWER: Final = "@mkkellogg/gaussian-splats-3d/build/gaussian-splats-3d.module.js"

_LIBRARY: Final = "@adobe/spz/dist/spz.js"

# Arguments: the library's module and SPZ files. For each file the script writes FILE.floats, the
# arrays that the library reads, in RDF, and FILE.v2, the same scene as version 2.
_READ_SPZ: Final = """
import { readFileSync, writeFileSync } from 'node:fs';
import { pathToFileURL } from 'node:url';
const [module, ...files] = process.argv.slice(2);
const { default: create } = await import(pathToFileURL(module).href);
const spz = await create({ print: () => {} });
const RDF = spz.CoordinateSystem.RDF;
for (const file of files) {
  const cloud = spz.loadSpzFromBuffer(new Uint8Array(readFileSync(file)), { to: RDF });
  const names = ['positions', 'scales', 'rotations', 'alphas', 'colors', 'sh'];
  const arrays = names.map((name) => cloud[name]);
  const bytes = arrays.map((a) => Buffer.from(a.buffer, a.byteOffset, a.byteLength));
  writeFileSync(file + '.floats', Buffer.concat(bytes));
  cloud.extensions = [];
  const options = { version: 2, from: RDF, sh1Bits: 8, shRestBits: 8 };
  writeFileSync(file + '.v2', spz.saveSpzToBuffer(cloud, options));
}
"""

# Arguments: the viewer's module, a PLY, the compression level, the SH degree, the output. Splats of
# low opacity are kept.
_MAKE_KSPLAT: Final = """
import { readFileSync, writeFileSync } from 'node:fs';
import { pathToFileURL } from 'node:url';
const [module, input, level, degree, output] = process.argv.slice(2);
const { PlyParser, SplatBufferGenerator } = await import(pathToFileURL(module).href);
const bytes = readFileSync(input);
const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
const splats = PlyParser.parseToUncompressedSplatArray(buffer, Number(degree));
const generator = SplatBufferGenerator.getStandardGenerator(0, Number(level));
const made = generator.generateFromUncompressedSplatArray(splats);
writeFileSync(output, Buffer.from(made.bufferData));
"""

# Float32 rounding for values up to a few tens, in both programs.
_ROUNDING: Final = {
    "means": 1e-5,
    "scales": 1e-5,
    "quats": 1e-5,
    "opacities": 1e-6,
    "sh0": 1e-5,
    "shN": 1e-5,
}

# Half steps of SPZ (`write_spz`). The omitted quaternion component accumulates three errors. SH
# bytes lack the top level.
_SPZ_STEPS: Final = {
    "means": 2**-13,
    "scales": 1 / 32,
    "quats": 3 * 0.5 * 0.5**0.5 / 511,
    "opacities": 0.5 / 255,
    "sh0": 0.5 / 255 / 0.15,
    "shN": 1 / 16,
}

# The converter rounds SH to bytes before it rounds to steps.
_CONVERTER_SPZ_STEPS: Final = {**_SPZ_STEPS, "shN": 1 / 16 + 1 / 256}

# Version 2 stores the first three quaternion components in bytes. The fourth is a square root,
# whose error is large near zero.
_SPZ_STEPS_2: Final = {**_SPZ_STEPS, "quats": 0.12, "shN": 1 / 256}

# The square root of an error of 2^-23.
_ROUNDING_2: Final = {**_ROUNDING, "quats": 2**-11.5}

_EXTENSION: Final = 0xADBE0003


@dataclass(frozen=True)
class Finding:
    """Result of one check: differences in one attribute, or a file size.

    Parameters
    ----------
    check : str
        Name of the check.
    attribute : str
        Compared attribute.
    greatest, mean : float
        Maximum and mean of the absolute differences (`differences`).
    allowed : float
        Upper bound of `greatest`.
    """

    check: str
    attribute: str
    greatest: float
    mean: float
    allowed: float

    @property
    def passed(self) -> bool:
        """Whether the largest difference is within the bound; false for NaN."""
        return self.greatest <= self.allowed * (1 + 1e-4)


def differences(actual: Splats, expected: Splats) -> dict[str, F64]:
    """Return absolute differences by attribute between scenes with the same rows.

    Opacities are compared after activation, quaternions normalised and up to sign.
    """
    one, other = unit(actual.quats).astype(np.float64), unit(expected.quats).astype(np.float64)
    signs = np.where((one * other).sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
    out = {
        "quats": np.abs(one - other * signs),
        "opacities": np.abs(unit_opacities(actual.opacities) - unit_opacities(expected.opacities)),
    }
    for name in ("means", "scales", "sh0", "shN"):
        wide = getattr(actual, name).astype(np.float64)
        out[name] = np.abs(wide - getattr(expected, name))
    return out


def compare_scenes(
    check: str, actual: Splats, expected: Splats, allowed: dict[str, float]
) -> list[Finding]:
    """Compare scenes with the same rows in the attributes named by `allowed`.

    Raises
    ------
    click.ClickException
        The scenes differ in the number of splats or in SH degree.
    """
    if len(actual) != len(expected) or actual.sh_degree != expected.sh_degree:
        raise click.ClickException(
            f"{check}: {len(actual)} splats of SH degree {actual.sh_degree}, "
            f"expected {len(expected)} of {expected.sh_degree}"
        )
    difference = differences(actual, expected)
    return [
        Finding(check, name, float(difference[name].max()), float(difference[name].mean()), limit)
        for name, limit in allowed.items()
        if difference[name].size
    ]


def _clip(splats: Splats) -> Splats:
    """Clip a scene to the ranges of SPZ and .ksplat, so that half steps bound all errors."""
    return Splats(
        means=splats.means,
        scales=np.clip(splats.scales, -9.9, 5.9),
        quats=splats.quats,
        opacities=splats.opacities,
        sh0=np.clip(splats.sh0, -3.3, 3.3),
        shN=np.clip(splats.shN, -1, 1),
    )


def check_spz(modules: Path, scene: Splats, folder: Path) -> list[Finding]:
    """Check SPZ files of versions 3 and 4, written and read by both programs."""
    findings = []
    source = folder / "scene.ply"
    write_ply(scene, source, force=True)
    for version in (3, 4):
        ours, theirs = folder / f"ours{version}.spz", folder / f"theirs{version}.spz"
        write_spz(scene, ours, force=True, version=version)
        convert(modules, source, theirs, "--spz-version", str(version))
        for name, path in (("ours", ours), ("theirs", theirs)):
            check = f"SPZ {version}, {name}"
            read = read_spz(path)
            steps = _SPZ_STEPS if name == "ours" else _CONVERTER_SPZ_STEPS
            findings += compare_scenes(f"{check}: read here and the scene", read, scene, steps)
            there = read_ply(convert(modules, path, path.with_suffix(".ply")))
            findings += compare_scenes(f"{check}: read here and there", read, there, _ROUNDING)
        findings.append(_compare_sizes(scene, version, theirs, folder))
    return findings


def _compare_sizes(scene: Splats, version: int, theirs: Path, folder: Path) -> Finding:
    """Compare file sizes of both programs at usual precision."""
    usual = folder / f"usual{version}.spz"
    write_spz(scene, usual, force=True, version=version, precision="usual")
    written = float(usual.stat().st_size)
    name = f"SPZ {version}, usual precision: written here and there"
    return Finding(name, "bytes", written, written, float(theirs.stat().st_size))


def check_spz_frames(modules: Path, scene: Splats, folder: Path) -> list[Finding]:
    """Check SPZ in every coordinate system, and version 2, with the SPZ library.

    Gaussians are compared by covariance: both programs permute axes differently, which changes
    quaternions and scales.
    """
    plain = folder / "plain.spz"
    write_spz(scene, plain, force=True, sh1_bits=8, sh_rest_bits=8)
    data = plain.read_bytes()
    paths = []
    for number in range(1, 17):
        # Header with the extension flag and the shifted table of contents, one record, the rest.
        record = struct.pack("<III", _EXTENSION, 4, number)
        head = bytearray(data[:32])
        head[14] |= 2
        struct.pack_into("<I", head, 16, 32 + len(record))
        path = folder / f"system{number}.spz"
        path.write_bytes(bytes(head) + record + data[32:])
        paths.append(path)
    second = folder / "ours2.spz"
    write_spz(scene, second, force=True, sh1_bits=8, sh_rest_bits=8, version=2)
    script = folder / "read_spz.mjs"
    script.write_text(_READ_SPZ, encoding="utf-8")
    run(
        [
            "node",
            str(script),
            str((modules / _LIBRARY).resolve()),
            *map(str, (plain, second, *paths)),
        ]
    )
    findings = []
    for number, path in enumerate(paths, 1):
        read = read_spz(path)
        there = _read_floats(path.with_name(path.name + ".floats"), len(scene))
        apart = {
            "means": np.abs(read.means - there.means),
            "covariances": _relative_errors(_covariances(read), _covariances(there)),
            "shN": np.abs(read.shN - there.shN),
        }
        findings += [
            Finding(
                f"SPZ coordinate system {number}: read here and there",
                *(name, float(off.max()), float(off.mean()), 1e-5),
            )
            for name, off in apart.items()
        ]
    again = read_spz(plain.with_name(plain.name + ".v2"))
    findings += compare_scenes("SPZ 2, theirs: read here and the scene", again, scene, _SPZ_STEPS_2)
    there = _read_floats(second.with_name(second.name + ".floats"), len(scene))
    findings += compare_scenes("SPZ 2, ours: read there and the scene", there, scene, _SPZ_STEPS_2)
    read = read_spz(second)
    findings += compare_scenes("SPZ 2, ours: read here and there", read, there, _ROUNDING_2)
    return findings


def _read_floats(path: Path, count: int) -> Splats:
    """Read a FILE.floats of `_READ_SPZ`."""
    values = np.fromfile(path, "<f4")
    widths = (3, 3, 4, 1, 3, 45)
    parts = np.split(values, np.cumsum([count * width for width in widths])[:-1])
    means, scales, quats, opacities, sh0, sh = parts
    return Splats(
        means=means.reshape(count, 3),
        scales=scales.reshape(count, 3),
        quats=np.roll(quats.reshape(count, 4), 1, axis=1),
        opacities=opacities,
        sh0=sh0.reshape(count, 3),
        shN=sh.reshape(count, 15, 3),
    )


def _covariances(splats: Splats) -> F64:
    """Return the covariance of each splat, (N, 3, 3)."""
    spread = matrices(unit(splats.quats)) * np.exp(splats.scales.astype(np.float64))[:, None, :]
    out: F64 = spread @ spread.transpose(0, 2, 1)
    return out


def _relative_errors(actual: F64, expected: F64) -> F64:
    """Return the relative Frobenius errors of matrices, (N,)."""
    out: F64 = np.linalg.norm(actual - expected, axis=(1, 2))
    out /= np.linalg.norm(expected, axis=(1, 2))
    return out


def check_splat(modules: Path, scene: Splats, folder: Path) -> list[Finding]:
    """Check .splat files as read by the converter, which cannot write the format."""
    path = folder / "ours.splat"
    with warnings.catch_warnings():
        # The format stores no SH; the warning is expected.
        warnings.simplefilter("ignore", CogsplatWarning)
        write_splat(scene, path, force=True)
    there = read_ply(convert(modules, path, folder / "splat.ply"))
    # The converter reads quaternion bytes with 127.5 as zero.
    allowed = {**_ROUNDING, "quats": 1.5 / 128}
    return compare_scenes(".splat, ours: read here and there", read_splat(path), there, allowed)


def check_ksplat(modules: Path, scene: Splats, folder: Path) -> list[Finding]:
    """Check .ksplat files of every compression level, written by the viewer.

    Rows are compared with those of the converter and with level 0, which has the same order. Level
    0 is compared with the scene, rows sorted by position.
    """
    source, script = folder / "scene.ply", folder / "make_ksplat.mjs"
    write_ply(scene, source, force=True)
    script.write_text(_MAKE_KSPLAT, encoding="utf-8")
    findings: list[Finding] = []
    for degree in range(3):
        exact = None
        for level in range(3):
            path = folder / f"{level}{degree}.ksplat"
            module = str((modules / _VIEWER).resolve())
            run(["node", str(script), module, *map(str, (source, level, degree, path))])
            read = read_ksplat(path)
            there = read_ply(convert(modules, path, path.with_suffix(".ply")))
            check = f".ksplat level {level}, SH {degree}"
            findings += compare_scenes(f"{check}: read here and there", read, there, _ROUNDING)
            if exact is None:
                exact = read
                cut = scene.with_sh_degree(degree)
                one, other = (s.take(np.lexsort(s.means.T)) for s in (read, cut))
                steps = {**_ROUNDING, "opacities": 1 / 255, "sh0": 1 / 255 / 0.282}
                findings += compare_scenes(f"{check}: read here and the scene", one, other, steps)
            else:
                # Blocks of 5 units with 2^16 steps, half floats rounded towards zero, SH bytes
                # rounded down.
                steps = {
                    "means": 2.5 / 65534 + 1e-5,
                    "scales": 2**-10,
                    "quats": 2**-10,
                    "opacities": 0.0,
                    "sh0": 0.0,
                    "shN": 2**-10 if level == 1 else 2 / 255,
                }
                findings += compare_scenes(f"{check}: and level 0", read, exact, steps)
    return findings


def report(findings: list[Finding], splats: int, as_json: bool) -> NoReturn:
    """Print the findings and exit, with status 1 if a check failed."""
    failed = sum(not finding.passed for finding in findings)
    if as_json:
        rows = [{**vars(finding), "passed": finding.passed} for finding in findings]
        print_json({"splats": splats, "failed": failed, "findings": rows})
    else:
        print_table(
            ("check", "attribute", "max", "mean", "allowed", ""),
            [
                (
                    *(f.check, f.attribute, f"{f.greatest:.3g}", f"{f.mean:.3g}"),
                    *(f"{f.allowed:.3g}", "" if f.passed else "FAILED"),
                )
                for f in findings
            ],
            left=2,
        )
        print_line(
            f"{failed} of {len(findings)} failed" if failed else f"all {len(findings)} passed"
        )
    sys.exit(1 if failed else 0)


@click.command()
@click.argument("modules", type=PATH)
@click.option("--splats", default=20_000, show_default=True, help="Size of the synthetic scene.")
@json_option
def main(modules: Path, splats: int, as_json: bool) -> None:
    """Print the differences to third-party programs; fail if one exceeds its bound."""
    scene = _clip(synth(splats))
    with tempfile.TemporaryDirectory() as name:
        findings = [
            *check_spz(modules, scene, Path(name)),
            *check_spz_frames(modules, scene, Path(name)),
            *check_splat(modules, scene, Path(name)),
            *check_ksplat(modules, scene, Path(name)),
        ]
    report(findings, splats, as_json)


if __name__ == "__main__":
    main()
