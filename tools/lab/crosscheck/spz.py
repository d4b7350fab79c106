"""Check SPZ, .splat and .ksplat against other people's implementations, both ways.

Run ``python -m cogsplat.tools.lab.crosscheck.spz NODE_MODULES`` after, in that folder's parent,
``npm install @playcanvas/splat-transform@2 @adobe/spz @mkkellogg/gaussian-splats-3d three``. The
second is SPZ's own library, through which the first reads and writes it; the third is where .ksplat
comes from.
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

from .converter import converted, run

F64 = NDArray[np.float64]

_VIEWER: Final = "@mkkellogg/gaussian-splats-3d/build/gaussian-splats-3d.module.js"

_LIBRARY: Final = "@adobe/spz/dist/spz.js"

# Arguments: the library's module and SPZ files. Beside each file goes what the library reads from
# it in RDF, array by array, and the same scene written as version 2.
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

# Arguments: the viewer's module, a PLY, the compression level, the SH degree, the output. No splat
# is left out for its opacity.
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

# Float32 rounding of values of up to some tens, on either side.
_ROUNDING: Final = {
    "means": 1e-5,
    "scales": 1e-5,
    "quats": 1e-5,
    "opacities": 1e-6,
    "sh0": 1e-5,
    "shN": 1e-5,
}

# Half a step of SPZ: `write_spz` states the steps. Three errors of components come together in the
# one that is not stored, and the top level of SH bytes is missing.
_SPZ_STEPS: Final = {
    "means": 2**-13,
    "scales": 1 / 32,
    "quats": 3 * 0.5 * 0.5**0.5 / 511,
    "opacities": 0.5 / 255,
    "sh0": 0.5 / 255 / 0.15,
    "shN": 1 / 16,
}

# There, SH is rounded to bytes before it is rounded to steps.
_SPZ_STEPS_THERE: Final = {**_SPZ_STEPS, "shN": 1 / 16 + 1 / 256}

# Version 2 has the first three components of quaternions in bytes; what is not stored is a root,
# whose error is large where it is near zero.
_SPZ_STEPS_2: Final = {**_SPZ_STEPS, "quats": 0.12, "shN": 1 / 256}

# The root of what rounds to 2^-23 is off by up to its root.
_ROUNDING_2: Final = {**_ROUNDING, "quats": 2**-11.5}

_EXTENSION: Final = 0xADBE0003


@dataclass(frozen=True)
class Finding:
    """Largest difference between two readings of a scene in one attribute, or a number of bytes.

    Parameters
    ----------
    check, attribute : str
    greatest, mean : float
        Of absolute differences; opacities activated, quaternions of unit length and either sign.
    allowed : float
        What `greatest` may be.
    """

    check: str
    attribute: str
    greatest: float
    mean: float
    allowed: float

    @property
    def passed(self) -> bool:
        """Whether the largest difference is a number and at most the allowed one."""
        return self.greatest <= self.allowed * (1 + 1e-4)


def differences(actual: Splats, expected: Splats) -> dict[str, F64]:
    """Return absolute differences by attribute, of two scenes with the same rows.

    Opacities are compared activated, quaternions at unit length and up to their sign.
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


def findings_of(
    check: str, actual: Splats, expected: Splats, allowed: dict[str, float]
) -> list[Finding]:
    """Compare two scenes with the same rows in the attributes that `allowed` names.

    Raises
    ------
    click.ClickException
        They differ in size.
    """
    if len(actual) != len(expected) or actual.sh_degree != expected.sh_degree:
        raise click.ClickException(
            f"{check}: {len(actual)} splats of SH degree {actual.sh_degree}, "
            f"expected {len(expected)} of {expected.sh_degree}"
        )
    apart = differences(actual, expected)
    return [
        Finding(check, name, float(apart[name].max()), float(apart[name].mean()), limit)
        for name, limit in allowed.items()
        if apart[name].size
    ]


def _clipped(splats: Splats) -> Splats:
    """Return the scene clipped to the ranges of SPZ and .ksplat: steps then bound every error."""
    return Splats(
        means=splats.means,
        scales=np.clip(splats.scales, -9.9, 5.9),
        quats=splats.quats,
        opacities=splats.opacities,
        sh0=np.clip(splats.sh0, -3.3, 3.3),
        shN=np.clip(splats.shN, -1, 1),
    )


def check_spz(modules: Path, scene: Splats, folder: Path) -> list[Finding]:
    """Compare SPZ of versions 3 and 4, written and read by both programs, with the scene."""
    findings = []
    source = folder / "scene.ply"
    write_ply(scene, source, force=True)
    for version in (3, 4):
        ours, theirs = folder / f"ours{version}.spz", folder / f"theirs{version}.spz"
        write_spz(scene, ours, force=True, version=version)
        converted(modules, source, theirs, "--spz-version", str(version))
        for name, path in (("ours", ours), ("theirs", theirs)):
            check = f"SPZ {version}, {name}"
            read = read_spz(path)
            steps = _SPZ_STEPS if name == "ours" else _SPZ_STEPS_THERE
            findings += findings_of(f"{check}: read here and the scene", read, scene, steps)
            there = read_ply(converted(modules, path, path.with_suffix(".ply")))
            findings += findings_of(f"{check}: read here and there", read, there, _ROUNDING)
        findings.append(_sizes(scene, version, theirs, folder))
    return findings


def _sizes(scene: Splats, version: int, theirs: Path, folder: Path) -> Finding:
    """Compare the bytes of a scene in the usual precision with those of the other program."""
    usual = folder / f"usual{version}.spz"
    write_spz(scene, usual, force=True, version=version, precision="usual")
    written = float(usual.stat().st_size)
    name = f"SPZ {version}, usual precision: written here and there"
    return Finding(name, "bytes", written, written, float(theirs.stat().st_size))


def check_spz_frames(modules: Path, scene: Splats, folder: Path) -> list[Finding]:
    """Compare readings of SPZ in every coordinate system, and of version 2, with the library's.

    Gaussians are compared by their covariances, since axes that change places change quaternions
    and scales, here and there in different ways.
    """
    plain = folder / "plain.spz"
    write_spz(scene, plain, force=True, sh1_bits=8, sh_rest_bits=8)
    data = plain.read_bytes()
    paths = []
    for number in range(1, 17):
        # The header with its flag for extensions and the moved table of contents, one record, rest.
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
        there = _floats(path.with_name(path.name + ".floats"), len(scene))
        apart = {
            "means": np.abs(read.means - there.means),
            "covariances": _relative(_covariances(read), _covariances(there)),
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
    findings += findings_of("SPZ 2, theirs: read here and the scene", again, scene, _SPZ_STEPS_2)
    there = _floats(second.with_name(second.name + ".floats"), len(scene))
    findings += findings_of("SPZ 2, ours: read there and the scene", there, scene, _SPZ_STEPS_2)
    read = read_spz(second)
    findings += findings_of("SPZ 2, ours: read here and there", read, there, _ROUNDING_2)
    return findings


def _floats(path: Path, count: int) -> Splats:
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
    spread = matrices(unit(splats.quats)) * np.exp(splats.scales.astype(np.float64))[:, None, :]
    out: F64 = spread @ spread.transpose(0, 2, 1)
    return out


def _relative(actual: F64, expected: F64) -> F64:
    """Return the Frobenius norms of differences relative to the expected matrices, (N,)."""
    out: F64 = np.linalg.norm(actual - expected, axis=(1, 2))
    out /= np.linalg.norm(expected, axis=(1, 2))
    return out


def check_splat(modules: Path, scene: Splats, folder: Path) -> list[Finding]:
    """Compare our .splat, as the converter reads it, with the scene; it writes none."""
    path = folder / "ours.splat"
    with warnings.catch_warnings():
        # That SH is left out is known.
        warnings.simplefilter("ignore", CogsplatWarning)
        write_splat(scene, path, force=True)
    there = read_ply(converted(modules, path, folder / "splat.ply"))
    # There, bytes of quaternions are read with 127.5 as zero.
    allowed = {**_ROUNDING, "quats": 1.5 / 128}
    return findings_of(".splat, ours: read here and there", read_splat(path), there, allowed)


def check_ksplat(modules: Path, scene: Splats, folder: Path) -> list[Finding]:
    """Compare readings of the viewer's .ksplat, every level, with two other readers'.

    Rows are compared with what the converter reads, with level 0, whose rows are in the same order,
    and level 0 with the scene, rows sorted by position.
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
            there = read_ply(converted(modules, path, path.with_suffix(".ply")))
            check = f".ksplat level {level}, SH {degree}"
            findings += findings_of(f"{check}: read here and there", read, there, _ROUNDING)
            if exact is None:
                exact = read
                cut = scene.with_sh_degree(degree)
                one, other = (s.take(np.lexsort(s.means.T)) for s in (read, cut))
                steps = {**_ROUNDING, "opacities": 1 / 255, "sh0": 1 / 255 / 0.282}
                findings += findings_of(f"{check}: read here and the scene", one, other, steps)
            else:
                # Blocks of 5 units in 2^16 steps, half floats rounded towards zero, and bytes of SH
                # rounded down.
                steps = {
                    "means": 2.5 / 65534 + 1e-5,
                    "scales": 2**-10,
                    "quats": 2**-10,
                    "opacities": 0.0,
                    "sh0": 0.0,
                    "shN": 2**-10 if level == 1 else 2 / 255,
                }
                findings += findings_of(f"{check}: and level 0", read, exact, steps)
    return findings


def report(findings: list[Finding], splats: int, as_json: bool) -> NoReturn:
    """Print the findings for a scene of so many splats; exit with 1 where one failed."""
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
    """Print the differences from other programs' readings; fail where one exceeds a step."""
    scene = _clipped(synth(splats))
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
