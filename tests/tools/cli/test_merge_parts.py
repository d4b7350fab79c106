"""merge --parts: from a scene to parts and to one file, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from running import Run

import cogsplat
from cogsplat.codec.metrics import psnr
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras


@pytest.fixture(scope="module")
def parts(run: Run, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The encoded parts of a scene, each beside its PLY."""
    folder = tmp_path_factory.mktemp("parts")
    scene = folder / "scene.ply"
    cogsplat.write(synth(1200, sh_degree=1), scene)
    told = run("split", scene, folder / "parts", "--splats", 400, "--quiet")
    assert told.code == 0, told.err
    manifest = folder / "parts" / "parts.toml"
    told_options = '[options]\npreset = "fast"\nno-prune = true\n'
    manifest.write_text(manifest.read_text().replace("[options]\n", told_options))
    assert run("batch", manifest, "--quiet").code == 0
    return sorted((folder / "parts").glob("*.cogs"))


def test_a_scene_comes_back_from_its_parts(run: Run, parts: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "all.cogs"
    assert len(parts) >= 3
    told = run("merge", *parts, out, "--parts", "--json")
    assert (told.code, told.err) == (0, "")
    assert told.json["bytes"] == out.stat().st_size
    assert (told.json["sh_degree"], told.json["objects"]) == (1, [])
    assert told.json["splats"] == 1200
    assert run("check", out).code == 0
    for camera in synth_cameras(2, 160, 120):
        pictures = [
            np.clip(cogsplat.render(splats, camera), 0, 1)
            for splats in (cogsplat.decode(out), synth(1200, sh_degree=1))
        ]
        assert psnr(*pictures) > 32
    told = run("merge", *parts, out, "--parts")
    assert told.code == 2
    assert "--force" in told.err
    told = run("merge", *parts, out, "--parts", "--force")
    assert told.code == 0
    assert "1,200 splats" in told.out
    assert f"parts       {len(parts)}" in told.out


def test_parts_with_codebooks_of_their_own_are_refused(
    run: Run, parts: list[Path], tmp_path: Path
) -> None:
    own, out = tmp_path / "001.cogs", tmp_path / "all.cogs"
    scene = parts[1].with_suffix(".ply")
    told = run("encode", scene, own, "--cells", "--preset", "fast", "--quiet")
    assert told.code == 0
    told = run("merge", parts[0], own, *parts[2:], out, "--parts")
    assert told.code == 3
    assert "other codebooks" in told.err
    assert "--basis-of" in told.err
    assert not out.exists()
    told = run("merge", parts[0], parts[1], parts[0], "--parts", "--force")
    assert told.code == 2
    assert "input" in told.err
    for options in (("--scale", "1:2"), ("--format", "ply")):
        assert run("merge", *parts, out, "--parts", *options).code == 2
    vq = tmp_path / "vq.cogs"
    told = run("encode", scene, vq, "--basis-of", parts[0], "--profile", "vq")
    assert told.code == 2
    assert "transform" in told.err
