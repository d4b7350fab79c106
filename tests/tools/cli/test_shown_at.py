"""--shown-at: files for pictures of one width, measured in such pictures."""

from pathlib import Path

import pytest
from running import Run, SmallScene

import cogsplat
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.views.planner import ViewPlanConfig
from cogsplat.codec.views.view_sets import at_width
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.tools.lab.synthetic.terrace import synth_cameras

FAST = ["--preset", "fast", "--json"]


def test_views_keep_what_they_show_at_another_width(small: SmallScene) -> None:
    cameras = cogsplat.read_cameras(small.cameras)
    first, narrow = cameras[0], at_width(cameras, 32)[0]
    assert (narrow.width, narrow.height) == (32, 24)
    assert narrow.fx / narrow.width == first.fx / first.width
    assert at_width(cameras, None) == cameras
    assert (ViewPlanConfig().at_width(200).width, ViewPlanConfig().at_width(200).height) == (
        200,
        150,
    )


def test_quality_is_chosen_and_told_in_pictures_of_the_width(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    usual, out = tmp_path / "usual.cogs", tmp_path / "small.cogs"
    # So many cameras that they overlap at each width, and no further views are planned.
    cameras = tmp_path / "cameras.json"
    write_cameras_json(synth_cameras(24, 64, 48), cameras)
    given = ["--cameras", cameras, *FAST]
    of_cameras = run("encode", small.ply, usual, *given).json
    told = run("encode", small.ply, out, *given, "--shown-at", "32px", "--measure").json
    assert told["scored_views_from"] == of_cameras["scored_views_from"] == "given"
    # Details below a pixel cost nothing.
    assert told["bytes"] < of_cameras["bytes"]
    words = ["compare", small.ply, out, *given[:2], "--json", "--shown-at", 32]
    seen = run(*words, "--difference", tmp_path / "worst.png").json["test"]
    assert told["predicted_psnr_db"] == pytest.approx(seen["psnr_db"], abs=0.1)
    everywhere = run(*words, "--eval-every", 0).json["test"]
    assert told["prefixes"][-1]["held_out_db"] == pytest.approx(everywhere["psnr_db"], abs=0.1)
    # Splats are as thick as in the pictures of training, whatever the width.
    with cogsplat.open(out) as file, cogsplat.open(usual) as other:
        assert file.root.info.capture == other.root.info.capture != ()
    exact = tmp_path / "exact.cogs"
    assert (
        run("encode", small.ply, exact, *given, "--shown-at", "64px").json["bytes"]
        == (of_cameras["bytes"])
    )
    assert exact.read_bytes() == usual.read_bytes()


def test_planned_views_have_the_width(small: SmallScene, tmp_path: Path) -> None:
    splats = cogsplat.read(small.ply)
    out = tmp_path / "a.cogs"
    request = EncodeRequest(shown_at=100, preset="fast")
    report = cogsplat.encode(splats, out, request=request)
    assert report.views == "planned"
    usual = cogsplat.encode(splats, tmp_path / "b.cogs", preset="fast")
    # Quality is nominal in the pictures of the request, so smaller ones take fewer bytes.
    assert report.size_bytes < usual.size_bytes


def test_training_is_in_pictures_of_the_width(run: Run, small: SmallScene, tmp_path: Path) -> None:
    out = tmp_path / "a.cogs"
    words = ["tune", small.ply, out, "--cameras", small.cameras, "--keep", 0.9, "--json"]
    short = ["--minutes", 0.01, "--target-size", "20KB"]
    told = run(*words, *short, "--shown-at", 32).json
    camera = at_width(cogsplat.read_cameras(small.cameras), 32)[0]
    assert render(cogsplat.decode(out), camera).shape == (24, 32, 3)
    seen = run(
        "compare", small.ply, out, "--cameras", small.cameras, "--json", "--shown-at", 32
    ).json["test"]
    assert told["predicted_psnr_db"] == pytest.approx(seen["psnr_db"], abs=0.1)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["encode", "--shown-at", "8px"], "expected 16px to 8192px"),
        (["encode", "--shown-at", "wide"], "expected 16px to 8192px"),
        (["encode", "--shown-at", "32", "--images", "."], "--images and --shown-at"),
        (["tune", "--shown-at", "32", "--images", "."], "--images and --shown-at"),
    ],
)
def test_what_does_not_fit_is_refused(
    run: Run, small: SmallScene, tmp_path: Path, words: list[str], expected: str
) -> None:
    command, *options = words
    told = run(command, small.ply, tmp_path / "a.cogs", "--cameras", small.cameras, *options)
    assert (told.code, expected in told.err) == (2, True)
    with pytest.raises(ValueError, match="0 px"):
        EncodeRequest(shown_at=0)
