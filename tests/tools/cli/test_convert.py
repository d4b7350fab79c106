"""convert, and what is done to a scene on its way."""

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from running import SPLATS, Run, SmallScene

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatWarning, DataError
from cogsplat.codec.geometry.transforms import transform
from cogsplat.codec.splats import SceneInfo
from cogsplat.formats.scenes.registry import FORMATS
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras
from cogsplat.tools.workflow.scene_edits import SceneEdits

WRITABLE = [e for f in FORMATS if f.write for e in f.extensions]


@pytest.mark.parametrize("extension", WRITABLE)
def test_every_writable_format_there_and_back(
    run: Run, small: SmallScene, tmp_path: Path, extension: str
) -> None:
    out, back = tmp_path / f"out{extension}", tmp_path / "back.ply"
    told = run("convert", small.ply, out, "--json")
    assert (told.code, told.err) == (0, "")
    report = told.json
    assert report["bytes"] == out.stat().st_size
    assert report["splats"] == report["source_splats"] == SPLATS
    told = run("convert", out, back)
    assert told.code == 0, told.err
    assert str(back) in told.out
    source, found = cogsplat.read(small.ply), cogsplat.read(back)
    assert len(found) == SPLATS
    # Some formats reorder rows: compare what does not depend on the order.
    np.testing.assert_allclose(
        found.means.mean(axis=0), source.means.mean(axis=0), atol=0.01 * np.ptp(source.means)
    )


def test_cogs_is_read_and_written(run: Run, small: SmallScene, tmp_path: Path) -> None:
    out, spz = tmp_path / "out.cogs", tmp_path / "out.spz"
    told = run("convert", small.ply, out, "--cameras", small.cameras, "--sh", 0, "--json")
    assert (told.code, told.err) == (0, "")
    with cogsplat.open(out) as file:
        assert told.json["splats"] == file.root.splats
        assert file.root.sh_degree == told.json["sh_degree"] == 0
    assert told.json["format"] == "cogs"
    assert run("convert", small.cogs, spz).code == 0
    assert len(cogsplat.read(spz)) == len(cogsplat.read(small.cogs))


def test_cameras_turn_with_the_scene_they_score(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    common = ["--cameras", small.cameras, "--json"]
    plain = run("convert", small.ply, tmp_path / "plain.cogs", *common)
    turned = run(
        "convert", small.ply, tmp_path / "turned.cogs", *common,
        "--rotate", "0,90,0", "--translate", "5,0,-3", "--scale", 2,
    )  # fmt: skip
    assert turned.code == 0
    # Pruning depends on what the cameras see.
    assert turned.json["splats"] == pytest.approx(plain.json["splats"], rel=0.02)


def test_edits_are_made_and_counted(run: Run, tmp_path: Path) -> None:
    scene = synth(400)
    means = scene.means.copy()
    means[7] = np.nan
    source = tmp_path / "scene.ply"
    cogsplat.write(replace(scene, means=means), source)
    x = float(np.median(scene.means[:, 0]))
    told = run(
        "convert", source, tmp_path / "out.ply", "--drop-invalid", "--sh", 1,
        "--crop", f"{x},-1e9,-1e9,1e9,1e9,1e9", "--translate", f"{-x},0,0", "--json",
    )  # fmt: skip
    assert (told.code, told.err) == (0, "")
    assert "1 of 400 splats" in str(told.json["warnings"])
    inside = np.nan_to_num(means[:, 0], nan=-np.inf) >= x
    assert told.json["splats"] == inside.sum()
    assert told.json["splats_edited_out"] == 400 - inside.sum()
    found = cogsplat.read(tmp_path / "out.ply")
    assert found.sh_degree == 1
    expected = (means[inside, 0].astype(np.float64) - x).astype(np.float32)
    np.testing.assert_array_equal(found.means[:, 0], expected)


def test_encode_edits_as_convert_does(run: Run, small: SmallScene, tmp_path: Path) -> None:
    edits = ["--rotate", "90,0,0", "--scale", "0.5", "--crop", "-1,-9,-9,1,9,9", "--sh", "2"]
    cogs, ply = tmp_path / "out.cogs", tmp_path / "out.ply"
    told = run(
        "encode", small.ply, cogs, *edits, "--cameras", small.cameras, "--profile", "near-lossless",
        "--order", "source", "--no-morton", "--no-prune", "--quiet",
    )  # fmt: skip
    assert told.code == 0, told.err
    assert run("convert", small.ply, ply, *edits).code == 0
    found, expected = cogsplat.read(cogs), cogsplat.read(ply)
    assert 0 < len(found) == len(expected) < SPLATS
    assert found.sh_degree == 2
    np.testing.assert_allclose(found.means, expected.means, atol=0.01)


def test_rotations_follow_the_right_hand_about_x_then_y_then_z() -> None:
    x, y, z = np.eye(3)
    np.testing.assert_array_equal(SceneEdits(rotate=(90, 0, 0)).rotation @ y, z)
    np.testing.assert_array_equal(SceneEdits(rotate=(0, 90, 0)).rotation @ z, x)
    np.testing.assert_array_equal(SceneEdits(rotate=(0, 0, 450)).rotation @ x, y)
    np.testing.assert_array_equal(SceneEdits(rotate=(90, 90, 0)).rotation @ y, x)
    oblique = SceneEdits(rotate=(10, -20, 30)).rotation
    np.testing.assert_allclose(oblique @ oblique.T, np.eye(3), atol=1e-15)


def test_camera_sees_the_edited_scene_as_before() -> None:
    scene, camera = synth(50), synth_cameras(1, 64, 48)[0]
    edits = SceneEdits(scale=3.0, rotate=(10, 20, 30), translate=(1, 2, 3))
    before, after = seen(camera, scene.means), seen(edits.camera(camera), edits.apply(
        scene, Path("scene.ply")).means)  # fmt: skip
    np.testing.assert_allclose(after, 3.0 * before, atol=1e-4)
    assert SceneEdits(sh_degree=1).camera(camera) is camera


def seen(camera: Camera, means: np.ndarray) -> np.ndarray:
    return means @ camera.rotation.T + camera.translation


def test_crop_is_in_world_coordinates_with_its_faces() -> None:
    scene = replace(synth(3), info=SceneInfo(origin=(10.0, 0.0, 0.0)))
    means = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], np.float32)
    scene = replace(scene, means=means)
    kept = SceneEdits(crop=(10, 0, 0, 11, 0, 0)).apply(scene, Path("scene.ply"))
    np.testing.assert_array_equal(kept.means, means[:2])
    assert kept.info == scene.info


def test_no_edits_keep_the_scene_itself() -> None:
    scene = synth(3)
    assert SceneEdits().apply(scene, Path("scene.ply")) is scene


def test_transform_is_the_codec_s() -> None:
    scene = synth(20)
    edits = SceneEdits(scale=2.0, rotate=(0, 0, 90), translate=(1, 0, 0))
    found = edits.apply(scene, Path("scene.ply"))
    expected = transform(scene, 2.0, edits.rotation, (1, 0, 0))
    np.testing.assert_array_equal(found.means, expected.means)
    np.testing.assert_array_equal(found.quats, expected.quats)


@pytest.mark.parametrize(
    ("edits", "code"),
    [
        (SceneEdits(crop=(900, 900, 900, 901, 901, 901)), "empty-crop"),
        (SceneEdits(scale=1e39), "moved-too-far"),
    ],
)
def test_edits_that_leave_nothing_usable_are_refused(edits: SceneEdits, code: str) -> None:
    with pytest.raises(DataError) as caught:
        edits.apply(synth(20), Path("scene.ply"))
    assert caught.value.code == code
    assert "scene.ply" in caught.value.message


@pytest.mark.parametrize(
    "arguments",
    [
        ["--crop", "1,2,3"],
        ["--crop", "1,0,0,0,1,1"],
        ["--crop", "nan,0,0,1,1,1"],
        ["--rotate", "1,2"],
        ["--translate", "1,2,inf"],
        ["--scale", "0"],
        ["--scale", "-1"],
        ["--scale", "much"],
        ["--sh", "4"],
        ["--cameras", "cameras.json"],
    ],
)
def test_misuse_is_told_before_any_work(run: Run, tmp_path: Path, arguments: list[str]) -> None:
    told = run("convert", tmp_path / "absent.ply", tmp_path / "out.ply", *arguments)
    assert told.code == 2
    assert "[usage]" in told.err


@pytest.mark.parametrize(
    ("out", "said"), [("out.xyz", "no format has this"), ("out.ksplat", "ksplat cannot be written")]
)
@pytest.mark.parametrize("command", ["convert", "decode"])
def test_unwritable_target_is_misuse_told_before_reading(
    run: Run, tmp_path: Path, command: str, out: str, said: str
) -> None:
    told = run(command, tmp_path / "absent.cogs", tmp_path / out, "--json")
    assert told.code == 2
    error = told.json["error"]
    assert isinstance(error, dict)
    assert error["code"] == "usage"
    assert said in str(error["message"])
    assert "compressed ply (.compressed.ply)" in str(error["message"])


def test_existing_target_is_kept_unless_forced(run: Run, small: SmallScene, tmp_path: Path) -> None:
    out = tmp_path / "out.ply"
    out.write_bytes(b"mine")
    assert run("convert", small.ply, out).code == 2
    assert out.read_bytes() == b"mine"
    told = run("convert", small.ply, out, "--force", "--quiet")
    assert (told.code, told.out, told.err) == (0, "", "")
    assert len(cogsplat.read(out)) == SPLATS


def test_what_a_target_cannot_hold_is_one_warning_line(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "out.splat"
    told = run("convert", small.ply, out, "--quiet")
    assert told.code == 0
    (line,) = told.err.splitlines()
    assert line.startswith("warning: ")
    told = run("convert", small.ply, out, "--force", "--json")
    assert told.err == ""
    assert told.json["warnings"] == [line.removeprefix("warning: ")]


def test_writing_cogs_takes_the_extra_and_says_so(
    run_apart: Run, small: SmallScene, tmp_path: Path
) -> None:
    without = "sys.modules.update(dict.fromkeys(('numba', 'scipy', 'sklearn')))"
    told = run_apart("convert", small.ply, tmp_path / "out.cogs", "--json", before=without)
    assert told.code == 4
    error = told.json["error"]
    assert isinstance(error, dict)
    assert error["code"] == "needs-extra"
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_sog_is_counted_whole(run: Run, small: SmallScene, tmp_path: Path) -> None:
    told = run("convert", small.ply, tmp_path / "meta.json", "--json")
    assert (told.code, told.json["format"]) == (0, "sog")
    assert told.json["bytes"] == sum(path.stat().st_size for path in tmp_path.iterdir())
    assert len(cogsplat.read(tmp_path / "meta.json")) == SPLATS


def test_georeferenced_doubles_there_and_back(run: Run, tmp_path: Path) -> None:
    origin = (691234.0, 5334567.0, 512.0)
    scene = replace(synth(60), info=SceneInfo(origin=origin))
    source, out, cogs, back = (tmp_path / n for n in ("a.ply", "b.ply", "c.cogs", "d.ply"))
    cogsplat.write(scene, source)
    assert run("convert", source, out, "--absolute").code == 0
    header = out.read_bytes().partition(b"end_header")[0]
    assert b"property double x\nproperty double y\nproperty double z\n" in header
    assert run("convert", out, cogs).code == 0
    told = run("decode", cogs, back, "--absolute")
    assert (told.code, told.err) == (0, "")
    with pytest.warns(CogsplatWarning, match="becomes the origin"):
        found = cogsplat.read(back)
    world = found.means.astype(np.float64) + found.info.origin
    stored = cogsplat.decode(cogs)
    expected = stored.means.astype(np.float64) + stored.info.origin
    np.testing.assert_allclose(world, expected, atol=1e-6)
    # What encoding leaves in lies in the box of the source.
    low, high = origin + scene.means.min(axis=0), origin + scene.means.max(axis=0)
    assert ((world > low - 0.1) & (world < high + 0.1)).all()
    for command, given in (("convert", source), ("decode", cogs)):
        told = run(command, given, tmp_path / "out.spz", "--absolute")
        assert told.code == 2
        assert "expected a PLY" in told.err


def test_spz_in_the_precision_of_other_programs_is_smaller(run: Run, tmp_path: Path) -> None:
    source = tmp_path / "small.ply"
    scene = synth(2000)
    cogsplat.write(replace(scene, means=scene.means / 100, scales=scene.scales - 4), source)
    fine, usual = tmp_path / "fine.spz", tmp_path / "usual.spz"
    assert run("convert", source, fine).code == 0
    assert run("convert", source, usual, "--spz-precision", "usual").code == 0
    assert usual.stat().st_size < fine.stat().st_size
    told = run("convert", source, tmp_path / "out.ply", "--spz-precision", "usual")
    assert told.code == 2
    assert "--spz-precision" in told.err
    with pytest.raises(ValueError, match="ply with the option precision, expected absolute"):
        cogsplat.write(scene, tmp_path / "out.ply", spz_precision="usual")


def test_spz_in_versions_for_older_programs(run: Run, small: SmallScene, tmp_path: Path) -> None:
    for version in (2, 3):
        out = tmp_path / f"{version}.spz"
        told = run("convert", small.ply, out, "--spz-version", version)
        assert (told.code, told.err) == (0, "")
        head = gzip.decompress(out.read_bytes())[:8]
        assert head == b"NGSP" + version.to_bytes(4, "little")
    assert run("convert", small.ply, tmp_path / "1.spz", "--spz-version", 1).code == 2
    told = run("decode", small.cogs, tmp_path / "out.ply", "--spz-version", 2)
    assert told.code == 2
    assert "--spz-version" in told.err
