"""Printed sizes and counts."""

from pathlib import Path

import pytest

import cogsplat
from cogsplat.tools.terminal.output import count_text, print_facts, size_text
from cogsplat.tools.workflow.description_facts import description_facts

VECTORS = Path(__file__).resolve().parents[2] / "vectors" / "valid"


@pytest.mark.parametrize(
    ("size", "text"),
    [
        (0, "0 B"),
        (1023, "1,023 B"),
        (1024, "1.0 KiB"),
        (65536, "64.0 KiB"),
        ((1 << 20) - 1024, "1,023.0 KiB"),
        (1 << 20, "1.00 MiB"),
        (3 << 19, "1.50 MiB"),
    ],
)
def test_sizes_are_told_in_binary_units(size: int, text: str) -> None:
    assert size_text(size).replace(",", "") == text.replace(",", "")


@pytest.mark.parametrize(
    ("number", "text"), [(0, "0 chunks"), (1, "1 chunk"), (12_000, "12,000 chunks")]
)
def test_numbers_come_with_their_noun(number: int, text: str) -> None:
    assert count_text(number, "chunk") == text


def test_labels_of_a_description_fit_their_column(capsys: pytest.CaptureFixture[str]) -> None:
    with cogsplat.open(VECTORS / "description.cogs") as file:
        description = file.description()
    assert description is not None
    print_facts(*description_facts(description))
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("  annotations ") for line in lines)
    assert {len(line) - len(line[13:].lstrip()) for line in lines} == {14}
