"""simulate: a table of policies, moments as CSV, and its refusals."""

import csv
from pathlib import Path

import pytest
from running import Run, SmallScene


def test_policies_are_compared_and_moments_written(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "moments.csv"
    options = ["--cameras", small.cameras, "--policy", "file", "--policy", "views"]
    told = run("simulate", small.cogs, *options, "--moments", 3, "--eval-every", 4, "--csv", out)
    assert told.code == 0, told.err
    assert "views" in told.out
    assert "70%" in told.out
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["policy"] for row in rows] == ["file"] * 3 + ["views"] * 3
    assert float(rows[2]["psnr_db"]) > float(rows[0]["psnr_db"])
    again = run("simulate", small.cogs, *options, "--csv", out)
    assert (again.code, "[exists]" in again.err) == (2, True)


@pytest.mark.parametrize("trace", ["dolly", "file"])
def test_traces_are_those_of_the_paper_or_of_a_file(
    run: Run, small: SmallScene, trace: str
) -> None:
    path = small.cameras if trace == "file" else trace
    told = run(
        "simulate", small.cogs, "--cameras", small.cameras, "--trace", path, "--moments", 1,
        "--policy", "file", "--pose-seconds", 2, "--bandwidth", "5M", "--json",
    )  # fmt: skip
    assert told.code == 0, told.err
    assert told.json["trace_s"] == (16.0 if trace == "file" else 20.0)
    assert told.json["bits_per_second"] == 5e6


def test_charts_and_strips_are_written(run: Run, small: SmallScene, tmp_path: Path) -> None:
    chart, strip = tmp_path / "chart.svg", tmp_path / "strip.png"
    told = run(
        "simulate", small.cogs, "--cameras", small.cameras, "--policy", "file", "--moments", 2,
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


def test_a_size_without_a_bandwidth_is_misuse(run: Run, small: SmallScene) -> None:
    told = run("simulate", small.cogs, "--cameras", small.cameras, "--as-large-as", "734MB")
    assert (told.code, "expected both" in told.err) == (2, True)


def test_other_scenes_and_single_cameras_are_misuse(run: Run, small: SmallScene) -> None:
    told = run("simulate", small.ply, "--cameras", small.cameras)
    assert (told.code, "no COGS file" in told.err) == (2, True)
