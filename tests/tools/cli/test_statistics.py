"""info --statistics: the same scene in every format, as text and as JSON."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from running import SPLATS, Run, SmallScene

import cogsplat
from cogsplat.codec.splats import empty
from cogsplat.tools.lab.synthetic.terrace import synth
from cogsplat.tools.workflow.statistics_table import bars


@pytest.mark.parametrize("extension", [".ply", ".compressed.ply", ".spz", ".splat", ".sog", ".glb"])
def test_every_format_has_statistics(
    run: Run, small: SmallScene, tmp_path: Path, extension: str
) -> None:
    out = tmp_path / f"scene{extension}"
    assert run("convert", small.ply, out, "--quiet").code == 0
    told = run("info", out, "--json", "--statistics")
    assert (told.code, told.err) == (0, "")
    source, found = run("info", small.ply, "--json", "--statistics").json, told.json
    assert found["splats"] == SPLATS
    assert found["bytes"] == out.stat().st_size
    source, found = source["statistics"], found["statistics"]
    assert found["fill_ratio"] == pytest.approx(source["fill_ratio"], rel=0.05)
    values, expected = found["values"], source["values"]
    assert isinstance(values, dict)
    assert isinstance(expected, dict)
    assert values["means.x"]["mean"] == pytest.approx(expected["means.x"]["mean"], abs=0.05)
    assert sum(values["means.x"]["histogram"]) == SPLATS


BIKER = Path(__file__).parents[4] / "shared" / "data" / "biker"


@pytest.mark.shared
@pytest.mark.skipif(not BIKER.is_dir(), reason="needs ../shared/data/biker")
def test_one_real_scene_in_three_formats(run: Run) -> None:
    names = ("scene.ply", "biker.compressed.ply", "biker.spz")
    scene, *others = (
        run("info", BIKER / name, "--json", "--statistics").json["statistics"] for name in names
    )
    expected = scene["values"]
    assert isinstance(expected, dict)
    for other in others:
        assert (other["splats"], other["invalid_splats"]) == (scene["splats"], 0)
        assert other["fill_ratio"] == pytest.approx(scene["fill_ratio"], rel=0.05)
        values = other["values"]
        assert isinstance(values, dict)
        for name in ("means.x", "means.y", "means.z", "scales.0", "sh0.g", "opacities_unit"):
            assert values[name]["mean"] == pytest.approx(expected[name]["mean"], abs=0.02), name
            assert values[name]["median"] == pytest.approx(expected[name]["median"], abs=0.1), name


def test_cogs_and_its_parts_have_statistics(run: Run, small: SmallScene) -> None:
    whole = run("info", small.cogs, "--json", "--statistics").json
    part = run("info", small.cogs, "--chunks", "0:1", "--sh", 0, "--json", "--statistics").json
    splats = cogsplat.decode(small.cogs, chunks=(0, 1))
    assert whole["splats"] == part["splats"] == whole["statistics"]["splats"]
    part = part["statistics"]
    assert (part["splats"], part["sh_degree"]) == (len(splats), 0)
    values = part["values"]
    assert isinstance(values, dict)
    assert values["means.z"]["max"] == splats.means[:, 2].max()


def test_rows_are_told_with_bars(run: Run, small: SmallScene) -> None:
    told = run("info", small.ply, "--statistics")
    assert told.code == 0
    assert f"{SPLATS:,} splats at SH degree 3" in told.out
    lines = {line.split()[0]: line for line in told.out.splitlines() if line.strip()}
    assert "layers" in lines["fill"]
    for name in ("means.x", "quats.w", "shN.3", "opacities_unit"):
        assert "█" in lines[name], lines[name]


def test_what_is_not_finite_is_counted_and_json_stays_json(run: Run, tmp_path: Path) -> None:
    scene = synth(100)
    scales, opacities = scene.scales.copy(), scene.opacities.copy()
    scales[1], opacities[:3] = np.inf, np.nan
    path = tmp_path / "scene.ply"
    cogsplat.write(replace(scene, scales=scales, opacities=opacities), path)
    report = run("info", path, "--json", "--statistics").json["statistics"]
    assert report["invalid_splats"] == 3
    assert report["fill_ratio"] is None
    values = report["values"]
    assert isinstance(values, dict)
    assert (values["opacities"]["nan"], values["scales.2"]["infinite"]) == (3, 1)
    told = run("info", path, "--statistics")
    assert told.code == 0
    assert "3 splats" in told.out


def test_empty_scenes_are_told(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "scene.ply"
    cogsplat.write(empty(0), path)
    assert run("info", path, "--statistics").code == 0
    report = run("info", path, "--json", "--statistics").json["statistics"]
    assert (report["splats"], report["opaque_share"]) == (0, None)


def test_bars_show_whatever_is_there() -> None:
    assert bars(np.array([0, 1, 500, 1000])) == " ▁▄█"
    assert bars(np.zeros(3, np.int64)) == "   "
    assert bars(np.zeros(0, np.int64)) == ""
