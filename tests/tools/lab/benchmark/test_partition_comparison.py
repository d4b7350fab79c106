"""The report of partitions: four ways, none cheaper than the bound."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import cogsplat
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.tools.lab.benchmark.partition_comparison import main
from cogsplat.tools.lab.synthetic.rooms import rooms_cameras, synth_rooms


@pytest.fixture
def house(tmp_path: Path) -> list[str]:
    cogsplat.write(synth_rooms(4, 3000, sh_degree=0), tmp_path / "house.ply")
    write_cameras_json(rooms_cameras(4, views=4), tmp_path / "cameras.json")
    return [str(tmp_path / "house.ply"), "--cameras", str(tmp_path / "cameras.json")]


def test_the_integer_program_is_cheapest(house: list[str]) -> None:
    done = CliRunner().invoke(main, [*house, "--cuboids", "60", "--json"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    ways = {way["way"]: way for way in told["ways"]}
    best = ways["ILP"]
    assert best["cost"] == pytest.approx(told["bound"])
    for name in ("straight cuts", "k-d tree", "octree"):
        assert ways[name]["cost"] >= best["cost"] - 1e-9
        assert 1.0 <= ways[name]["waste"] <= told["whole_waste"]
    assert ways["k-d tree"]["cells"] <= best["cells"]


def test_a_table_is_printed(house: list[str]) -> None:
    done = CliRunner().invoke(main, [*house, "--cuboids", "20"])
    assert done.exit_code == 0, done.output
    assert "basic cuboids" in done.stdout
    assert "straight cuts" in done.stdout
