"""Options in groups: all of them, once, those that matter first; a name that is none fails."""

import re

import click
import pytest
from click.testing import CliRunner

from cogsplat.tools.cli.encode import encode
from cogsplat.tools.terminal.option_groups import GroupedCommand


def test_the_help_of_encode_has_every_option_once_and_the_six_first() -> None:
    shown = CliRunner().invoke(encode, ["--help"], prog_name="cogsplat encode").output
    listed = re.findall(r"^  (?:-[a-z], )?(--[a-z-]+)", shown, re.MULTILINE)
    having = [o.opts[0] for o in encode.params if isinstance(o, click.Option)] + ["--help"]
    assert sorted(listed) == sorted(having)
    six = ["--cameras", "--quality", "--target-psnr", "--target-size", "--profile", "--preset"]
    assert listed[:6] == six
    assert shown.index("Most used:") < shown.index("Order of the splats:")


def test_options_in_no_group_follow_and_unknown_ones_fail() -> None:
    options = [click.Option([name], help="Text.") for name in ("--one", "--two")]
    command = GroupedCommand("c", params=options, groups={"First": ["--two"]})
    shown = CliRunner().invoke(command, ["--help"]).output
    assert shown.index("First:") < shown.index("--two") < shown.index("--one")
    broken = GroupedCommand("c", params=options, groups={"First": ["--three"]})
    with pytest.raises(KeyError):
        CliRunner().invoke(broken, ["--help"], catch_exceptions=False)
