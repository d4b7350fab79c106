"""Cross-check of compressed PLY, SOG, glTF, SPZ and .splat with PlayCanvas' converter.

Run ``python -m cogsplat.tools.lab.crosscheck.splat_transform NODE_MODULES`` after, in that folder's
parent, ``npm install @playcanvas/splat-transform@2``. Files of both programs are read by both and
compared with the scene. Version 3 of the converter needs ``node`` 22 or later and fails the SPZ
checks: it assumes the axes of PLY where the SPZ library uses RUB.
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

from .converter import convert
from .spz import Finding, check_splat, check_spz, compare_scenes, report

F64 = NDArray[np.float64]
Read = Callable[[StrPath], Splats]

# Float32 rounding for values up to a few tens, in both programs. The converter reads SOG opacities
# of 0 and 1 with an offset of 1e-6.
_ROUNDING: Final = {
    "means": 1e-5,
    "scales": 2e-6,
    "quats": 1e-6,
    "opacities": 1.1e-6,
    "sh0": 1e-6,
    "shN": 1e-6,
}

# Half steps of smallest-three components; the omitted component accumulates three errors.
_QUATS_10_BITS: Final = 3 * 0.5**0.5 / 1023
_QUATS_8_BITS: Final = 3 * 0.5**0.5 / 255

# Half turns about a Gaussian's own axes, which leave the Gaussian unchanged.
_HALF_TURNS: Final = np.eye(4)


def _nearest_half_turn(actual: Splats, expected: Splats) -> Splats:
    """Apply to each quaternion the half turn that brings it nearest to the expected one."""
    one, other = unit(actual.quats).astype(np.float64), unit(expected.quats).astype(np.float64)
    rotated = multiply(one[:, None], _HALF_TURNS[None])
    best = np.abs((rotated * other[:, None]).sum(axis=2)).argmax(axis=1)
    return replace(actual, quats=rotated[np.arange(len(one)), best].astype(np.float32))


def _match_rows(scene: Splats, read: Splats, check: str) -> Splats:
    """Reorder the scene to match the rows of a file, one to one."""
    from scipy.spatial import cKDTree

    def key(splats: Splats) -> F64:
        return np.concatenate([splats.means, splats.scales, splats.sh0], axis=1, dtype=np.float64)

    _, rows = cKDTree(key(scene)).query(key(read))
    if len(np.unique(rows)) != len(scene):
        raise click.ClickException(f"{check}: rows do not match the scene's one by one")
    return scene.take(rows)


def _chunk_steps(scene: Splats) -> dict[str, float]:
    """Return the error bounds of a compressed PLY: half a step of the widest chunk."""
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
    """Return the error bounds of SOG: half steps; wider for codebooks and palette."""
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
    """Compare files of both programs, each read by both programs."""
    findings = []
    for side, steps in (("ours", allowed), ("theirs", allowed_there)):
        path = folder / f"{side}{suffix}"
        check = f"{name}, {side}"
        splats = read(path)
        expected = _match_rows(scene, splats, check)
        findings += compare_scenes(f"{check}: read here and the scene", splats, expected, steps)
        there = read_ply(convert(modules, path, folder / f"{side}.back.ply"))
        findings += compare_scenes(f"{check}: read here and there", splats, there, _ROUNDING)
    return findings


def check_compressed_ply(modules: Path, scene: Splats, folder: Path) -> list[Finding]:
    """Check compressed PLY files of both programs."""
    source = folder / "scene.ply"
    write_ply(scene, source, force=True)
    write_compressed_ply(scene, folder / "ours.compressed.ply", force=True)
    convert(modules, source, folder / "theirs.compressed.ply")
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
    """Check SOG files of both programs."""
    source = folder / "scene.ply"
    write_ply(scene, source, force=True)
    write_sog(scene, folder / "ours.sog", force=True)
    # Without a graphics card it takes seconds for a thousand splats.
    convert(modules, source, folder / "theirs.sog", "-g", "cpu")
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
    """Check glTF files of both programs; the converter cannot read glTF."""
    source = folder / "scene.ply"
    write_ply(scene, source, force=True)
    write_gltf(scene, folder / "ours.glb", force=True)
    convert(modules, source, folder / "theirs.glb")
    ours, theirs = read_gltf(folder / "ours.glb"), read_gltf(folder / "theirs.glb")
    theirs = _nearest_half_turn(theirs, scene)
    return [
        *compare_scenes("glTF, ours: read here and the scene", ours, scene, _ROUNDING),
        *compare_scenes("glTF, theirs: read here and the scene", theirs, scene, _ROUNDING),
    ]


@click.command()
@click.argument("modules", type=PATH)
@click.option("--splats", default=3000, show_default=True, help="Size of the synthetic scene.")
@json_option
def main(modules: Path, splats: int, as_json: bool) -> None:
    """Print the differences between both programs; fail if one exceeds its bound."""
    made = synth(splats)
    # Clipped to the range of every format, so that half steps bound all errors.
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
