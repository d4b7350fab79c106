"""Check our compressed PLY, SOG, glTF, SPZ and .splat against PlayCanvas' converter, both ways.

Run ``python -m cogsplat.tools.lab.crosscheck.splat_transform NODE_MODULES`` after, in that folder's
parent, ``npm install @playcanvas/splat-transform@2``. What each side writes is read by both, and
compared with the scene. Version 3 needs ``node`` 22 or later first on the path, and fails the
checks of SPZ: it takes that for PLY's axes where SPZ's own library has RUB.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import click
import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry.rotations import multiply, unit
from cogsplat.codec.splats import Splats
from cogsplat.formats.scenes.compressed_ply import (
    CHUNK_SPLATS,
    read_compressed_ply,
    write_compressed_ply,
)
from cogsplat.formats.scenes.gltf.gltf_scene import read_gltf, write_gltf
from cogsplat.formats.scenes.ply.ply_scene import read_ply, write_ply
from cogsplat.formats.scenes.quantised_values import morton_order
from cogsplat.formats.scenes.sog.sog_scene import read_sog, write_sog
from cogsplat.formats.storage.atomic import StrPath
from cogsplat.tools.lab.synthetic.terrace import synth
from cogsplat.tools.terminal.options import json_option
from cogsplat.tools.terminal.standard_streams import PATH

from .converter import converted
from .spz import Finding, check_splat, check_spz, findings_of, report

F64 = NDArray[np.float64]
Read = Callable[[StrPath], Splats]

# Float32 rounding of values of up to some tens, on either side; SOG's opacities of 0 and 1 are
# read there as a millionth less.
_ROUNDING: Final = {
    "means": 1e-5,
    "scales": 2e-6,
    "quats": 1e-6,
    "opacities": 1.1e-6,
    "sh0": 1e-6,
    "shN": 1e-6,
}

# Half steps of smallest-three components; errors of three come together in the one left out.
_QUATS_10_BITS: Final = 3 * 0.5**0.5 / 1023
_QUATS_8_BITS: Final = 3 * 0.5**0.5 / 255

# The group of turns by half a circle about a Gaussian's own axes, which leave it as it is.
_HALF_TURNS: Final = np.eye(4)


def _half_turned(actual: Splats, expected: Splats) -> Splats:
    """Return the scene with q or -q for each quaternion, the nearer to the expected one."""
    one, other = unit(actual.quats).astype(np.float64), unit(expected.quats).astype(np.float64)
    turned = multiply(one[:, None], _HALF_TURNS[None])
    best = np.abs((turned * other[:, None]).sum(axis=2)).argmax(axis=1)
    return replace(actual, quats=turned[np.arange(len(one)), best].astype(np.float32))


def _matched(scene: Splats, read: Splats, check: str) -> Splats:
    """Return the rows of the scene that match the rows read, one to one."""
    from scipy.spatial import cKDTree

    def key(splats: Splats) -> F64:
        return np.concatenate([splats.means, splats.scales, splats.sh0], axis=1, dtype=np.float64)

    _, rows = cKDTree(key(scene)).query(key(read))
    if len(np.unique(rows)) != len(scene):
        raise click.ClickException(f"{check}: rows do not match the scene's one by one")
    return scene.take(rows)


def _chunk_steps(scene: Splats) -> dict[str, float]:
    """Return the largest errors of a compressed PLY: half a step in its widest chunks."""
    ordered = scene.take(morton_order(scene.means))
    starts = np.arange(0, len(ordered), CHUNK_SPLATS)
    widest = {
        name: float(
            (np.maximum.reduceat(values, starts) - np.minimum.reduceat(values, starts)).max()
        )
        for name, values in (
            ("means", ordered.means),
            ("scales", ordered.scales),
            ("sh0", ordered.sh0),
        )
    }
    return {
        "means": widest["means"] / 1023 / 2,
        "scales": widest["scales"] / 1023 / 2,
        "quats": _QUATS_10_BITS,
        "opacities": 0.5 / 255,
        "sh0": widest["sh0"] / 255 / 2,
        "shN": 8 / 256 / 2,
    }


def _sog_steps(scene: Splats) -> dict[str, float]:
    """Return the largest errors of our SOG: half steps, and the errors of codebooks and palette."""
    logs = np.log1p(np.abs(scene.means.astype(np.float64)))
    furthest = float(np.expm1(logs.max()))
    return {
        "means": 2 * float(logs.max()) / 65535 / 2 * (1 + furthest) * 1.01,
        "scales": 0.5,
        "quats": _QUATS_8_BITS,
        "opacities": 0.5 / 255,
        "sh0": 0.2,
        "shN": 2.0,
    }


def _both_ways(
    name: str,
    suffix: str,
    read: Read,
    allowed: dict[str, float],
    allowed_there: dict[str, float],
    *,
    modules: Path,
    scene: Splats,
    folder: Path,
) -> list[Finding]:
    """Read both programs' files with both programs."""
    findings = []
    for side, steps in (("ours", allowed), ("theirs", allowed_there)):
        path = folder / f"{side}{suffix}"
        check = f"{name}, {side}"
        splats = read(path)
        expected = _matched(scene, splats, check)
        findings += findings_of(f"{check}: read here and the scene", splats, expected, steps)
        there = read_ply(converted(modules, path, folder / f"{side}.back.ply"))
        findings += findings_of(f"{check}: read here and there", splats, there, _ROUNDING)
    return findings


def check_compressed_ply(modules: Path, scene: Splats, folder: Path) -> list[Finding]:
    """Compare both programs' compressed PLY, each read by both, with the scene."""
    source = folder / "scene.ply"
    write_ply(scene, source, force=True)
    write_compressed_ply(scene, folder / "ours.compressed.ply", force=True)
    converted(modules, source, folder / "theirs.compressed.ply")
    steps = _chunk_steps(scene)
    return _both_ways(
        "compressed PLY",
        ".compressed.ply",
        read_compressed_ply,
        steps,
        steps,
        modules=modules,
        scene=scene,
        folder=folder,
    )


def check_sog(modules: Path, scene: Splats, folder: Path) -> list[Finding]:
    """Compare both programs' SOG, each read by both, with the scene."""
    source = folder / "scene.ply"
    write_ply(scene, source, force=True)
    write_sog(scene, folder / "ours.sog", force=True)
    # Without a graphics card it takes seconds for a thousand splats.
    converted(modules, source, folder / "theirs.sog", "-g", "cpu")
    steps = _sog_steps(scene)
    # There numbers are rounded down, which costs whole steps.
    whole = {name: 2 * steps[name] for name in ("means", "quats", "opacities")}
    return _both_ways(
        "SOG",
        ".sog",
        read_sog,
        steps,
        {**steps, **whole},
        modules=modules,
        scene=scene,
        folder=folder,
    )


def check_gltf(modules: Path, scene: Splats, folder: Path) -> list[Finding]:
    """Compare the converter's glTF, which only we read, with the scene and with ours."""
    source = folder / "scene.ply"
    write_ply(scene, source, force=True)
    write_gltf(scene, folder / "ours.glb", force=True)
    converted(modules, source, folder / "theirs.glb")
    ours, theirs = read_gltf(folder / "ours.glb"), read_gltf(folder / "theirs.glb")
    theirs = _half_turned(theirs, scene)
    return [
        *findings_of("glTF, ours: read here and the scene", ours, scene, _ROUNDING),
        *findings_of("glTF, theirs: read here and the scene", theirs, scene, _ROUNDING),
    ]


@click.command()
@click.argument("modules", type=PATH)
@click.option("--splats", default=3000, show_default=True, help="Size of the synthetic scene.")
@json_option
def main(modules: Path, splats: int, as_json: bool) -> None:
    """Print the differences between both programs' readings; fail where one exceeds a step."""
    made = synth(splats)
    # Within what every format holds, so that steps bound every error.
    scene = replace(
        made,
        scales=np.clip(made.scales, -9.9, 5.9),
        sh0=np.clip(made.sh0, -3.3, 3.3),
        shN=np.clip(made.shN, -1, 1),
    )
    checks = (check_compressed_ply, check_sog, check_gltf, check_spz, check_splat)
    findings: list[Finding] = []
    with tempfile.TemporaryDirectory() as name:
        for check in checks:
            findings += check(modules, scene, Path(name))
    report(findings, splats, as_json)


if __name__ == "__main__":
    main()
