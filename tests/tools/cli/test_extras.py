"""What splats carry beside what is drawn, and cameras in the file, by the command line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from running import SPLATS, VIEWS, Run, SmallScene

import cogsplat
from cogsplat.codec.splats import Splats
from cogsplat.formats.scenes.registry import FORMATS


@pytest.fixture(scope="module")
def labelled(small: SmallScene, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Splats]:
    rng = np.random.default_rng(3)
    extras = {
        "number": np.arange(SPLATS, dtype=np.uint32),
        "label": rng.integers(0, 9, SPLATS).astype(np.uint8),
        "heat": rng.normal(size=SPLATS),
    }
    splats = replace(cogsplat.read(small.ply), extras=extras)
    path = tmp_path_factory.mktemp("labelled") / "labelled.ply"
    cogsplat.write(splats, path)
    return path, splats


@pytest.mark.parametrize("profile", ["transform", "vq", "near-lossless"])
def test_attributes_go_through_a_cogs_file(
    run: Run, small: SmallScene, labelled: tuple[Path, Splats], tmp_path: Path, profile: str
) -> None:
    source, splats = labelled
    out, back = tmp_path / "a.cogs", tmp_path / "back.ply"
    told = run("encode", source, out, "--cameras", small.cameras, "--profile", profile, "-q")
    assert (told.code, told.err) == (0, "")
    assert run("decode", out, back).code == 0
    found = cogsplat.read(back)
    rows = found.extras["number"]
    assert len(set(rows.tolist())) == len(found)
    for name, values in splats.extras.items():
        assert found.extras[name].dtype == values.dtype
        np.testing.assert_array_equal(found.extras[name], values[rows])
    off = np.abs(found.means - splats.means[rows]).max(axis=1)
    assert np.median(off) < 0.05 * float(np.ptp(splats.means, axis=0).max())


def test_what_holds_them_says_so(
    run: Run, small: SmallScene, labelled: tuple[Path, Splats], tmp_path: Path
) -> None:
    source, splats = labelled
    out = tmp_path / "a.cogs"
    common = ["encode", source, out, "--cameras", small.cameras, "--force"]
    assert run(*common, "--store-cameras").code == 0
    told = run("info", out)
    assert "number u4, label u1, heat f8" in told.out
    assert f"{VIEWS} stored" in told.out
    report = run("info", out, "--json").json
    assert [entry["name"] for entry in report["extras"]] == list(splats.extras)
    assert report["stored_cameras"] == VIEWS
    sizes = {(s["segment"], s["stream"]): s["bytes"] for s in report["attributes"]}
    assert sum(sizes.values()) == out.stat().st_size == report["bytes"]
    assert sizes["attributes", "label"] < sizes["attributes", "heat"]
    assert sizes["cameras", "all columns"] > 100 * VIEWS
    assert "heat f8" in run("info", source).out
    values = run("info", out, "--json", "--statistics").json["statistics"]["values"]
    assert values["extras.label"]["max"] == 8
    assert "extras.heat" in run("info", source, "--statistics").out
    assert run(*common, "--no-extras").code == 0
    with cogsplat.open(out) as file:
        assert not file.root.attributes
        assert not file.cameras()


def test_stored_cameras_are_cameras(run: Run, small: SmallScene, tmp_path: Path) -> None:
    out, turned = tmp_path / "a.cogs", tmp_path / "turned.cogs"
    common = ["--cameras", small.cameras, "--store-cameras", "--eval-every", 4]
    assert run("encode", small.ply, out, *common).code == 0
    found, given = cogsplat.read_cameras(out), cogsplat.read_cameras(small.cameras)
    assert [camera.name for camera in found] == [camera.name for camera in given]
    for one, two in zip(found, given, strict=True):
        np.testing.assert_array_equal(one.rotation, two.rotation)
        np.testing.assert_array_equal(one.translation, two.translation)
    # Judging by them is judging by the file they came from.
    by_file = run("compare", small.ply, out, "--cameras", small.cameras, "--json").json
    by_scene = run("compare", small.ply, out, "--cameras", out, "--json").json
    for report in (by_file, by_scene):
        report.pop("seconds", None)
        report.pop("cpu_seconds", None)
        report.pop("views", None)
        report.pop("test_views", None)
    assert by_file == by_scene
    # They turn with the scene.
    assert run("encode", small.ply, turned, *common, "--rotate", "90,0,0").code == 0
    moved = cogsplat.read_cameras(turned)
    assert not np.allclose(moved[0].rotation, given[0].rotation)


def test_files_without_cameras_are_refused_as_such(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    told = run("render", small.ply, tmp_path / "a.png", "--cameras", small.cogs)
    assert told.code == 3
    assert "has no cameras" in told.err
    told = run("encode", small.ply, tmp_path / "a.cogs", "--store-cameras")
    assert told.code == 2
    assert "--store-cameras without --cameras" in told.err


@pytest.mark.parametrize(
    "extension", [e for f in FORMATS if f.write and f.name != "ply" for e in f.extensions]
)
def test_formats_that_cannot_hold_attributes_say_so_in_one_line(
    run: Run, labelled: tuple[Path, Splats], tmp_path: Path, extension: str
) -> None:
    told = run("convert", labelled[0], tmp_path / f"a{extension}")
    assert told.code == 0
    lines = [line for line in told.err.splitlines() if "cannot hold" in line]
    assert len(lines) == 1
    assert "the attributes number, label, heat" in lines[0]


def test_edits_keep_attributes_with_their_splats(
    run: Run, labelled: tuple[Path, Splats], tmp_path: Path
) -> None:
    source, splats = labelled
    out = tmp_path / "a.ply"
    low, high = np.quantile(splats.means, [0.2, 0.9], axis=0)
    crop = ",".join(str(value) for value in (*low, *high))
    told = run("convert", source, out, "--crop", crop, "--scale", 2, "--sh", 0)
    assert told.code == 0
    found = cogsplat.read(out)
    rows = found.extras["number"]
    assert 0 < len(found) < SPLATS
    np.testing.assert_array_equal(found.means, 2 * splats.means[rows])
    for name, values in splats.extras.items():
        np.testing.assert_array_equal(found.extras[name], values[rows])


def test_info_tells_an_origin_in_full(
    run: Run, labelled: tuple[Path, Splats], tmp_path: Path
) -> None:
    info = replace(labelled[1].info, origin=(499998.0, 4649777.0, 4.5))
    path = tmp_path / "a.ply"
    cogsplat.write(replace(labelled[1], info=info), path)
    assert "(499998, 4649777, 4.5)" in run("info", path).out


def test_a_prefix_without_attributes_says_so(
    run: Run, small: SmallScene, labelled: tuple[Path, Splats], tmp_path: Path
) -> None:
    cogs, out = tmp_path / "a.cogs", tmp_path / "a.ply"
    assert run("encode", labelled[0], cogs, "--cameras", small.cameras, "-q").code == 0
    told = run("decode", cogs, out, "--bytes", "50%")
    assert told.code == 0
    assert "decoded without the attributes number, label, heat" in told.err
    assert not cogsplat.read(out).extras
    told = run("decode", cogs, out, "--splats", 100, "--force")
    assert "attributes" not in told.err
    assert set(cogsplat.read(out).extras) == set(labelled[1].extras)


def test_commands_that_write_leave_them_out_on_demand(
    run: Run, small: SmallScene, labelled: tuple[Path, Splats], tmp_path: Path
) -> None:
    source, _ = labelled
    cogs = tmp_path / "labelled.cogs"
    common = ["--cameras", small.cameras, "--preset", "fast", "--quiet"]
    assert run("encode", source, cogs, *common).code == 0
    written = {
        "convert": ["convert", source, tmp_path / "convert.ply"],
        "decode": ["decode", cogs, tmp_path / "decode.ply"],
        "merge": ["merge", source, source, tmp_path / "merge.ply"],
        "filter": ["filter", source, tmp_path / "filter.ply", "--keep", 100, *common[:2]],
    }
    for name, arguments in written.items():
        told = run(*arguments, "--no-extras", "--quiet")
        assert (told.code, told.err) == (0, ""), name
        found = cogsplat.read(tmp_path / f"{name}.ply")
        assert len(found) > 0
        assert not found.extras, name
    # A format that holds none has nothing to say of them then.
    assert "cannot hold the attributes" in run("convert", source, tmp_path / "a.spz").err
    told = run("convert", source, tmp_path / "b.spz", "--no-extras")
    assert (told.code, told.err) == (0, "")
    enlarged = run("decode", cogs, tmp_path / "larger.ply", "--compensate", "--no-extras", "-q")
    assert (enlarged.code, enlarged.err) == (0, "")
    assert not cogsplat.read(tmp_path / "larger.ply").extras
    smaller = run("convert", source, tmp_path / "again.cogs", "--no-extras", *common[:2], "-q")
    assert (smaller.code, smaller.err) == (0, "")
    with cogsplat.open(tmp_path / "again.cogs") as file:
        assert not file.root.attributes
    told = run("merge", source, source, tmp_path / "merged.cogs", "--no-extras")
    assert told.code == 2
    assert "expected object labels" in told.err
