"""Options in groups: `--help` shows the most used ones, `--help-all` each of them once."""

import re

import click
import pytest
from click.testing import CliRunner
from running import all_commands

from cogsplat.tools.cli.encode import encode
from cogsplat.tools.terminal.option_groups import GroupedCommand

GROUPED = {n: c for n, c in all_commands().items() if isinstance(c, GroupedCommand)}


def listed(command: click.Command, option: str) -> list[str]:
    """Return the options that a help lists, in its order."""
    shown = CliRunner().invoke(command, [option], prog_name="cogsplat command").output
    return re.findall(r"^  (?:-[a-z], )?(--[a-z-]+)", shown, re.MULTILINE)


@pytest.mark.parametrize("name", GROUPED)
def test_help_shows_at_most_sixteen_options_and_help_all_each_once(name: str) -> None:
    command = GROUPED[name]
    short, whole = listed(command, "--help"), listed(command, "--help-all")
    options = [p for p in command.params if isinstance(p, click.Option)]
    names = [next(n for n in p.opts if n.startswith("--")) for p in options] + ["--help"]
    assert len(short) <= 16
    assert whole[: len(short)] == short
    assert sorted(whole) == sorted(names)


def test_encode_and_tune_are_grouped() -> None:
    assert {"encode", "tune"} <= GROUPED.keys()
    six = ["--cameras", "--quality", "--target-psnr", "--target-size", "--profile", "--preset"]
    assert listed(encode, "--help")[:6] == six


def test_options_in_no_group_follow_and_unknown_ones_fail() -> None:
    options = [click.Option([name], help="Text.") for name in ("--one", "--two")]
    command = GroupedCommand("c", params=options, groups={"First": ["--two"]})
    assert listed(command, "--help-all")[:2] == ["--two", "--one"]
    assert "--help-all shows 4 more options" in CliRunner().invoke(command, ["--help"]).output
    broken = GroupedCommand("c", params=options, groups={"First": ["--three"]})
    with pytest.raises(KeyError):
        CliRunner().invoke(broken, ["--help"], catch_exceptions=False)
