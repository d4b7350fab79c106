"""score, render, compare: figures and pictures from the command line."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from running import SPLATS, VIEWS, Run, SmallScene

import cogsplat
from cogsplat.codec.render.rasteriser import RenderConfig
from cogsplat.codec.render.rasteriser import render as draw
from cogsplat.codec.scoring.contribution import score as score_splats
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.tools.cli.render import fitted
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras


def picture(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image)


def levels(pixels: np.ndarray) -> np.ndarray:
    return (np.clip(pixels, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def test_score_writes_contributions_in_file_order(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "contribution.npy"
    told = run("lab score", small.ply, out, "--cameras", small.cameras, "--top-k", 5, "--json")
    assert (told.code, told.err) == (0, "")
    values = np.load(out)
    expected = score_splats(
        cogsplat.read(small.ply), cogsplat.read_cameras(small.cameras), ScoreConfig(top_k=5)
    )
    assert values.dtype == np.float64
    np.testing.assert_array_equal(values, expected.contribution)
    assert told.json["splats"] == SPLATS
    assert told.json["unseen"] == int((expected.shown == 0).sum())
    assert told.json["scored_views"] == 3 * VIEWS
    shares = told.json["share_of_splats_holding"]
    assert isinstance(shares, dict)
    top = np.sort(values)[::-1][: round(shares["0.5"] * SPLATS)].sum()
    assert top == pytest.approx(0.5 * values.sum(), rel=0.01)


def test_score_leaves_held_out_cameras_alone(run: Run, small: SmallScene, tmp_path: Path) -> None:
    out = tmp_path / "contribution.npy"
    arguments = ["--cameras", small.cameras, "--no-jitter", "--eval-every", 3]
    told = run("lab score", small.ply, out, *arguments)
    assert told.code == 0
    cameras = cogsplat.read_cameras(small.cameras)
    train = [camera for index, camera in enumerate(cameras) if index % 3]
    expected = score_splats(cogsplat.read(small.ply), train, ScoreConfig(jitter=False))
    np.testing.assert_array_equal(np.load(out), expected.contribution)
    assert "unseen" in told.out


def test_rows_that_cannot_be_drawn_score_nothing(run: Run, tmp_path: Path) -> None:
    scene = synth(300)
    means = scene.means.copy()
    means[7] = np.nan
    cogsplat.write(replace(scene, means=means), tmp_path / "scene.ply")
    write_cameras_json(synth_cameras(3, 64, 48), tmp_path / "cameras.json")
    out = tmp_path / "out.npy"
    told = run(
        "lab score", tmp_path / "scene.ply", out, "--cameras", tmp_path / "cameras.json", "-q"
    )
    assert (told.code, told.out) == (0, "")
    assert "1 of 300 splats have invalid values" in told.err
    assert np.load(out)[7] == 0.0


def test_cameras_that_see_nothing_are_refused(run: Run, small: SmallScene, tmp_path: Path) -> None:
    away = replace(synth_cameras(1, 64, 48)[0], translation=np.array([0.0, 0.0, -1e6]))
    cameras = tmp_path / "cameras.json"
    write_cameras_json([away], cameras)
    for command, first, second in (
        ("encode", small.ply, tmp_path / "out.cogs"),
        ("lab score", small.ply, tmp_path / "out.npy"),
        ("compare", small.ply, small.cogs),
    ):
        told = run(command, first, second, "--cameras", cameras)
        assert told.code == 3, command
        assert "[cameras-see-nothing]" in told.err
    assert list(tmp_path.iterdir()) == [cameras]


def test_render_draws_the_camera_asked_for(run: Run, small: SmallScene, tmp_path: Path) -> None:
    out = tmp_path / "out.png"
    arguments = ["--cameras", small.cameras, "--view", 4, "--background", "0.25,0.5,1"]
    assert run("render", small.ply, out, *arguments).code == 0
    camera = cogsplat.read_cameras(small.cameras)[4]
    config = RenderConfig(background=(0.25, 0.5, 1.0))
    expected = levels(draw(cogsplat.read(small.ply), camera, config))
    np.testing.assert_array_equal(picture(out), expected)


def test_render_of_a_prefix_is_that_prefix(run: Run, small: SmallScene, tmp_path: Path) -> None:
    out = tmp_path / "out.png"
    told = run("render", small.cogs, out, "--splats", 500, "--sh", 0, "--json")
    assert told.code == 0
    with cogsplat.open(small.cogs) as file:
        view = file.root.first_view
    assert view is not None
    part = cogsplat.decode(small.cogs, splats=500, sh_degree=0)
    np.testing.assert_array_equal(picture(out), levels(draw(part, view)))
    assert told.json["splats"] == len(part)
    assert (told.json["width"], told.json["height"]) == (view.width, view.height)


def test_render_makes_views_up_where_there_are_none(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out, other = tmp_path / "out.png", tmp_path / "other.png"
    assert run("render", small.ply, out, "--size", "90x60").code == 0
    assert run("render", small.ply, other, "--size", "90x60", "--view", "0,0,-9,0,0,0,50").code == 0
    first, second = picture(out), picture(other)
    assert first.shape == second.shape == (60, 90, 3)
    assert first.any()
    assert (first != second).any()


def test_render_refuses_a_camera_that_is_not_there(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    arguments = ["--cameras", small.cameras, "--view", VIEWS]
    told = run("render", small.ply, tmp_path / "out.png", *arguments)
    assert told.code == 2
    assert f"expected 0 to {VIEWS - 1}" in told.err


@pytest.mark.parametrize("size", [(128, 96), (128, 48), (32, 96), (200, 10)])
def test_fitted_cameras_cut_nothing_and_distort_nothing(size: tuple[int, int]) -> None:
    camera = replace(synth_cameras(1, 64, 48)[0], cx=30.0, cy=27.0)
    other = fitted(camera, *size)
    assert (other.width, other.height) == size
    assert other.fx / other.fy == pytest.approx(camera.fx / camera.fy)
    for x, y in ((0.0, 0.0), (64.0, 48.0)):
        u = (x - camera.cx) / camera.fx * other.fx + other.cx
        v = (y - camera.cy) / camera.fy * other.fy + other.cy
        assert -1e-9 <= u <= size[0] + 1e-9
        assert -1e-9 <= v <= size[1] + 1e-9


def test_scene_compared_with_itself_is_identical(run: Run, small: SmallScene) -> None:
    told = run("compare", small.ply, small.ply, "--cameras", small.cameras, "--json")
    assert (told.code, told.err) == (0, "")
    for name in ("test", "close", "roam"):
        figures = told.json[name]
        assert isinstance(figures, dict)
        assert figures["psnr_db"] == 100.0
        assert figures["ssim"] == pytest.approx(1.0)


def test_compare_prints_test_close_and_roaming_views(run: Run, small: SmallScene) -> None:
    arguments = ["compare", small.ply, small.cogs, "--cameras", small.cameras, "--eval-every", 4]
    report = run(*arguments, "--json").json
    per_view, held, roam = report["per_view"], report["test"], report["roam"]
    assert isinstance(per_view, dict)
    assert isinstance(held, dict)
    assert isinstance(roam, dict)
    views = per_view["test"]
    assert [view["view"] for view in views] == ["view_00", "view_04", "view_08"]
    assert (held["views"], roam["views"]) == (3, 6)
    assert held["psnr_db"] == pytest.approx(sum(view["psnr_db"] for view in views) / 3)
    worst = min(views, key=lambda view: view["psnr_db"])
    assert held["worst"] == worst
    close = report["close"]
    assert isinstance(close, dict)
    assert close["views"] == 3
    for near, view in zip(per_view["close"], views, strict=True):
        assert near["view"] == f"{view['view']}-close"
        assert near["distance"] < view["distance"]
    told = run(*arguments, "--quiet")
    assert told.err == ""
    assert f"{held['psnr_db']:.2f}" in told.out
    assert worst["view"] in told.out
    assert (
        "one camera in 4; `encode` and `tune` leave out one in 8, or in 4 of 16 to 39" in told.out
    )
    assert f"{worst['distance']:.3g} away" in told.out


def test_compare_takes_parts_and_backgrounds(run: Run, small: SmallScene) -> None:
    arguments = ["compare", small.ply, small.cogs, "--cameras", small.cameras, "--json"]

    def test_db(*more: str) -> float:
        told = run(*arguments, *more)
        assert told.code == 0, told
        figures = json.loads(told.out)["test"]
        return float(figures["psnr_db"])

    whole, part = test_db(), test_db("--splats", "300")
    assert part < whole - 1.0
    assert test_db("--splats", "300", "--background", "white") != part


def test_compare_measures_in_cameras_beside_the_scene(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    scene = tmp_path / "scene.ply"
    scene.write_bytes(small.ply.read_bytes())
    made_up = run("compare", scene, small.cogs, "--eval-every", 24, "--json").json
    assert made_up["test_views"]["from"] == "views planned around the scene"
    write_cameras_json(synth_cameras(3, 64, 48), tmp_path / "eval_cameras.json")
    told = run("compare", scene, small.cogs, "--json").json
    assert "eval_cameras.json" in str(told["test_views"])
    held = told["test"]
    assert isinstance(held, dict)
    assert held["views"] == 3, "all of them"


def test_views_too_small_to_compare_are_refused(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    cameras = tmp_path / "cameras.json"
    write_cameras_json(synth_cameras(2, 64, 8), cameras)
    told = run("compare", small.ply, small.cogs, "--cameras", cameras)
    assert told.code == 3
    assert "[view-too-small]" in told.err


def test_encode_stores_the_up_and_the_view_that_are_given(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "out.cogs"
    common = ["--cameras", small.cameras, "--profile", "near-lossless"]
    pose = "0.5,-2,-6,0,-0.5,0,48"
    told = run("encode", small.ply, out, *common, "--up", "-y", "--view", pose)
    assert told.code == 0, told.err
    stored = run("info", out, "--json").json
    assert stored["up"] == [0.0, -1.0, 0.0]
    first = stored["first_view"]
    assert isinstance(first, dict)
    assert (first["text"], first["target"]) == (pose, [0.0, -0.5, 0.0])
    # Chunks are the same, whatever a viewer starts with.
    other = tmp_path / "other.cogs"
    assert run("encode", small.ply, other, *common).code == 0
    with cogsplat.open(out) as one, cogsplat.open(other) as two:
        assert one.segments.hash.tolist() == two.segments.hash.tolist()
    for option, text in (("--up", "0,0,0"), ("--view", "1,2,3"), ("--view", "east")):
        told = run("encode", small.ply, tmp_path / "no.cogs", *common, option, text)
        assert told.code != 0
        assert "bad-view-text" in told.err
