"""Writing of scenes: options that one format alone knows."""

from pathlib import Path

import click
import pytest

from cogsplat.tools.terminal.scene_writing import SceneWriting


def test_what_a_format_does_not_know_is_misuse() -> None:
    out = Path("out.sog")
    SceneWriting(absolute=True).require(out, "ply")
    SceneWriting(spz_precision="fine", spz_version=2).require(out, "spz")
    with pytest.raises(click.UsageError, match=r"--absolute with out\.sog as sog, expected a PLY"):
        SceneWriting(absolute=True).require(out, "sog")
    with pytest.raises(click.UsageError, match=r"--spz-precision with out\.sog as sog"):
        SceneWriting(spz_precision="usual").require(out, "sog")
    with pytest.raises(click.UsageError, match=r"--spz-version with out\.sog as sog"):
        SceneWriting(spz_version=2).require(out, "sog")
