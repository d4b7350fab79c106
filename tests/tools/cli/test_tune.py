"""tune: a smaller file of fewer splats, checkpoints to go on from, and what is refused."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from running import Run, SmallScene

import cogsplat
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.views.planner import ViewPlanConfig, plan

# Steps of training become as few as they may be.
SHORT = ["--minutes", "0.01", "--target-size", "20KB"]


@pytest.mark.slow
def test_a_scene_becomes_smaller_and_is_told(run: Run, small: SmallScene, tmp_path: Path) -> None:
    out, ply = tmp_path / "a.cogs", tmp_path / "a.ply"
    told = run(
        "tune", small.ply, out, "--cameras", small.cameras, *SHORT, "--ply", ply, "--keep", "40%"
    )
    assert told.code == 2
    assert "40%" in told.err
    told = run(
        "tune", small.ply, out, "--cameras", small.cameras, *SHORT, "--ply", ply, "--keep", 0.9
    )
    assert told.code == 0, told.err
    assert 0.9 * 20_000 < out.stat().st_size <= 20_000
    decoded, trained = cogsplat.decode(out), cogsplat.read(ply)
    assert len(decoded) <= len(trained) == round(0.9 * len(cogsplat.read(small.ply)))
    predicted = re.search(r"predicted +([\d.]+) dB in 2 views left out of the", told.out)
    assert predicted is not None, told.out
    seen = run("compare", small.ply, out, "--cameras", small.cameras, "--json").json["test"]
    assert float(predicted[1]) == pytest.approx(seen["psnr_db"], abs=0.1)  # type: ignore[index]
    assert "trained: 1,800 splats" in told.err
    assert "stored: " in told.err
    again = run("tune", small.ply, out, "--cameras", small.cameras, *SHORT)
    assert (again.code, "[exists]" in again.err) == (2, True)


@pytest.mark.slow
def test_a_preview_stands_in_the_first_chunks_and_counts_in_the_size(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "a.cogs"
    words = ["tune", small.ply, out, "--cameras", small.cameras, *SHORT, "--keep", 0.9, "-q"]
    told = run(*words, "--preview", 0.1)
    assert told.code == 0, told.err
    assert 0.9 * 20_000 < out.stat().st_size <= 20_000
    with cogsplat.open(out) as file:
        file.verify()
        ending = file.chunks.until > 0
        assert ending.tolist() == sorted(ending.tolist(), reverse=True)
        assert ending.any()
        first = file.decode(range(int(ending.sum())), compensate=True)
    source = cogsplat.read(small.ply)
    views = cogsplat.read_cameras(small.cameras)
    seen = np.mean([psnr(render(source, view), render(first, view)) for view in views])
    nothing = np.mean(
        [
            psnr(render(source, view), np.zeros((view.height, view.width, 3), np.float32))
            for view in views
        ]
    )
    assert seen > nothing + 5


@pytest.mark.slow
def test_without_cameras_quality_is_measured_where_nothing_is_trained(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "a.cogs"
    told = run("tune", small.ply, out, *SHORT, "--json")
    assert told.code == 0, told.err
    said = json.loads(told.out)
    source, decoded = cogsplat.read(small.ply), cogsplat.decode(out)
    views = plan(source, ViewPlanConfig()).test_views
    assert said["test_views"] == {"from": "planned", "count": len(views)}
    found = [psnr(render(source, view), render(decoded, view)) for view in views]
    assert said["predicted_psnr_db"] == pytest.approx(np.mean(found), abs=0.3)


@pytest.mark.slow
def test_photos_teach_and_a_checkpoint_goes_on(run: Run, small: SmallScene, tmp_path: Path) -> None:
    splats, cameras = cogsplat.read(small.ply), cogsplat.read_cameras(small.cameras)
    photos = tmp_path / "photos"
    photos.mkdir()
    for camera in cameras:
        pixels = np.clip(render(splats, camera), 0, 1) * 255
        Image.fromarray(np.rint(pixels).astype(np.uint8)).save(photos / f"{camera.name}.png")
    # Photos have the names of cameras, which have no ending here.
    for path in photos.iterdir():
        path.rename(path.with_suffix(""))
    out, kept = tmp_path / "a.cogs", tmp_path / "a.npz"
    words = ["tune", small.ply, out, "--cameras", small.cameras, *SHORT, "--keep", 0.9, "--force"]
    words += ["--images", photos, "--checkpoint", kept, "--quiet"]
    told = run(*words)
    assert (told.code, told.out) == (0, ""), told.err
    first = out.read_bytes()
    assert kept.stat().st_size > 100_000
    # The last checkpoint was made before the scene was trained through the quantisers.
    resumed = run(*words, "--resume")
    assert resumed.code == 0, resumed.err
    assert abs(out.stat().st_size - len(first)) < 0.1 * len(first)
    other = run(*words, "--resume", "--seed", 1)
    assert "[other-checkpoint]" in other.err
    kept.write_bytes(kept.read_bytes()[:1000])
    assert "[bad-checkpoint]" in run(*words, "--resume").err
    kept.write_bytes(b"no archive")
    assert "[foreign-file]" in run(*words, "--resume").err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--target-psnr", 40, "--target-size", 1000], "expected one of them"),
        (["--images", "."], "expected the cameras of the photos"),
        (["--resume"], "expected the file to resume from"),
        (["--target-size", "0%"], "expected"),
        (["--ply", "OUT"], "expected"),
    ],
)
def test_what_makes_no_sense_is_refused_at_once(
    run: Run, small: SmallScene, tmp_path: Path, words: list[object], said: str
) -> None:
    out = tmp_path / "a.cogs"
    told = run("tune", small.ply, out, *(out if word == "OUT" else word for word in words))
    assert told.code == 2
    assert said in told.err
    assert not out.exists()
