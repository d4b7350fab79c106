"""Truncated files: refused with a hint, accepted with ``--partial``."""

from pathlib import Path

import click
import pytest
from running import Run, SmallScene, all_commands

import cogsplat

# Commands that read a COGS file; those that read several scenes take it for all of them.
READING = [
    "encode",
    "decode",
    "convert",
    "info",
    "check",
    "render",
    "compare",
    "lab score",
    "lab order",
    "lab views",
    "lab evaluate",
    "lab bench",
]


@pytest.fixture
def cut(small: SmallScene, tmp_path: Path) -> Path:
    """Return the first six tenths of a file."""
    data = small.cogs.read_bytes()
    path = tmp_path / "cut.cogs"
    path.write_bytes(data[: len(data) * 6 // 10])
    return path


def test_every_command_that_reads_has_the_option() -> None:
    having = [
        name
        for name, command in all_commands().items()
        if any("--partial" in option.opts for option in command.params)
    ]
    limited = [
        name
        for name, command in all_commands().items()
        if isinstance(command, click.Command)
        and any("--limits" in option.opts for option in command.params)
    ]
    assert having == limited
    assert set(having) >= set(READING)


def arguments(command: str, cut: Path, small: SmallScene, out: Path) -> list[object]:
    given: dict[str, list[object]] = {
        "info": [cut],
        "info --statistics": [cut],
        "decode": [cut, out / "out.ply"],
        "convert": [cut, out / "out.spz"],
        "render": [cut, out / "out.png", "--cameras", small.cameras, "--size", "32x24"],
        "compare": [small.ply, cut, "--cameras", small.cameras],
        "lab score": [cut, out / "out.npy", "--cameras", small.cameras],
    }
    return [command, *given[command]]


@pytest.mark.parametrize(
    "command",
    ["info", "info --statistics", "decode", "convert", "render", "compare", "lab score"],
)
def test_a_part_is_refused_with_a_hint_and_taken_with_the_option(
    run: Run, small: SmallScene, cut: Path, tmp_path: Path, command: str
) -> None:
    words = arguments(command, cut, small, tmp_path)
    refused = run(*words)
    assert refused.code == 3
    first, hint = refused.err.splitlines()[-2:]
    assert first.endswith("[file-truncated]")
    assert hint == "--partial reads the chunks that are complete"
    taken = run(*words, "--partial")
    assert taken.code == 0, taken.err


def test_what_is_complete_is_decoded(
    run: Run, small: SmallScene, cut: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.ply"
    assert run("decode", cut, out, "--partial").code == 0
    expected = cogsplat.decode(small.cogs, size_bytes=cut.stat().st_size)
    assert 0 < len(expected) < 2000
    assert (cogsplat.read(out).means == expected.means).all()


def test_info_says_what_is_there_and_its_bytes_add_up(run: Run, cut: Path) -> None:
    size = cut.stat().st_size
    told = run("info", cut, "--partial", "--json").json
    with cogsplat.open(cut, partial=True) as file:
        assert told["bytes"] == file.file_length > size
        assert told["chunks_complete"] == file.complete_chunks() < file.num_chunks
        line = f"{file.complete_chunks()} of {file.num_chunks} chunks complete"
    assert told["bytes_read"] == size
    rows = told["attributes"]
    assert isinstance(rows, list)
    assert sum(row["bytes"] for row in rows) == told["bytes"]
    assert any(row["stream"] == "not there" for row in rows)
    assert line in run("info", cut, "--partial").out


def test_first_bytes_without_a_chunk_are_said(run: Run, small: SmallScene, tmp_path: Path) -> None:
    short = tmp_path / "short.cogs"
    with cogsplat.open(small.cogs) as file:
        end = int(file.offsets.min())
    short.write_bytes(small.cogs.read_bytes()[:end])
    told = run("info", short, "--partial", "--statistics")
    assert told.code == 0
    assert "no chunk is complete in the first" in told.err


def test_validation_of_a_part_finds_what_is_wrong_with_it(
    run: Run, cut: Path, tmp_path: Path
) -> None:
    assert run("check", cut).code == 3
    told = run("check", cut, "--partial")
    assert (told.code, told.err) == (0, "")
    assert "the chunks that are there conform" in told.out
    data = bytearray(cut.read_bytes())
    with cogsplat.open(cut, partial=True) as file:
        data[int(file.offsets[0])] ^= 255
    cut.write_bytes(data)
    found = run("check", cut, "--partial", "--json")
    assert found.code == 3
    assert found.json["valid"] is False
