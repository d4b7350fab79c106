"""What shells complete: commands, options, and the values of options."""

import pytest
from click.shell_completion import BashComplete

from cogsplat.codec.order.orders import ORDERS
from cogsplat.tools.main import cli


@pytest.mark.parametrize(
    ("words", "start", "expected"),
    [
        ([], "enc", ["encode"]),
        (["encode", "a.ply", "b.cogs"], "--target", ["--target-psnr", "--target-size"]),
        (["encode", "a.ply", "b.cogs", "--preset"], "b", ["balanced", "best"]),
        (["encode", "a.ply", "b.cogs", "--order"], "octree", None),
        (["convert", "a.ply", "b", "--format"], "sp", ["spz", "splat"]),
    ],
)
def test_words_are_completed(words: list[str], start: str, expected: list[str] | None) -> None:
    completer = BashComplete(cli, {}, "cogsplat", "_COGSPLAT_COMPLETE")
    found = [item.value for item in completer.get_completions(words, start)]
    assert found == (expected or [name for name in ORDERS if name.startswith(start)])
    assert found


def test_files_are_left_to_the_shell() -> None:
    completer = BashComplete(cli, {}, "cogsplat", "_COGSPLAT_COMPLETE")
    (item,) = completer.get_completions(["info"], "scene")
    assert item.type == "file"
