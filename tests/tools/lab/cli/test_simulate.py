"""simulate: a table of policies, moments as CSV, and its refusals."""

import csv
import json
from pathlib import Path

import pytest
from running import Run, SmallScene

import cogsplat
from cogsplat.formats.scenes.sog.sog_scene import write_sog


def test_policies_are_compared_and_moments_written(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "moments.csv"
    options = ["--cameras", small.cameras, "--policy", "file", "--policy", "views"]
    told = run(
        "lab simulate", small.cogs, *options, "--moments", 3, "--eval-every", 4, "--csv", out
    )
    assert told.code == 0, told.err
    assert "views" in told.out
    assert "70%" in told.out
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["policy"] for row in rows] == ["file"] * 3 + ["views"] * 3
    assert float(rows[2]["psnr_db"]) > float(rows[0]["psnr_db"])
    again = run("lab simulate", small.cogs, *options, "--csv", out)
    assert (again.code, "[exists]" in again.err) == (2, True)


@pytest.mark.parametrize("trace", ["dolly", "file"])
def test_traces_are_those_of_the_paper_or_of_a_file(
    run: Run, small: SmallScene, trace: str
) -> None:
    path = small.cameras if trace == "file" else trace
    told = run(
        "lab simulate", small.cogs, "--cameras", small.cameras, "--trace", path, "--moments", 1,
        "--policy", "file", "--pose-seconds", 2, "--bandwidth", "5M", "--requests", 24, "--json",
    )  # fmt: skip
    assert told.code == 0, told.err
    assert told.json["most_requests"] == 24
    assert told.json["trace_s"] == (16.0 if trace == "file" else 20.0)
    assert told.json["bits_per_second"] == 5e6


def test_charts_and_strips_are_written(run: Run, small: SmallScene, tmp_path: Path) -> None:
    chart, strip = tmp_path / "chart.svg", tmp_path / "strip.png"
    told = run(
        "lab simulate", small.cogs, "--cameras", small.cameras, "--policy", "file", "--moments", 2,
        "--policy", "whole", "--plot", chart, "--strip", strip, "--as-stored", "--goal", 30,
        "--bandwidth", "100M", "--as-large-as", "734MB", "--json",
    )  # fmt: skip
    assert told.code == 0, told.err
    size = told.json["bytes"]
    assert told.json["bits_per_second"] == pytest.approx(1e8 * size / 734e6, rel=0.3)
    assert told.json["compensated"] is False
    whole = told.json["policies"][1]
    assert whole["moments"][0]["psnr_db"] < 30.0
    assert all(0.0 <= moment["ssim"] <= 1.0 for moment in whole["moments"])
    assert "<svg" in chart.read_text()
    assert strip.read_bytes().startswith(b"\x89PNG")


def test_what_visitors_fetch_who_wait_is_told(run: Run, small: SmallScene) -> None:
    options = ["--cameras", small.cameras, "--policy", "file", "--policy", "whole", "--wait"]
    told = run("lab simulate", small.cogs, *options, "--moments", 2, "--goal", 20, "--json")
    assert told.code == 0, told.err
    file, whole = told.json["policies"]
    assert whole["waited_bytes"] == [told.json["bytes"]] * 2
    assert 0 < file["waited_bytes"][0] <= file["waited_bytes"][1] < told.json["bytes"]
    assert file["behind_file"] == 0
    # The first answer takes a latency: at the end of the trace a little of the whole is missing.
    assert whole["behind_file"] == 2
    told = run("lab simulate", small.cogs, *options, "--moments", 1)
    assert "waited" in told.out


def test_a_size_without_a_bandwidth_is_misuse(run: Run, small: SmallScene) -> None:
    told = run("lab simulate", small.cogs, "--cameras", small.cameras, "--as-large-as", "734MB")
    assert (told.code, "expected both" in told.err) == (2, True)


def test_other_scenes_and_single_cameras_are_misuse(run: Run, small: SmallScene) -> None:
    told = run("lab simulate", small.ply, "--cameras", small.cameras)
    assert (told.code, "no COGS file" in told.err) == (2, True)


def streamed_sog(folder: Path, scene: Path) -> Path:
    """Write a scene as Streamed SOG of one leaf and two levels, of which one is a half."""
    splats = cogsplat.read(scene)
    for name, rows in (("0_0", slice(None)), ("1_0", slice(0, None, 2))):
        (folder / name).mkdir()
        write_sog(splats.take(rows), folder / name / "meta.json")
    lods = {str(k): {"file": k, "offset": 0, "count": len(splats) // (k + 1)} for k in (0, 1)}
    bound = {"min": splats.means.min(axis=0).tolist(), "max": splats.means.max(axis=0).tolist()}
    index = {"version": 1, "lodLevels": 2, "filenames": ["0_0/meta.json", "1_0/meta.json"]}
    path = folder / "lod-meta.json"
    path.write_text(json.dumps({**index, "tree": {"bound": bound, "lods": lods}}))
    return path


def test_a_client_of_streamed_sog_is_compared_over_the_same_link(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    peer = streamed_sog(tmp_path, small.ply)
    told = run(
        "lab simulate", small.cogs, "--cameras", small.cameras, "--policy", "file", "--moments", 2,
        "--source", small.ply, "--peer", peer, "--bandwidth", "1G", "--plot", tmp_path / "p.svg",
        "--json",
    )  # fmt: skip
    assert told.code == 0, told.err
    assert told.json["compared_with"] == str(small.ply)
    ours, other = told.json["policies"]
    assert (ours["policy"], other["policy"]) == ("file", "streamed-sog")
    # All of both is there: what is missing was lost by the two formats.
    images = sum(path.stat().st_size for path in tmp_path.glob("?_0/*"))
    assert other["moments"][-1]["bytes"] == images
    assert 30.0 < other["moments"][-1]["psnr_db"] < 100.0
    assert 30.0 < ours["moments"][-1]["psnr_db"] < 100.0
    assert "streamed-sog" in (tmp_path / "p.svg").read_text()


def test_another_file_needs_the_scene_that_both_were_made_of(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    peer = streamed_sog(tmp_path, small.ply)
    told = run("lab simulate", small.cogs, "--cameras", small.cameras, "--peer", peer)
    assert (told.code, "--peer without --source" in told.err) == (2, True)
