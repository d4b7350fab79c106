"""Scenes from standard input and results to standard output, through the whole command line."""

import io
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner
from running import SmallScene, program

import cogsplat
from cogsplat.tools.main import cli
from cogsplat.tools.terminal.standard_streams import (
    InputPath,
    NamedPath,
    OutputPath,
    StandardStreams,
)


def piped(data: bytes, *arguments: object) -> tuple[int, bytes, str]:
    """Run the program in a process of its own, between two pipes."""
    done = subprocess.run(program(arguments), input=data, capture_output=True, check=False)
    return done.returncode, done.stdout, done.stderr.decode()


def test_a_file_decodes_between_two_pipes(small: SmallScene, tmp_path: Path) -> None:
    plain = tmp_path / "plain.ply"
    runner = CliRunner()
    assert runner.invoke(cli, ["decode", str(small.cogs), str(plain)]).exit_code == 0
    code, out, err = piped(small.cogs.read_bytes(), "decode", "-", "-")
    assert (code, out) == (0, plain.read_bytes())
    assert err.startswith("standard output: ")
    assert "cogsplat-" not in err
    assert piped(small.cogs.read_bytes(), "decode", "-", "-", "--quiet")[1:] == (out, "")


def test_formats_go_through_by_name_and_nothing_else_is_on_standard_output(
    small: SmallScene, tmp_path: Path
) -> None:
    ply = small.ply.read_bytes()
    for name in ("spz", "splat", "sog", "gltf", "compressed ply"):
        code, out, err = piped(ply, "convert", "-", "-", "--format", name)
        assert code == 0, err
        path = tmp_path / f"out.{ {'gltf': 'glb', 'compressed ply': 'ply'}.get(name, name) }"
        path.write_bytes(out)
        assert len(cogsplat.read(path)) == len(cogsplat.read(small.ply))


def test_encoding_between_two_pipes(small: SmallScene) -> None:
    code, out, err = piped(
        small.ply.read_bytes(), "encode", "-", "-", "--cameras", small.cameras, "--preset", "fast"
    )
    assert code == 0, err
    assert len(cogsplat.decode(out)) > 0
    assert "smaller than standard input" in err


def test_a_scene_from_standard_input_is_measured(small: SmallScene, tmp_path: Path) -> None:
    ply, runner = small.ply.read_bytes(), CliRunner()
    views = ["--cameras", str(small.cameras), "--out", str(tmp_path)]
    brief = ["--orders", "source", "--shares", "10", "--sizes", "none"]
    done = runner.invoke(cli, ["lab", "evaluate", "-", *views, *brief], input=ply)
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith("standard input: ")
    assert "standard input, held-out" in (tmp_path / "splats-held-out.svg").read_text()
    brief = ["--profiles", "none", "--formats", "splat"]
    done = runner.invoke(cli, ["lab", "bench", "-", *views, *brief], input=ply)
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith("standard input: ")
    assert "warning: splat: .splat cannot hold SH" in done.stderr
    assert "standard input: " in (tmp_path / "rate-distortion.svg").read_text()


def test_a_page_between_two_pipes(small: SmallScene, tmp_path: Path) -> None:
    code, page, err = piped(small.cogs.read_bytes(), "export-html", "-", "-")
    assert code == 0, err
    assert err.startswith("standard output: ")
    assert b"<title>standard input</title>" in page
    named = tmp_path / "page.html"
    assert CliRunner().invoke(cli, ["export-html", str(small.cogs), str(named)]).exit_code == 0
    assert page == named.read_bytes().replace(b"scene.cogs", b"standard input")
    code, page, err = piped(small.ply.read_bytes(), "export-html", "-", "-")
    assert code == 0, err
    assert err.startswith("standard input is no COGS file: encoding it first")


def test_planned_cameras_go_to_standard_output(small: SmallScene) -> None:
    code, out, err = piped(small.ply.read_bytes(), "lab", "views", "-", "-", "--count", "6", "-q")
    assert (code, err) == (0, "")
    assert len(json.loads(out)) >= 6


@pytest.mark.parametrize("command", ["info", "check"])
def test_looking_at_standard_input(small: SmallScene, command: str) -> None:
    done = CliRunner().invoke(cli, [command, "-"], input=small.cogs.read_bytes())
    assert done.exit_code == 0, done.output
    assert "standard input" in done.stdout


def test_messages_speak_of_the_streams(small: SmallScene) -> None:
    runner = CliRunner()
    broken = runner.invoke(cli, ["info", "-"], input=b"neither this nor that")
    assert broken.exit_code == 3
    assert "standard input: is a file that starts with" in broken.stderr
    cut = runner.invoke(cli, ["decode", "-", "-"], input=small.cogs.read_bytes()[:4000])
    assert (cut.exit_code, cut.stdout_bytes) == (3, b"")
    assert "error: standard input" in cut.stderr


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["convert", "-", "-"], "standard output without --format"),
        (["decode", "-", "-", "--json"], "--json and a result on standard output"),
        (["compare", "-", "-"], "- for two scenes"),
        (["view", "-", "--against", "-"], "- for two scenes"),
        (["export-html", "-", "-", "--folder"], "--folder with standard output"),
        (["encode", "-", "-", "--cameras", "-"], "'--cameras': - for a stream"),
        (["lab", "evaluate", "-", "--out", "-"], "'--out': - for a stream"),
        (["lab", "synth", "-"], "'OUT.ply': - for a stream"),
    ],
)
def test_misuse_is_told(small: SmallScene, arguments: list[str], told: str) -> None:
    done = CliRunner().invoke(cli, arguments, input=small.cogs.read_bytes())
    assert (done.exit_code, done.stdout.partition("{")[0]) == (2, "")
    assert told in done.output


def test_every_other_path_takes_no_stream() -> None:
    """A folder called - would be made, a file called - looked for."""
    kinds = (InputPath, OutputPath, NamedPath)
    for command in leaves(cli):
        for parameter in command.params:
            if isinstance(parameter.type, click.Path):
                assert isinstance(parameter.type, kinds), f"{command.name}: {parameter.name}"
    assert NamedPath().convert("./-", None, None) == Path("-")


def leaves(group: click.Group) -> Iterator[click.Command]:
    """Yield all commands, those inside groups included."""
    for command in group.commands.values():
        if isinstance(command, click.Group):
            yield from leaves(command)
        else:
            yield command


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_terminals_are_no_streams(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "stdin", Terminal())
    monkeypatch.setattr(sys, "stdout", Terminal())
    streams = StandardStreams(tmp_path)
    with pytest.raises(click.UsageError, match="standard input is a terminal"):
        streams.read_input()
    with pytest.raises(click.UsageError, match="standard output is a terminal"):
        streams.output_file(".ply")
    assert not streams.is_output_reserved


def test_a_scene_arrives_bit_for_bit(small: SmallScene, tmp_path: Path) -> None:
    """Text modes of streams must not touch what is written."""
    code, out, _ = piped(small.ply.read_bytes(), "convert", "-", "-", "--format", "ply")
    path = tmp_path / "out.ply"
    path.write_bytes(out)
    assert code == 0
    np.testing.assert_array_equal(cogsplat.read(path).means, cogsplat.read(small.ply).means)
