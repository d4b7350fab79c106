import click
import pytest

from cogsplat.formats.storage.limits import Limits
from cogsplat.tools.terminal.limits_option import current_limits, limits_of


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("memory=2GiB", Limits(decoded_bytes=2 << 30)),
        ("memory=2GiB,splats=10M", Limits(decoded_bytes=2 << 30, splats=10_000_000)),
        ("splats=0", Limits(splats=0)),
        (" cameras = 5k , expansion=1 ", Limits(cameras=5000, expansion=1, foreign_expansion=1)),
        ("splats=1g", Limits(splats=10**9)),
    ],
)
def test_limits(text: str, expected: Limits) -> None:
    assert limits_of(text) == expected


@pytest.mark.parametrize(
    "text",
    ["", "memory", "memory=", "memory=20%", "memory=x", "splats=-1", "splats=1.5M", "splats=1KiB",
     "seconds=3", "splats=1,splats=2", "splats=1,"],
)  # fmt: skip
def test_what_is_none(text: str) -> None:
    with pytest.raises(click.BadParameter, match="expected"):
        limits_of(text)


def test_outside_a_command_the_defaults_hold() -> None:
    assert current_limits() == Limits()
