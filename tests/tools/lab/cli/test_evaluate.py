"""eval: PRoGS' protocol from the command line."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest
from lpips_weights import alex
from PIL import Image
from running import SPLATS, Run, SmallScene

import cogsplat
from cogsplat.codec.encode.presets import DEFAULT_PRESET, PRESETS
from cogsplat.codec.metrics import psnr
from cogsplat.codec.order.orders import ORDERS, OrderInputs, order_rows
from cogsplat.codec.render.rasteriser import render_views
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.views.roam_views import roam
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.formats.storage.source import FileSource, PrefixSource
from cogsplat.tools.lab.cli.evaluation_options import codecs, objects, shares, sizes
from cogsplat.tools.lab.evaluation.progs_protocol import mean_over_log, sizes_of
from cogsplat.tools.workflow.order_options import parse_orders


def mean_db(whole, part, cameras):
    pairs = zip(render_views(whole, cameras), render_views(part, cameras), strict=True)
    return [psnr(a, b) for a, b in pairs]


def test_orders_are_measured_at_shares_of_the_splats(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    told = run(
        "lab evaluate", small.ply, "--cameras", small.cameras, "--eval-every", 4, "--orders",
        "contribution,sgss,random+first-view", "--view", 5, "--shares", "5,20,100", "--sizes",
        "none", "--out", tmp_path, "--json",
    )  # fmt: skip
    assert (told.code, told.err) == (0, "")
    points = told.json["points"]
    assert isinstance(points, list)
    assert len(points) == 9
    splats, cameras = cogsplat.read(small.ply), cogsplat.read_cameras(small.cameras)
    train, held = hold_out(cameras, 4)
    scores = score(splats, train, PRESETS[DEFAULT_PRESET].score_config("transform", top_k=20))
    rows = order_rows("sgss", OrderInputs(splats, scores, train))
    point = points[4]
    assert (point["name"], point["by"], point["splats"]) == ("sgss", "splats", SPLATS // 5)
    part = splats.take(rows[: SPLATS // 5])
    each = mean_db(splats, part, held)
    assert point["held_out_db"] == pytest.approx(np.mean(each), abs=1e-4)
    assert point["worst_db"] == pytest.approx(min(each), abs=1e-4)
    assert point["worst_view"] == held[int(np.argmin(each))].name
    roaming = mean_db(splats, part, roam(splats, held))
    assert point["roam_db"] == pytest.approx(np.mean(roaming), abs=1e-4)
    first = mean_db(splats, part, [cameras[5]])
    assert point["first_view_db"] == pytest.approx(first[0], abs=1e-4)
    assert points[2]["held_out_db"] == 100.0, "all of them"
    means = told.json["mean_over_log"]
    assert isinstance(means, dict)
    own = [p["held_out_db"] for p in points[3:5]]
    assert means["splats"]["sgss"]["held_out_db"] == pytest.approx(np.mean(own), abs=1e-3)

    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "differences-splats.png", "eval.csv", "eval.json", "splats-held-out.svg",
        "splats-roam.svg", "splats-worst.svg", "strips-splats.png",
    ]  # fmt: skip
    with (tmp_path / "eval.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [float(row["held_out_db"]) for row in table] == [p["held_out_db"] for p in points]
    assert json.loads((tmp_path / "eval.json").read_text())["points"] == points
    with Image.open(tmp_path / "strips-splats.png") as picture:
        assert picture.width > 7 * 64
    with Image.open(tmp_path / "differences-splats.png") as apart:
        assert apart.size == picture.size
    assert "sgss" in (tmp_path / "splats-roam.svg").read_text()


def test_files_are_measured_where_they_are_cut(run: Run, small: SmallScene) -> None:
    size = small.cogs.stat().st_size
    arguments = [
        "lab evaluate",
        small.ply,
        "--cameras",
        small.cameras,
        "--shares",
        "none",
        "--eval-every",
    ]
    told = run(*arguments, 4, "--file", small.cogs, "--sizes", "100,40%,100MB", "--json")
    assert told.code == 0, told.err
    points = told.json["points"]
    assert isinstance(points, list)
    assert [point["bytes"] for point in points] == [100, int(0.4 * size), size]
    assert points[0]["splats"] == 0
    held = hold_out(cogsplat.read_cameras(small.cameras), 4)[1]
    source = PrefixSource(FileSource(small.cogs), int(0.4 * size))
    with cogsplat.open(source, partial=True) as file:
        part = file.decode()
    each = mean_db(cogsplat.read(small.ply), part, held)
    assert points[1]["held_out_db"] == pytest.approx(np.mean(each), abs=1e-4)
    assert points[1]["splats"] == len(part)


def test_orders_are_encoded_to_be_measured_by_bytes(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    told = run(
        "lab evaluate", small.ply, "--cameras", small.cameras, "--orders", "contribution,source",
        "--shares", "10", "--quality", 30, "--out", tmp_path / "out",
    )  # fmt: skip
    assert told.code == 0, told.err
    with (tmp_path / "out" / "eval.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["by"] == "bytes"]
    names = [row["name"] for row in rows]
    assert set(names) == {"contribution", "source"}
    for name in set(names):
        own = [int(row["bytes"]) for row in rows if row["name"] == name]
        assert own == sizes_of(own[-1])
    assert "held out dB, by bytes" in told.out
    assert (tmp_path / "out" / "strips-bytes.png").exists()
    assert run("lab evaluate", small.ply, "--out", tmp_path / "out").code == 2, "is there already"


def test_codecs_and_objects_under_several_orders(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    """PRoGS' figures 8 and 9: two scenes merged, each an object."""
    both, out = tmp_path / "both.ply", tmp_path / "out"
    assert run("merge", small.ply, small.ply, both, "--translate", "2:0,0,0.5").code == 0
    told = run(
        "lab evaluate", both, "--cameras", small.cameras, "--eval-every", 4, "--orders",
        "antimatter,random", "--shares", "10,40", "--sizes", "none", "--codecs", "spz,ply",
        "--by-object", "2", "--out", out, "--json",
    )  # fmt: skip
    assert told.code == 0, told.err
    points = told.json["points"]
    assert isinstance(points, list)
    named = [point["name"] for point in points if point["by"] == "bytes"]
    names = [f"{order}, {codec}" for codec in ("spz", "ply") for order in ("antimatter", "random")]
    assert list(dict.fromkeys(named)) == names
    plain = {(p["name"], p["splats"]): p for p in points}
    for count in (2 * SPLATS // 10, 2 * SPLATS * 4 // 10):
        exact, stored = plain["antimatter", count], plain["antimatter, ply", count]
        assert stored["held_out_db"] == pytest.approx(exact["held_out_db"], abs=0.01)
        assert plain["antimatter, spz", count]["bytes"] < stored["bytes"] / 5

    objects = told.json["objects"]
    assert isinstance(objects, list)
    assert {point["object"] for point in objects} == {2}
    figures = {(point["name"], point["share"]): point["psnr_db"] for point in objects}
    assert len(figures) == 8
    # By chance, four in ten splats of the object are there, and eight in ten where it comes first.
    assert figures["random, object first", 0.4] > figures["random", 0.4] + 3
    written = {path.name for path in out.iterdir()}
    assert {"object-2.svg", "bytes-held-out.svg", "differences-splats.png"} <= written
    assert "strips-bytes.png" not in written


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--by-object", "all"], 3, "no-objects"),
        (["--by-object", "1", "--shares", "none"], 2, "expected shares to measure at"),
        (["--codecs", "jpeg"], 2, "expected some of"),
    ],
)
def test_codecs_and_objects_that_are_not_there_are_refused(
    run: Run, small: SmallScene, arguments: list[str], code: int, message: str
) -> None:
    given = ["--cameras", small.cameras, "--orders", "antimatter", "--sizes", "none"]
    if "--shares" not in arguments:
        given += ["--shares", "10"]
    told = run("lab evaluate", small.ply, *given, *arguments)
    assert told.code == code
    assert message in told.err


def test_values_of_options() -> None:
    assert codecs("spz, ply,spz") == ("spz", "ply")
    assert objects("ALL") == ()
    assert objects("3,1") == (3, 1)


def test_lpips_and_photos_are_measured_where_given(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    np.savez(tmp_path / "weights.npz", **alex(4))
    cameras = cogsplat.read_cameras(small.cameras)
    splats = cogsplat.read(small.ply)
    for camera, image in zip(cameras, render_views(splats, cameras), strict=True):
        levels = (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)
        Image.fromarray(levels).save(tmp_path / f"{camera.name}.png")
    renamed = [replace(camera, name=f"{camera.name}.png") for camera in cameras]
    write_cameras_json(renamed, tmp_path / "cameras.json")
    told = run(
        "lab evaluate", small.ply, "--cameras", tmp_path / "cameras.json",
        "--orders", "contribution", "--shares", "10,100", "--sizes", "none",
        "--lpips-weights", tmp_path / "weights.npz",
        "--images", tmp_path, "--json",
    )  # fmt: skip
    assert told.code == 0, told.err
    part, whole = told.json["points"]  # type: ignore[misc]
    assert part["held_out_lpips"] > whole["held_out_lpips"] == 0.0
    assert part["worst_lpips"] >= part["held_out_lpips"]
    assert part["photos_db"] < 40 < whole["photos_db"] < 100, "photos are rounded to 8 bits"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--shares", "none", "--sizes", "none"], "nothing to measure"),
        (["--shares", "0"], "expected percents"),
        (["--sizes", "12 parsecs"], "expected bytes"),
        (["--orders", "contribution,gloss"], "expected one of"),
        (["--orders", "contribution", "--frustum-share", "0.5"], "followed by"),
    ],
)
def test_what_makes_no_sense_is_usage(
    run: Run, small: SmallScene, arguments: list[str], message: str
) -> None:
    told = run("lab evaluate", small.ply, "--cameras", small.cameras, *arguments)
    assert told.code == 2
    assert message in told.err


def test_option_values_are_read() -> None:
    assert shares("0.2, 5,100") == (0.002, 0.05, 1.0)
    assert shares("none") == ()
    assert [one.of(1000) for one in sizes("10%,32KiB")] == [100, 1000]
    assert parse_orders("all") == ORDERS
    assert parse_orders("sgss, source,sgss") == ("sgss", "source")
    with pytest.raises(click.BadParameter):
        shares("five")


def test_area_is_the_mean_over_the_logarithm() -> None:
    assert mean_over_log([(1, 10.0), (4, 20.0)], 4) == 15.0
    assert mean_over_log([(1, 10.0), (4, 20.0)], 16) == 17.5
    assert mean_over_log([(1, 10.0), (2, 20.0), (16, 20.0)], 16) == pytest.approx(18.75)
    assert mean_over_log([(3, 7.0)], 3) == 7.0
    xs = np.linspace(5.0, 9.0, 4001)
    curve = [(float(2**x), float(x**2)) for x in xs]
    assert mean_over_log(curve, 2**9.0) == pytest.approx((9**3 - 5**3) / 12, abs=1e-5)


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        (1, [1]),
        (32768, [32768]),
        (32769, [32768, 32769]),
        (200_000, [32768, 65536, 131072, 200_000]),
    ],
)
def test_lengths_double_to_the_end(size: int, expected: list[int]) -> None:
    assert sizes_of(size) == expected


def test_octree_orders_are_swept_over_depths(run: Run, small: SmallScene, tmp_path: Path) -> None:
    common = [
        "lab evaluate", small.ply, "--cameras", small.cameras, "--eval-every", 4,
        "--shares", "5,20", "--sizes", "none", "--json",
    ]  # fmt: skip
    told = run(
        *common, "--orders", "contribution,octree-quota", "--octree-depths", "0,2,4",
        "--out", tmp_path,
    )  # fmt: skip
    assert (told.code, told.err) == (0, "")
    points = told.json["points"]
    assert isinstance(points, list)
    assert [point["name"] for point in points[::2]] == [
        "contribution", "octree-quota depth 0", "octree-quota depth 2", "octree-quota depth 4",
    ]  # fmt: skip
    # One leaf holds the whole scene: its order is that by contribution.
    assert points[2]["held_out_db"] == points[0]["held_out_db"]
    alone = run(*common, "--orders", "octree-quota", "--octree-depth", 4)
    assert [p["held_out_db"] for p in alone.json["points"]] == [
        p["held_out_db"] for p in points[6:]
    ]
    assert points[6]["held_out_db"] != points[0]["held_out_db"]
    assert "octree-quota depth 4" in (tmp_path / "splats-held-out.svg").read_text()


def test_depths_need_an_order_that_has_one(run: Run, small: SmallScene) -> None:
    told = run(
        "lab evaluate", small.ply, "--orders", "gain,octree-adaptive", "--octree-depths", "1,2"
    )
    assert told.code == 2
    assert "octree-round-robin or octree-quota among them" in told.err
    for text in ("", "1,-2", "21", "1;2"):
        assert run("lab evaluate", small.ply, "--octree-depths", text).code == 2
