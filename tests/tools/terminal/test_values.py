"""Values of options: byte and splat counts, ranges, colours, sizes."""

from pathlib import Path

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st
from running import Run, SmallScene, all_commands

from cogsplat.tools.terminal.values import (
    MAX_SIDE,
    ByteCount,
    ChunkRange,
    FiniteNumber,
    byte_count,
    chunk_range,
    colour,
    picture_size,
    splat_count,
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0", 0),
        ("65536", 65536),
        ("12B", 12),
        ("64KiB", 65536),
        ("64 kib", 65536),
        ("1.5MB", 1_500_000),
        ("1.5MiB", 1_572_864),
        ("0.3kB", 300),
        ("2GB", 2_000_000_000),
        ("20%", 2_000_000_000),
        ("0.1%", 10_000_000),
        ("100%", 10_000_000_000),
        ("999GiB", 10_000_000_000),
    ],
)
def test_bytes_of_a_file(text: str, expected: int) -> None:
    assert byte_count(text).of(10_000_000_000) == expected


@given(st.integers(0, 10**12), st.integers(0, 100), st.integers(0, 10**12))
def test_shares_round_down_and_amounts_stay_within_the_file(
    size: int, percent: int, amount: int
) -> None:
    assert byte_count(f"{percent}%").of(size) == size * percent // 100
    assert byte_count(f"{amount}").of(size) == min(amount, size)


@pytest.mark.parametrize(
    "text", ["", "-1", "%", "101%", "1e6", "1K", "12 parsecs", "1.5.5MB", "٣%", "nan", "9" * 30]
)
def test_other_bytes_are_refused(text: str) -> None:
    with pytest.raises(click.BadParameter, match="expected bytes"):
        byte_count(text)


def test_splat_counts_round_up_and_stay_within_the_scene() -> None:
    assert [splat_count(text).of(7) for text in ("1%", "50%", "100%", "3", "99")] == [1, 4, 7, 3, 7]


@pytest.mark.parametrize("text", ["", "0", "-1", "0%", "101%", "1.5", "1e3", "25 splats", "nan"])
def test_other_splat_counts_are_refused(text: str) -> None:
    with pytest.raises(click.BadParameter, match="expected splats"):
        splat_count(text)


def test_numbers_are_exact() -> None:
    assert byte_count("0.1%").of(10**15) == 10**12
    assert isinstance(byte_count("5%"), ByteCount)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0:8", ChunkRange(0, 8)),
        ("3:", ChunkRange(3, None)),
        (":5", ChunkRange(None, 5)),
        (":", ChunkRange(None, None)),
    ],
)
def test_chunk_ranges(text: str, expected: ChunkRange) -> None:
    assert chunk_range(text) == expected


@pytest.mark.parametrize("text", ["", "4", "-1:3", "a:b", "1:2:3", "1.5:3"])
def test_other_ranges_are_refused(text: str) -> None:
    with pytest.raises(click.BadParameter, match="expected A:B"):
        chunk_range(text)


def test_colours() -> None:
    assert colour("0.613,0.010,0.398") == (0.613, 0.01, 0.398)
    assert colour("White") == (1.0, 1.0, 1.0)
    assert colour("black") == (0.0, 0.0, 0.0)
    assert colour("#ff0033") == (1.0, 0.0, 0.2)


@pytest.mark.parametrize(
    "text", ["", "1", "1,2", "0,0,1.1", "-0.1,0,0", "nan,0,0", "red", "0,0,", "#fff", "#ff00zz"]
)
def test_other_colours_are_refused(text: str) -> None:
    with pytest.raises(click.BadParameter, match="three numbers from 0 to 1"):
        colour(text)


def test_picture_sizes() -> None:
    assert picture_size("1280x720") == (1280, 720)
    assert picture_size(f"1X{MAX_SIDE}") == (1, MAX_SIDE)


@pytest.mark.parametrize("text", ["", "5", "0x5", "5x", f"{MAX_SIDE + 1}x1", "-3x4", "1.5x2"])
def test_other_sizes_are_refused(text: str) -> None:
    with pytest.raises(click.BadParameter, match="expected pixels"):
        picture_size(text)


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e999"])
def test_options_of_numbers_refuse_what_is_not_finite(text: str) -> None:
    options = [
        (words, option)
        for words, command in all_commands().items()
        for option in command.params
        if isinstance(option.type, click.types.FloatParamType)
    ]
    assert len(options) > 20
    for words, option in options:
        assert isinstance(option.type, FiniteNumber), (words, option.name)
        with pytest.raises(click.BadParameter):
            option.type.convert(text, option, None)


@pytest.mark.parametrize(
    ("words", "name", "value"),
    [
        ("encode", "quality", "nan"),
        ("encode", "target-psnr", "nan"),
        ("encode", "prune", "nan"),
        ("encode", "preview", "nan"),
        ("encode", "first-view-share", "nan"),
        ("encode", "frustum-margin", "inf"),
        ("tune", "keep", "nan"),
        ("tune", "minutes", "1e308"),
        ("layers", "shares", "nan,1"),
        ("layers", "quality", "nan"),
    ],
)
@pytest.mark.parametrize("place", ["command line", "file"])
def test_a_number_that_is_not_finite_is_misuse(
    run: Run, small: SmallScene, tmp_path: Path, words: str, name: str, value: str, place: str
) -> None:
    config = tmp_path / "a.toml"
    config.write_text(f"{name} = {value if value[0] in 'ni' and ',' not in value else repr(value)}")
    given = [f"--{name}", value] if place == "command line" else ["--config", config]
    told = run(words, small.ply, tmp_path / "a.cogs", *given)
    assert told.code == 2, told.err
    assert not (tmp_path / "a.cogs").exists()


def test_the_age_of_objects_is_within_dates(run: Run, tmp_path: Path) -> None:
    assert run("upload", tmp_path, "s3://bucket/a", "--older-than", "1e300").code == 2
