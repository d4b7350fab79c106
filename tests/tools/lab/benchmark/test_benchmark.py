"""The benchmark: its figures are those of files that are written and measured apart from it."""

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import click
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from running import SPLATS, Run, SmallScene, words_of

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.config import EncodeConfig, Target
from cogsplat.codec.encode.presets import DEFAULT_PRESET, PRESETS
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.errors import CogsplatError, DataError
from cogsplat.codec.fit import tune_config, tuning
from cogsplat.codec.fit.train_config import TrainConfig
from cogsplat.codec.fit.tune_config import TuneConfig, TuneRequest
from cogsplat.codec.fit.tuning_views import choose_tuning_views
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.scoring import view_quality
from cogsplat.codec.scoring.contribution import Scores, score
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.formats.cogs import scene_writer
from cogsplat.tools.evaluation.photos import read_photos
from cogsplat.tools.lab.benchmark import c3dgs_npz, rate_distortion
from cogsplat.tools.lab.benchmark.ablation import changes, equal_quality
from cogsplat.tools.lab.cli.bench import decibels, format_names, profile_names
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras
from cogsplat.tools.pictures.png import to_image
from cogsplat.tools.pictures.svg_charts import Series, bar_chart, line_chart

GREY = (0.5, 0.5, 0.5)


@pytest.fixture(scope="module")
def scene() -> Splats:
    return synth(600)


@pytest.fixture(scope="module")
def scores(scene: Splats) -> Scores:
    config = ScoreConfig(jitter=False, sensitivity_every=1)
    return score(scene, synth_cameras(3, 48, 36), config)


def bench_input(
    splats: Splats, scores: Scores, cameras: Sequence[Camera]
) -> rate_distortion.BenchInput:
    return rate_distortion.BenchInput(
        splats, scores, 0.0, cameras, cameras, cameras, None, (0, 0, 0), 1
    )


@pytest.fixture(scope="module")
def measured(small: SmallScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    from click.testing import CliRunner

    from cogsplat.tools.main import cli

    out = tmp_path_factory.mktemp("bench") / "made" / "here"
    arguments = [
        "lab bench",
        small.ply,
        "--cameras",
        small.cameras,
        "--eval-every",
        4,
        "--out",
        out,
    ]
    arguments += ["--profiles", "transform", "--qualities", "36,30", "--formats", "ply,spz"]
    told = CliRunner().invoke(cli, words_of([*arguments, "--quiet"]))
    assert (told.exit_code, told.stderr) == (0, "")
    assert {path.name for path in out.iterdir()} == {
        "bench.csv",
        "bench.json",
        "prefixes.csv",
        "rate-distortion.svg",
        "received.svg",
    }
    return out


def test_figures_are_those_of_files_made_apart(
    measured: Path, small: SmallScene, tmp_path: Path
) -> None:
    told = json.loads((measured / "bench.json").read_text())
    source = cogsplat.read(small.ply)
    train, held = hold_out(cogsplat.read_cameras(small.cameras), 4)
    assert (told["test_views"]["count"], told["scored_views"], told["splats"]) == (
        len(held),
        len(train),
        SPLATS,
    )
    assert [row["quality_db"] for row in told["methods"]] == [30, 36, None, None]
    scores = score(source, train, PRESETS[DEFAULT_PRESET].score_config("transform"))
    cogsplat.encode(
        source,
        tmp_path / "a.cogs",
        config=EncodeConfig(profile="transform", quality_db=36),
        request=EncodeRequest(cameras=train, scores=scores),
    )
    cogsplat.write(source, tmp_path / "a.spz")
    for name, row in (("a.cogs", told["methods"][1]), ("a.spz", told["methods"][3])):
        found = view_quality.compare(source, cogsplat.read(tmp_path / name), held)
        assert row["bytes"] == (tmp_path / name).stat().st_size
        assert row["bytes_per_splat"] == pytest.approx(row["bytes"] / SPLATS)
        assert row["held_out_db"] == view_quality.mean_psnr_db(found.test)
        assert row["worst_db"] == found.worst.psnr_db
        assert row["roam_ssim"] == view_quality.mean_ssim(found.roaming)
    assert told["methods"][2]["held_out_db"] == 100


def test_tables_hold_the_same(measured: Path) -> None:
    told = json.loads((measured / "bench.json").read_text())
    for name, key in (("bench.csv", "methods"), ("prefixes.csv", "prefixes")):
        with (measured / name).open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert len(rows) == len(told[key]) > 0
        for row, expected in zip(rows, told[key], strict=True):
            assert row == {k: "" if v is None else str(v) for k, v in expected.items()}


def test_stages_of_one_encode_of_each_profile_are_timed(measured: Path) -> None:
    stages = json.loads((measured / "bench.json").read_text())["stages"]
    assert {(stage["method"], stage["quality_db"]) for stage in stages} == {("transform", 36.0)}
    named = [stage["stage"] for stage in stages]
    assert len(set(named)) == len(named)
    assert named[-1] == "write"
    assert {"gain", "quantisers", "chunks", "compensate", "predict"} <= set(named)
    assert all(stage["wall_s"] >= 0 and stage["cpu_s"] >= 0 for stage in stages)


def test_prefixes_end_with_the_whole_file(measured: Path) -> None:
    told = json.loads((measured / "bench.json").read_text())
    last = told["prefixes"][-1]
    whole = next(row for row in told["methods"] if row["quality_db"] == last["quality_db"])
    assert last["bytes"] == whole["bytes"]
    assert last["held_out_db"] == whole["held_out_db"]


def test_charts_show_what_differs(measured: Path) -> None:
    for name in ("rate-distortion.svg", "received.svg"):
        texts = [e.text for e in ElementTree.parse(measured / name).iter() if e.text]
        assert "spz" in texts
        assert "ply" not in texts
    assert "lossless: ply" in (measured / "rate-distortion.svg").read_text()


def test_files_are_not_replaced_unasked(run: Run, small: SmallScene, measured: Path) -> None:
    told = run("lab bench", small.ply, "--formats", "ply", "--profiles", "none", "--out", measured)
    assert told.code == 2
    assert "[exists]" in told.err


def test_the_terminal_gets_a_table_that_fits(run: Run, small: SmallScene) -> None:
    arguments = ["--profiles", "near-lossless", "--formats", "splat,compressed-ply"]
    told = run("lab bench", small.ply, "--cameras", small.cameras, *arguments)
    assert told.code == 0
    lines = told.out.splitlines()
    # The line of times has a stage more for each that takes long, as on a busy machine.
    varying = (str(small.ply.parent), "  time ")
    assert max(len(line) for line in lines if not line.startswith(varying)) <= 100
    starts = [line.split("  ")[0].strip() for line in lines]
    assert {"near-lossless", "splat", "compressed ply"} <= set(starts)


def test_ablation_tells_every_technique(run: Run, tmp_path: Path) -> None:
    cogsplat.write(synth(400), tmp_path / "few.ply")
    write_cameras_json(synth_cameras(4, 32, 24), tmp_path / "cameras.json")
    arguments = ["--cameras", tmp_path / "cameras.json", "--eval-every", 3, "--qualities", 34]
    arguments += ["--ablation", "--out", tmp_path, "--json"]
    told = run("lab bench", tmp_path / "few.ply", *arguments)
    rows = told.json["without"]
    assert isinstance(rows, list)
    assert [row["technique"] for row in rows] == ["nothing", *changes(3)]
    assert rows[0]["more"] == 0
    assert len({row["bytes_per_splat"] for row in rows}) > len(rows) / 2
    with (tmp_path / "ablation.csv").open(newline="") as file:
        assert [row["technique"] for row in csv.DictReader(file)] == [r["technique"] for r in rows]
    ElementTree.parse(tmp_path / "ablation.svg")


@pytest.mark.parametrize(
    "arguments",
    [
        ["--formats", "ksplat"],
        ["--formats", "sp"],
        ["--profiles", "none", "--formats", "none"],
        ["--qualities", "5"],
        ["--qualities", "high"],
        ["--ablation", "--qualities", "30,40"],
        ["--ablation", "--tuned"],
        ["--tuned", "--profiles", "near-lossless"],
    ],
)
def test_misuse_is_told(run: Run, small: SmallScene, arguments: list[str]) -> None:
    assert run("lab bench", small.ply, *arguments).code == 2


def test_names_are_read_by_their_beginnings() -> None:
    assert profile_names("vq, near") == ("vq", "near-lossless")
    assert format_names("c3dgs,ply,PLY,compressed") == (
        rate_distortion.BASELINE,
        "ply",
        "compressed ply",
    )
    assert format_names("none") == ()
    assert decibels("40,30.5,40") == (30.5, 40)
    with pytest.raises(click.BadParameter):
        format_names("")


def test_a_refusal_is_a_row(scene: Splats, scores: Scores, tmp_path: Path) -> None:
    far = replace(scene, means=scene.means + np.float32(1e5))
    camera = synth_cameras(1, 48, 36)
    given = bench_input(scene, scores, camera)
    moved = replace(given, splats=far)
    found = rate_distortion.run(
        moved, tmp_path, profiles=(), qualities=None, formats=[rate_distortion.BASELINE]
    )
    assert [row.refused for row in found.rows] == ["value-range"]
    assert found.prefixes == ()


def test_tuned_files_are_those_of_tune(
    scene: Splats, scores: Scores, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = partial(TuneConfig, round_steps=1, recovery_steps=2, quantised_steps=4)
    monkeypatch.setattr(tune_config, "TuneConfig", short)
    cameras = synth_cameras(3, 48, 36)
    found = rate_distortion.run(
        bench_input(scene, scores, cameras),
        tmp_path,
        profiles=["transform", "near-lossless"],
        qualities=[24.0],
        formats=(),
        tuned=True,
    )
    assert [row.label for row in found.rows] == [
        "transform 24",
        "near-lossless",
        "transform, tuned 24",
    ]
    request = TuneRequest(
        choose_tuning_views(scene, cameras),
        Target(psnr_db=24.0),
        short(train=TrainConfig(threads=1)),
    )
    size_of = partial(scene_writer.size_bytes, writer="benchmark")
    made = tuning.tune(scene, request, size_of=size_of).encoded
    row = found.rows[-1]
    assert row.file_bytes == size_of(made)
    measured = view_quality.compare(scene, made.decoded, cameras, close=False)
    assert row.held_out_db == pytest.approx(view_quality.mean_psnr_db(measured.test), abs=1e-4)
    assert {prefix.label for prefix in found.prefixes} >= {"transform, tuned 24"}


@given(st.integers(1, 1 << 40))
def test_prefixes_double_up_to_the_file(size: int) -> None:
    sizes = rate_distortion.prefix_sizes(size)
    assert sizes[-1] == size
    assert sizes == sorted(set(sizes))
    assert all(a == 32768 << k for k, a in enumerate(sizes[:-1]))
    assert size <= 32768 << (len(sizes) - 1)


@given(
    st.floats(0.01, 0.2),
    st.floats(20, 50),
    st.lists(st.floats(20, 50), min_size=2, max_size=4, unique_by=lambda x: round(x, 1)),
)
def test_bytes_at_equal_quality_lie_on_the_curve(
    slope: float, wanted: float, qualities: list[float]
) -> None:
    points = [(q, math.exp(10 + slope * q), 2 * q - 1) for q in qualities]
    size, roam = equal_quality(points, wanted)
    assert size == pytest.approx(math.exp(10 + slope * wanted), rel=1e-6)
    assert roam == pytest.approx(2 * wanted - 1)


def test_one_quality_is_taken_as_it_is() -> None:
    assert equal_quality([(30.0, 100.0, 29.0)] * 3, 31) == (100, 29)


def test_baseline_keeps_to_its_grids(scene: Splats, scores: Scores, tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    c3dgs_npz.write(scene, scores, path)
    with np.load(path, allow_pickle=False) as stored:
        assert {name: stored[name].dtype.name for name in stored.files if "_" not in name} == {
            "xyz": "float16", "opacity": "int8", "scaling": "int8", "rotation": "int8",
        }  # fmt: skip
        assert stored["feature_indices"].dtype == stored["gaussian_indices"].dtype == np.int32
        assert stored["features_rest"].shape[1:] == (15, 3)
        rows = len(stored["features_dc"])
        step = float(stored["features_dc_scale"])
    seen = scores.colour_sensitivity > 0
    out = c3dgs_npz.read(path)
    assert len(out) == seen.sum() >= rows
    # Rows come back in Morton order: compare as sets, along one axis.
    half = np.sort(scene.means[seen, 0].astype(np.float16).astype(np.float32))
    np.testing.assert_array_equal(np.sort(out.means[:, 0]), half)
    # Fewer splats than rows: each is its own, and what is lost is rounding.
    near = np.sort(scene.sh0[seen, 1])
    assert np.abs(np.sort(out.sh0[:, 1]) - near).max() <= 0.5 * step + 1e-6


def test_baseline_writes_the_same_whatever_the_threads(
    scene: Splats, scores: Scores, tmp_path: Path
) -> None:
    for threads in (1, 3):
        c3dgs_npz.write(scene, scores, tmp_path / f"{threads}.npz", threads=threads)
    assert (tmp_path / "1.npz").read_bytes() == (tmp_path / "3.npz").read_bytes()


def test_baseline_of_nothing_seen_is_refused(scene: Splats, scores: Scores, tmp_path: Path) -> None:
    blind = replace(scores, colour_sensitivity=np.zeros(len(scene)))
    with pytest.raises(DataError) as caught:
        c3dgs_npz.write(scene, blind, tmp_path / "a.npz")
    assert caught.value.code == "no-scores"


def test_photos_are_compared_with(scene: Splats, tmp_path: Path) -> None:
    cameras = [replace(c, name=f"{k}.png") for k, c in enumerate(synth_cameras(2, 48, 36))]
    for camera in cameras:
        drawn = render(scene, camera, RenderConfig(background=GREY))
        to_image(drawn).save(tmp_path / camera.name)
    photos = read_photos(tmp_path, scene, cameras, GREY)
    # Rounding to 8 bits: a uniform error of a step's width.
    assert photos.source_db == pytest.approx(-10 * math.log10(1 / 12 / 255**2), abs=1.5)
    assert photos.psnr_db(scene, GREY) == photos.source_db
    assert photos.psnr_db(scene.take(slice(0, 300)), GREY) < photos.source_db - 3


def test_photos_that_do_not_fit_are_refused(scene: Splats, tmp_path: Path) -> None:
    cameras = [replace(synth_cameras(1, 48, 36)[0], name="a.png")]

    def refusal() -> str:
        with pytest.raises(CogsplatError) as caught:
            read_photos(tmp_path, scene, cameras, GREY)
        return caught.value.code

    assert refusal() == "not-found"
    Image.new("RGB", (36, 48)).save(tmp_path / "a.png")
    assert refusal() == "photo"
    (tmp_path / "a.png").write_bytes(b"no picture")
    assert refusal() == "photo"


@given(st.lists(st.tuples(st.floats(1e-3, 1e9), st.floats(-100, 100)), min_size=0, max_size=5))
def test_charts_hold_any_points(points: list[tuple[float, float]]) -> None:
    series = [Series("<a & b>", tuple(points), 3), Series("none", ())]
    root = ElementTree.fromstring(line_chart("t", "x", "y", series, note="n"))
    ns = "{http://www.w3.org/2000/svg}"
    places = [e.get("transform", "") for e in root.iter(f"{ns}path")]
    # A marker a point, and one in the legend for each series.
    assert len(places) == len(points) + 2
    for place in places:
        x, y = (float(part) for part in place[len("translate(") : -1].split())
        assert 0 <= x <= 860
        assert 0 <= y <= 500


def test_bars_are_as_long_as_their_values() -> None:
    root = ElementTree.fromstring(bar_chart("t", [("a", 10.0), ("b", -5.0)], unit="%"))
    widths = [float(e.get("width", 0)) for e in root.iter("{http://www.w3.org/2000/svg}rect")][1:]
    assert widths[0] == pytest.approx(2 * widths[1], rel=1e-2)
