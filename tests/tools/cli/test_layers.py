"""layers: a file with levels, what is told of them, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from running import Run, SmallScene

import cogsplat
from cogsplat.codec.geometry import rotations
from cogsplat.codec.render.rasteriser import render

SHORT = ["--scales", "2,1", "--shares", "40%,100%", "--steps", 3]


@pytest.mark.slow
def test_a_scene_becomes_levels_and_they_are_told(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "a.cogs"
    told = run("layers", small.ply, out, "--cameras", small.cameras, *SHORT, "--eval-every", 4)
    assert told.code == 0, told.err
    assert "held-out views" in told.out
    assert [line.split()[0] for line in told.out.splitlines()[2:4]] == ["1/2", "1/1"]
    with cogsplat.open(out) as file:
        assert [level.scale for level in file.root.levels] == [2.0, 1.0]
        file.verify()
        counts = [len(file.decode(level=level)) for level in range(2)]
    source = len(cogsplat.read(small.ply))
    assert 0.3 * source < counts[0] <= 0.4 * source
    assert counts[0] < counts[1] <= source
    again = run("layers", small.ply, out, "--cameras", small.cameras, *SHORT)
    assert (again.code, "[exists]" in again.err) == (2, True)


@pytest.mark.slow
def test_figures_are_those_of_the_file(run: Run, small: SmallScene, tmp_path: Path) -> None:
    out = tmp_path / "a.cogs"
    told = run("layers", small.ply, out, "--cameras", small.cameras, *SHORT, "--json").json
    levels = told["levels"]
    assert isinstance(levels, list)
    assert told["bytes"] == out.stat().st_size
    # The last level fetches all that has not ended, and the last opacities of each chunk.
    assert levels[0]["bytes_fetched"] < levels[1]["bytes_fetched"] <= out.stat().st_size
    assert levels[0]["opacity_bytes"] == 0 < levels[1]["opacity_bytes"]
    for level in levels:
        decoded = cogsplat.decode(out, level=level["level"])
        assert level["splats"] == len(decoded)
        assert level["worst_psnr_db"] <= level["psnr_db"]
        assert 0 < level["ssim"] <= 1
    between = cogsplat.decode(out, level=0.5)
    assert np.isfinite(between.opacities).any()


@pytest.mark.slow
def test_levels_that_show_less_than_an_ordinary_file_are_told(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "a.cogs"
    words = ["layers", small.ply, out, "--cameras", small.cameras, "--force", "--scales", "4,1"]
    words += ["--steps", 40, "--json"]
    good = run(*words, "--shares", "30%,60%").json
    assert all(level["psnr_db"] > level["prefix_psnr_db"] for level in good["levels"])
    assert "warnings" not in good
    # Nearly all splats are trained for small pictures and stay as they are.
    bad = run(*words, "--shares", "95%,100%").json
    assert bad["levels"][1]["psnr_db"] < bad["levels"][1]["prefix_psnr_db"]
    assert 0 < bad["levels"][1]["prefix_splats"] <= 2000
    (warning,) = bad["warnings"]
    assert "at 1/1 the beginning of a file of encode" in warning


@pytest.mark.parametrize(
    "words",
    [
        ["--scales", "1,2"],
        ["--scales", "2,one"],
        ["--scales", "2,1", "--shares", "100%"],
        ["--shares", "8%,25%,60%,120%"],
        ["--scales", "64,1", "--shares", "8%,100%"],
        ["--images", "photos"],
    ],
)
def test_what_means_nothing_is_misuse(
    run: Run, small: SmallScene, tmp_path: Path, words: list[str]
) -> None:
    cameras = [] if "--images" in words else ["--cameras", small.cameras]
    (tmp_path / "photos").mkdir()
    words = [str(tmp_path / word) if word == "photos" else word for word in words]
    told = run("layers", small.ply, tmp_path / "a.cogs", *cameras, *words)
    assert told.code == 2
    assert not (tmp_path / "a.cogs").exists()


def write_model(folder: Path, small: SmallScene, points: int) -> Path:
    """Write photos of a scene, its cameras and some of its means as COLMAP does."""
    splats, cameras = cogsplat.read(small.ply), cogsplat.read_cameras(small.cameras)
    (folder / "images").mkdir(parents=True)
    lenses, images = ["1 PINHOLE {0.width} {0.height} {0.fx} {0.fy} {0.cx} {0.cy}"], []
    for number, camera in enumerate(cameras):
        name = f"{number:03d}.png"
        picture = np.clip(render(splats, camera), 0, 1)
        Image.fromarray(np.round(255 * picture).astype(np.uint8)).save(folder / "images" / name)
        quat = rotations.from_matrices(camera.rotation[None])[0]
        pose = " ".join(map(repr, [*quat.tolist(), *camera.translation.tolist()]))
        images += [f"{number} {pose} 1 {name}", ""]
    rows = np.random.default_rng(1).permutation(len(splats))[:points].tolist()
    lines = [f"{row} {' '.join(map(str, splats.means[row].tolist()))} 99 90 80 0" for row in rows]
    (folder / "cameras.txt").write_text(lenses[0].format(cameras[0]) + "\n")
    (folder / "images.txt").write_text("\n".join(images) + "\n")
    (folder / "points3D.txt").write_text("\n".join(lines) + "\n")
    return folder


@pytest.mark.slow
def test_levels_are_made_of_photos_and_points(run: Run, small: SmallScene, tmp_path: Path) -> None:
    model = write_model(tmp_path / "capture", small, 150)
    out = tmp_path / "a.cogs"
    words = ["--images", model / "images", "--scales", "4,2", "--shares", "40%,100%"]
    words += ["--splats", 400, "--steps", 60, "--eval-every", 4, "--json"]
    told = run("layers", model, out, *words).json
    assert (told["source_splats"], told["test_views"]) == (150, {"from": "given", "count": 3})
    levels = told["levels"]
    assert isinstance(levels, list)
    assert [level["scale"] for level in levels] == [4.0, 2.0]
    assert 80 < levels[0]["splats"] <= 160
    assert levels[0]["splats"] < levels[1]["splats"] <= 400
    # Judged against the photos: what only starts at the points shows next to nothing.
    untrained = run("layers", model, tmp_path / "b.cogs", *words, "--steps", 0)
    for found, begun in zip(levels, untrained.json["levels"], strict=True):
        assert found["psnr_db"] > begun["psnr_db"] + 1.0
        assert found["ssim"] > begun["ssim"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--splats", "400"], "points without --images"),
        (["--images", "images", "--scales", "64,1", "--shares", "8%,100%"], "pixels"),
    ],
)
def test_points_need_photos_of_some_size(
    run: Run, small: SmallScene, tmp_path: Path, words: list[str], said: str
) -> None:
    model = write_model(tmp_path / "capture", small, 9)
    words = [str(model / word) if word == "images" else word for word in words]
    told = run("layers", model, tmp_path / "a.cogs", *words)
    assert told.code == 2
    assert said in told.err
    told = run("layers", small.ply, tmp_path / "a.cogs", "--splats", 9)
    assert told.code == 2
    assert "trained scene" in told.err
