"""split: parts of a scene, their cameras, and the manifest that encodes them."""

import importlib
import shlex
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from running import SPLATS, Run, SmallScene

from cogsplat.formats.cameras.camera_files import read_cameras, write_cameras_json
from cogsplat.formats.scenes.ply.ply_scene import read_ply

batch = importlib.import_module("cogsplat.tools.cli.batch")


def test_parts_are_the_scene(run: Run, small: SmallScene, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "a scene"
    told = run("split", small.ply, folder, "--splats", 600, "--cameras", small.cameras, "--json")
    assert told.code == 0, told.out
    parts = told.json["parts"]
    assert isinstance(parts, list)
    names = ["000.ply", "001.ply", "002.ply", "003.ply", "004.ply"]
    assert [part["output"] for part in parts] == names
    scenes = [read_ply(folder / name) for name in names]
    assert [part["splats"] for part in parts] == list(map(len, scenes))
    assert sum(map(len, scenes)) == SPLATS
    assert max(map(len, scenes)) <= 600
    # The last part is the sky and the hills around the terrace.
    *inner, around = (np.abs(scene.means).max() for scene in scenes)
    assert max(inner) < 0.25 * around
    joined = np.concatenate([scene.means for scene in scenes])
    expected = read_ply(small.ply).means
    np.testing.assert_array_equal(joined[np.lexsort(joined.T)], expected[np.lexsort(expected.T)])
    assert {path.name for path in folder.iterdir()} == {
        *names, "parts.toml", *(part["cameras"] for part in parts)
    }  # fmt: skip
    for part in parts:
        assert len(read_cameras(folder / part["cameras"])) == part["views"] >= 4
    assert told.json["next"] == [
        f"cogsplat batch {shlex.quote(str(folder))}/parts.toml",
        f"cogsplat merge {shlex.quote(str(folder))}/*.cogs OUT.cogs --parts",
    ]


def test_the_manifest_encodes_the_parts(run: Run, small: SmallScene, tmp_path: Path) -> None:
    told = run("split", small.ply, tmp_path, "--splats", 1000, "--cameras", small.cameras)
    assert told.code == 0, told.err
    assert "3 parts" in told.out
    assert "splats      203 to 899 a part" in told.out
    assert tomllib.loads((tmp_path / "parts.toml").read_text()) == {
        "options": {"cells": True},
        "scene": [
            {
                "input": "000.ply",
                "output": "000.cogs",
                "options": {"cameras": "000.cameras.json"},
            },
            {
                "input": "001.ply",
                "output": "001.cogs",
                "options": {"cameras": "001.cameras.json", "basis-of": "000.cogs"},
            },
            {
                "input": "002.ply",
                "output": "002.cogs",
                "options": {"cameras": "002.cameras.json", "basis-of": "000.cogs"},
            },
        ],
    }
    # A scene without view-dependent colour has no codebooks, and these parts no cameras.
    flat, folder = tmp_path / "flat.ply", tmp_path / "flat"
    assert run("convert", small.ply, flat, "--sh", 0).code == 0
    assert run("split", flat, folder, "--splats", 1000, "-q").out == ""
    assert tomllib.loads((folder / "parts.toml").read_text())["scene"] == [
        {"input": f"00{number}.ply", "output": f"00{number}.cogs"} for number in range(3)
    ]


def test_a_camera_that_sees_no_part_is_left_out(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    first = read_cameras(small.cameras)[0]
    away = type(first)(
        first.width, first.height, first.fx, first.fy, first.cx, first.cy,
        np.eye(3), np.array([0.0, 0.0, 900.0]), "away",
    )  # fmt: skip
    write_cameras_json([away], tmp_path / "away.json")
    turned = type(first)(
        first.width, first.height, first.fx, first.fy, first.cx, first.cy,
        np.eye(3), np.array([0.0, 0.0, -900.0]), "turned",
    )  # fmt: skip
    write_cameras_json([turned], tmp_path / "turned.json")
    for name, views in (("away", 1), ("turned", 0)):
        words = ["--cameras", tmp_path / f"{name}.json", "--splats", SPLATS, "--json"]
        told = run("split", small.ply, tmp_path / name, *words)
        part = told.json["parts"][0]  # type: ignore[index]
        assert part["views"] == views
        assert part["cameras"] == ("000.cameras.json" if views else None)
        assert (tmp_path / name / "000.cameras.json").exists() == bool(views)


def test_existing_parts_are_kept_without_force(run: Run, small: SmallScene, tmp_path: Path) -> None:
    words = ["split", small.ply, tmp_path, "--splats"]
    assert run(*words, 600).code == 0
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    told = run(*words, 600)
    assert (told.code, "[exists]" in told.err) == (2, True), told.err
    # Parts of the earlier split would be joined with the three new ones.
    told = run(*words, 1000, "--force")
    assert (told.code, "[other-parts]" in told.err) == (4, True), told.err
    assert "003.ply" in told.err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert run(*words, 600, "--force").code == 0
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    (tmp_path / "0004.cogs").write_bytes(b"")
    assert "[other-parts]" in run(*words, 600, "--force").err


def test_a_part_is_never_the_scene_itself(run: Run, small: SmallScene, tmp_path: Path) -> None:
    scene = tmp_path / "000.ply"
    shutil.copy(small.ply, scene)
    told = run("split", scene, tmp_path, "--splats", 600, "--force")
    assert (told.code, "[output-is-input]" in told.err) == (2, True), told.err
    assert scene.read_bytes() == small.ply.read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["000.ply"]


@pytest.mark.parametrize(
    ("extension", "told"), [("compressed.ply", "such a PLY"), ("spz", "a PLY")]
)
def test_other_formats_are_refused(
    run: Run, small: SmallScene, tmp_path: Path, extension: str, told: str
) -> None:
    scene = tmp_path / f"scene.{extension}"
    assert run("convert", small.ply, scene).code == 0
    refused = run("split", scene, tmp_path / "parts")
    assert refused.code == 3
    assert f"`cogsplat convert` writes {told}" in refused.err
    assert not (tmp_path / "parts").exists()


@pytest.mark.slow
def test_an_interrupted_batch_of_parts_gives_the_same_bytes(
    run: Run, small: SmallScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flat = tmp_path / "flat.ply"
    assert run("convert", small.ply, flat, "--sh", 0).code == 0
    folders = [tmp_path / "whole", tmp_path / "interrupted"]
    for folder in folders:
        words = ["--splats", 1000, "--cameras", small.cameras]
        assert run("split", flat, folder, *words).code == 0
        manifest = folder / "parts.toml"
        manifest.write_text(manifest.read_text().replace("true", 'true\npreset = "fast"'))
    assert run("batch", folders[0] / "parts.toml", "--jobs", 2).code == 0
    encode, outputs = batch._Batch._run, []

    def interrupted(self: object, words: list[str]) -> tuple[int, str, str]:
        outputs.append(words[-1])
        if len(outputs) >= 2:
            raise KeyboardInterrupt
        return encode(self, words)  # type: ignore[no-any-return]

    with monkeypatch.context() as patch:
        patch.setattr(batch._Batch, "_run", interrupted)
        assert run("batch", folders[1] / "parts.toml").code == 130
    assert outputs[:2] == ["000.cogs", "001.cogs"]
    assert [path.name for path in folders[1].glob("*.cogs")] == ["000.cogs"]
    told = run("batch", folders[1] / "parts.toml", "--json")
    assert told.json["counts"] == {"done": 2, "skipped": 1, "failed": 0}
    for name in ("000.cogs", "001.cogs", "002.cogs"):
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()
        chunks = run("info", folders[0] / name, "--json").json["chunk_table"]
        assert all(chunk["cell"] for chunk in chunks)  # type: ignore[attr-defined]
