"""views: planned views as cameras to edit and as a contact sheet to look at."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from running import Run, SmallScene

import cogsplat
from cogsplat.codec.splats import empty
from cogsplat.codec.views.planner import ViewPlanConfig, plan_views
from cogsplat.tools.pictures.contact_sheet import THUMBNAIL, contact_sheet


def test_planned_views_are_cameras_that_other_commands_take(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "views.json"
    told = run("lab views", small.ply, out, "--count", 6, "--json")
    assert (told.code, told.err) == (0, "")
    expected = plan_views(cogsplat.read(small.ply), ViewPlanConfig(views=6))
    assert told.json["views"] == len(expected)
    assert told.json["bytes"] == out.stat().st_size
    cameras = cogsplat.read_cameras(out)
    for found, planned in zip(cameras, expected, strict=True):
        np.testing.assert_array_equal(found.rotation, planned.rotation)
        np.testing.assert_array_equal(found.translation, planned.translation)
        assert found.name == planned.name
    scored = run(
        "lab score", small.ply, tmp_path / "a.npy", "--cameras", out, "--no-jitter", "--json"
    )
    assert scored.json["scored_views"] == len(expected)


def test_a_contact_sheet_shows_every_view(run: Run, small: SmallScene, tmp_path: Path) -> None:
    out = tmp_path / "views.png"
    told = run("lab views", small.ply, out, "--count", 5)
    assert told.code == 0
    found = re.search(r"contact sheet of (\d) views", told.out)
    assert found is not None
    assert 5 <= int(found[1]) <= 7
    with Image.open(out) as sheet:
        assert sheet.mode == "RGB"
        assert sheet.width * sheet.height > 5 * THUMBNAIL[0] * THUMBNAIL[1]
        assert np.asarray(sheet).std() > 10.0


def test_an_existing_output_stays_unless_forced(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "views.json"
    out.write_text("mine")
    refused = run("lab views", small.ply, out, "--count", 2)
    assert refused.code == 2
    assert "[exists]" in refused.err
    assert out.read_text() == "mine"
    assert run("lab views", small.ply, out, "--count", 2, "--force", "--quiet").code == 0
    assert 2 <= len(cogsplat.read_cameras(out)) <= 3


@pytest.mark.parametrize("name", ["views.txt", "views", "views.jpeg"])
def test_other_outputs_are_refused(run: Run, small: SmallScene, tmp_path: Path, name: str) -> None:
    told = run("lab views", small.ply, tmp_path / name)
    assert told.code == 2
    assert ".json or .png" in told.err
    assert not (tmp_path / name).exists()


def test_a_scene_without_splats_has_no_views(run: Run, tmp_path: Path) -> None:
    scene = tmp_path / "scene.ply"
    cogsplat.write(empty(0), scene)
    told = run("lab views", scene, tmp_path / "views.json", "--json")
    assert told.code == 3
    error = told.json["error"]
    assert isinstance(error, dict)
    assert error["code"] == "empty-scene"
    assert not (tmp_path / "views.json").exists()


def test_the_help_names_the_default_count(run: Run) -> None:
    assert f"[default: {ViewPlanConfig().views}]" in run("lab views", "--help").out


def test_sheets_hold_pictures_of_any_size_unstretched() -> None:
    width, height = THUMBNAIL
    images = [
        np.full((2 * height, 2 * width, 3), [1.0, 0.0, 0.0]),
        np.full((height // 2, width // 2, 3), [0.0, 1.0, 0.0]),
        np.full((2 * height, height, 3), [0.0, 0.0, 1.0]),
    ]
    sheet = np.asarray(contact_sheet(images, ["large", "small", "a long caption " * 20]))
    for channel, area in enumerate((width * height, width * height // 4, height * height // 2)):
        pure = np.zeros(3, np.uint8)
        pure[channel] = 255
        assert (sheet == pure).all(axis=2).sum() == area


def test_sheets_want_a_caption_for_each_picture() -> None:
    with pytest.raises(ValueError, match="expected one each"):
        contact_sheet([], [])
    with pytest.raises(ValueError, match="expected one each"):
        contact_sheet([np.zeros((4, 4, 3))], ["a", "b"])
