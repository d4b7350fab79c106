"""The demonstration and the bench, on scenes small enough for a test."""

import json
import shutil
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from running import Run, SmallScene

import cogsplat
from cogsplat.tools.lab.benchmark import decode_speed
from cogsplat.tools.lab.cli import demonstration
from cogsplat.tools.lab.synthetic.terrace import synth_cameras


def test_demo_makes_everything_it_names(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demonstration, "synth_cameras", lambda: synth_cameras(32, 64, 48))
    folder = tmp_path / "deep" / "demo"
    told = run("demo", "--out", folder, "--splats", 2000, "--json")
    assert (told.code, told.err) == (0, "")
    report = told.json
    for name in ("scene", "cameras", "cogs", "decoded", "filmstrip"):
        assert Path(str(report[name])).parent == folder
    assert sorted(path.name for path in folder.iterdir()) == sorted(
        path.name for path in demonstration.DemoFiles(folder).all()
    )
    prefixes = report["prefixes"]
    assert isinstance(prefixes, list)
    assert [prefix["share"] for prefix in prefixes] == list(demonstration.SHARES)
    assert [p["splats"] for p in prefixes] == sorted(p["splats"] for p in prefixes)
    assert prefixes[-1]["held_out_db"] > prefixes[0]["held_out_db"] + 5.0
    assert prefixes[-1]["splats"] == len(cogsplat.read(folder / "decoded.ply"))
    with Image.open(folder / "filmstrip.png") as strip:
        assert strip.width > 6 * 64
        assert len(np.unique(np.asarray(strip).reshape(-1, 3), axis=0)) > 1000

    # Nothing is done again over an earlier run.
    told = run("demo", "--out", folder, "--splats", 2000)
    assert told.code == 2
    assert "[exists]" in told.err


def test_demo_needs_a_folder(run: Run, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    told = run("demo", "--out", tmp_path / "file", "--splats", 1000)
    assert told.code == 4
    assert (tmp_path / "file").read_text() == "mine"


def test_bench_times_decodes_against_copies(small: SmallScene) -> None:
    told = CliRunner().invoke(
        decode_speed.main, [str(small.cogs), "--pairs", "2", "--json"], catch_exceptions=False
    )
    assert told.exit_code == 0
    report = json.loads(told.stdout)
    decoded = cogsplat.decode(small.cogs)
    ways = ["numpy, plain", "kernels, plain", "kernels, 1 thread", "kernels, 2 threads"]
    assert [timing["way"] for timing in report["files"]] == ways
    for timing in report["files"]:
        assert (timing["splats"], timing["decoded_bytes"]) == (len(decoded), decoded.nbytes)
        assert len(timing["decode_s"]) == len(timing["copy_s"]) == 2
        assert timing["least_ratio"] > 0.0
    told = CliRunner().invoke(decode_speed.main, [str(small.cogs), "--pairs", "1"])
    assert told.exit_code == 0
    assert str(small.cogs) in told.stdout


# Stands for SPZ's library: takes the file's bytes, and gives arrays unless the file is empty.
LIBRARY = """
export default async () => ({
  CoordinateSystem: { RDF: 1 },
  loadSpzFromBuffer: (bytes, { to }) =>
    bytes.length && to === 1
      ? { positions: 1, scales: 1, rotations: 1, alphas: 1, colors: 1, sh: 1 }
      : {},
});
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_bench_times_another_library_beside(small: SmallScene, tmp_path: Path) -> None:
    library = tmp_path / "@adobe" / "spz" / "dist"
    library.mkdir(parents=True)
    (library / "spz.js").write_text(LIBRARY)
    (library / "package.json").write_text('{"type": "module"}')
    told = CliRunner().invoke(
        decode_speed.main,
        [str(small.cogs), "--pairs", "3", "--json", "--spz", str(tmp_path)],
        catch_exceptions=False,
    )
    assert told.exit_code == 0
    timing = json.loads(told.stdout)["files"][-1]
    assert timing["way"] == "SPZ library, WebAssembly"
    assert len(timing["decode_s"]) == 3
    assert min(timing["decode_s"]) >= 0
    (tmp_path / "empty.spz").write_bytes(b"")
    with pytest.raises(click.ClickException, match="an array is missing"):
        decode_speed.load_spz(tmp_path, tmp_path / "empty.spz", 1)


def test_bench_encodes_scenes_to_time(tmp_path: Path) -> None:
    path = tmp_path / "synth.cogs"
    decode_speed.encode_synth(path, 1200, 0, 2)
    decoded = cogsplat.decode(path)
    assert (len(decoded), decoded.sh_degree) == (1200, 0)


def test_bench_without_anything_to_time_is_misuse() -> None:
    assert CliRunner().invoke(decode_speed.main, []).exit_code == 2


@pytest.mark.parametrize(("times", "ratio"), [((2.0, 6.0, 4.0), 4.0), ((1.0, 1.0, 9.0), 1.0)])
def test_ratios_are_of_pairs(times: tuple[float, ...], ratio: float) -> None:
    timing = decode_speed.Timing("a", 1, 0, 1, 1, times, (1.0, 1.0, 1.0))
    assert timing.median_ratio == ratio
    assert timing.least_ratio == min(times)
