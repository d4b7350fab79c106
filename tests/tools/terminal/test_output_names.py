from pathlib import Path

import click
import pytest

from cogsplat.tools.terminal.output_names import COGS, HTML, PNG, check_name


@pytest.mark.parametrize(
    ("name", "extensions"),
    [
        ("a.cogs", COGS),
        ("A.COGS", COGS),
        ("a.ply.cogs", COGS),
        ("a", COGS),
        ("a.part", COGS),
        ("v1.2", PNG),
        ("a.htm", HTML),
    ],
)
def test_names_that_fit_or_say_nothing(name: str, extensions: tuple[str, ...]) -> None:
    check_name(Path(name), extensions)


@pytest.mark.parametrize(
    ("name", "extensions", "said"),
    [
        ("a.ply", COGS, ".ply"),
        ("a.compressed.ply", COGS, ".compressed.ply"),
        ("a.cogs.SPZ", COGS, ".spz"),
        ("r.jpg", PNG, ".jpg"),
        ("r.cogs", PNG, ".cogs"),
        ("r.json", HTML, ".json"),
    ],
)
def test_names_that_say_another_format(name: str, extensions: tuple[str, ...], said: str) -> None:
    with pytest.raises(click.UsageError, match=f"the name ends in {said}, expected"):
        check_name(Path(name), extensions)
    check_name(Path(name), extensions, insisted=True)
