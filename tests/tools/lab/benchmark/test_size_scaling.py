import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner

from cogsplat.tools.lab.benchmark.size_scaling import Step, charts, fit_line, main


def test_a_line_is_found_and_its_deviation_said() -> None:
    line = fit_line([1000, 2000, 5000], [30.0, 40.0, 70.0])
    assert line.fixed == pytest.approx(20.0)
    assert line.per_splat == pytest.approx(0.01)
    assert line.largest_deviation == pytest.approx(0.0, abs=1e-12)
    bent = fit_line([1000, 2000, 5000], [30.0, 60.0, 70.0])
    assert 0.1 < bent.largest_deviation < 0.5
    with pytest.raises(ValueError, match="at least two sizes"):
        fit_line([1000, 1000], [1.0, 2.0])


def test_charts_have_a_point_for_each_step() -> None:
    steps = [
        Step(what, splats, 1.0, splats * 1e-5, splats * 700, splats)
        for splats in (1000, 4000)
        for what in ("synth", "encode")
    ]
    for name, chart in charts(steps).items():
        assert name.endswith(".svg")
        ElementTree.fromstring(chart)
        assert "encode" in chart
        assert "4,096" in chart


def test_each_step_runs_in_a_process_of_its_own(tmp_path: Path) -> None:
    options = ["--splats", "600,1500", "--views", "1", "--threads", "1", "--json"]
    done = CliRunner().invoke(main, [*options, "--out", str(tmp_path / "scaling")])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert [(step["what"], step["splats"]) for step in told["steps"]] == [
        (what, splats) for splats in (600, 1500) for what in ("synth", "encode", "decode")
    ]
    for step in told["steps"]:
        assert step["cpu_seconds"] > 0
        # An interpreter with numpy takes more than 20 MB, and none of these scenes a gigabyte.
        assert 20e6 < step["peak_bytes"] < 1.5e9
        assert step["written_bytes"] > 1000
    assert set(told["lines"]) == {"synth", "encode", "decode"}
    assert sorted(path.name for path in (tmp_path / "scaling").iterdir()) == [
        "scaling-memory.svg",
        "scaling-time.svg",
    ]


@pytest.mark.parametrize("text", ["", "0", "many", "10,-1"])
def test_sizes_that_are_none_are_misuse(text: str) -> None:
    done = CliRunner().invoke(main, ["--splats", text])
    assert done.exit_code == 2
    assert "expected numbers" in done.stderr


def test_a_share_of_no_file_is_no_cap() -> None:
    done = CliRunner().invoke(main, ["--splats", "600", "--memory", "20%"])
    assert done.exit_code == 2
    assert "expected bytes such as" in done.stderr
