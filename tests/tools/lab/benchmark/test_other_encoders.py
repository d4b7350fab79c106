"""Encoders are run_timed as processes, and COGS aims at the quality of what they wrote."""

import statistics
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from running import SmallScene

import cogsplat
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render_views
from cogsplat.codec.splats import Splats
from cogsplat.formats.cameras.camera_files import read_cameras
from cogsplat.tools.lab.benchmark.other_encoders import (
    Encoder,
    compare,
    encoders,
    main,
    run_timed,
)


def test_a_command_that_fails_says_why() -> None:
    with pytest.raises(click.ClickException, match="no such scene"):
        run_timed([sys.executable, "-c", "raise SystemExit('no such scene')"])


def test_without_the_converter_only_our_npz_is_written(tmp_path: Path) -> None:
    assert [encoder.name for encoder in encoders(tmp_path)] == ["c3dgs-style npz"]


def test_with_the_converter_every_format_has_a_command(tmp_path: Path) -> None:
    program = tmp_path / "@playcanvas" / "splat-transform" / "bin" / "cli.mjs"
    program.parent.mkdir(parents=True)
    program.touch()
    found = {encoder.name: encoder for encoder in encoders(tmp_path)}
    assert list(found) == ["SPZ", "compressed PLY", "c3dgs-style npz", "SOG", "Streamed SOG"]
    streamed = found["Streamed SOG"]
    command = streamed.command(Path("a.ply"), Path("c.json"), Path("out") / streamed.target)
    levels = ["a.ply", "-l", "0", "a.ply", "-F", "50%", "-l", "1", "a.ply", "-F", "25%", "-l", "2"]
    assert command[-len(levels) - 1 :] == [*levels, str(Path("out/lod-meta.json"))]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::cogsplat.codec.errors.CogsplatWarning")
def test_cogs_aims_at_the_quality_of_another_file(small: SmallScene, tmp_path: Path) -> None:
    def converted(scene: Path, cameras: Path, target: Path) -> list[str]:
        program = "import sys, cogsplat; cogsplat.write(cogsplat.read(sys.argv[1]), sys.argv[2])"
        return [sys.executable, "-c", program, str(scene), str(target)]

    spz = Encoder("SPZ", converted, "scene.spz", lambda folder: cogsplat.read(folder / "scene.spz"))
    source = cogsplat.read(small.ply)
    views = read_cameras(small.cameras)[:2]
    expected = render_views(source, views)

    def quality_db(splats: Splats) -> float:
        pictures = render_views(splats, views)
        return statistics.fmean(map(psnr, pictures, expected))

    other, ours = compare(small.ply, small.cameras, quality_db, [spz], ["fast"])
    assert (other.name, other.like) == ("SPZ", "")
    cogsplat.write(source, tmp_path / "again.spz")
    again = cogsplat.read(tmp_path / "again.spz")
    assert other.size_bytes == (tmp_path / "again.spz").stat().st_size
    assert other.held_out_db == pytest.approx(quality_db(again), abs=1e-9)
    assert other.size_bytes > 1.5 * ours.size_bytes
    assert (ours.name, ours.like) == ("COGS fast", "SPZ")
    assert ours.held_out_db == pytest.approx(other.held_out_db, abs=2.0)


def test_names_of_encoders_that_are_not_there(small: SmallScene, tmp_path: Path) -> None:
    arguments = [small.ply, "--cameras", small.cameras, "--only", "SOG", "--node-modules", tmp_path]
    told = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert told.exit_code == 2
    assert "--only" in told.output
