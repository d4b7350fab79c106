"""Configuration files: every option can stand in one, and the command line wins."""

from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result
from running import Run, SmallScene

from cogsplat.tools.terminal.option_groups import GroupedCommand


def command() -> click.Command:
    """Return a command that prints what its options are."""
    params: list[click.Parameter] = [
        click.Option(["--quality"], type=click.FloatRange(10, 90), default=40.0),
        click.Option(["--preset"], type=click.Choice(["fast", "best"]), default="fast"),
        click.Option(["--no-jitter"], is_flag=True),
        click.Option(["--policy", "policies"], multiple=True),
        click.Option(["--force"], is_flag=True, is_eager=True),
        click.Option(["--json", "as_json"], is_flag=True),
    ]

    def show(**given: object) -> None:
        click.echo(" ".join(f"{name}={value}" for name, value in sorted(given.items())))

    return GroupedCommand("c", params=params, callback=show, groups={"First": ["--quality"]})


def run_with(folder: Path, text: str, *words: str) -> Result:
    path = folder / "c.toml"
    path.write_text(text)
    return CliRunner().invoke(command(), ["--config", str(path), *words])


def test_options_come_from_the_file_and_the_command_line_wins(tmp_path: Path) -> None:
    text = 'quality = 38\npreset = "best"\nno-jitter = true\npolicy = ["a", "b"]\nforce = true\n'
    found = run_with(tmp_path, text, "--preset", "fast").output
    assert found == (
        "as_json=False force=True no_jitter=True policies=('a', 'b') preset=fast quality=38.0\n"
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("qualty = 38", "option 'qualty', expected 'quality'"),
        ("no_jitter = true", "expected 'no-jitter'"),
        ("json = true", "option 'json'"),
        ('config = "d.toml"', "option 'config'"),
        ("no-jitter = 1", "expected true or false"),
        ("quality = true", "expected text or a number"),
        ("quality = 5", "is not in the range"),
        ("quality = ", "Invalid value"),
        ("[encode]\nquality = 38", "option 'encode'"),
    ],
)
def test_files_with_other_things_in_them_are_refused(
    tmp_path: Path, text: str, expected: str
) -> None:
    refused = run_with(tmp_path, text)
    assert (refused.exit_code, refused.stdout) == (2, "")
    assert expected in refused.stderr


def test_encode_reads_a_file(run: Run, small: SmallScene, tmp_path: Path) -> None:
    config, out = tmp_path / "encode.toml", tmp_path / "out.cogs"
    config.write_text(f'cameras = "{small.cameras}"\npreset = "fast"\nno-prune = true\n')
    told = run("encode", small.ply, out, "--config", config, "--json")
    assert told.code == 0, told.err
    assert (told.json["splats_pruned"], told.json["scored_views_from"]) == (0, "given")
    assert run("encode", small.ply, out, "--config", tmp_path / "absent.toml").code == 4
