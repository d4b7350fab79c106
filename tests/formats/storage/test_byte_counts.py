"""Byte counts as people write them."""

import pytest

from cogsplat.formats.storage.byte_counts import parse_byte_count, parse_bytes


@pytest.mark.parametrize(
    ("text", "of_a_million"),
    [
        ("0", 0), ("65536", 65536), ("64KiB", 65536), ("64 kib", 65536), ("1.5kB", 1500),
        ("12b", 12), ("20%", 200_000), ("100%", 1_000_000), ("5GiB", 1_000_000),
    ],
)  # fmt: skip
def test_counts_and_shares(text, of_a_million):
    assert parse_byte_count(text).of(1_000_000) == of_a_million


@pytest.mark.parametrize("text", ["", "-1", "1e3", "5 TB", "101%", "KiB", "nan", "1.5.2"])
def test_what_is_none_is_refused(text):
    with pytest.raises(ValueError, match="expected bytes such as"):
        parse_byte_count(text)


@pytest.mark.parametrize(("text", "expected"), [("0", 0), ("64 KiB", 65536), ("0.3b", 0)])
def test_bytes_without_a_file(text, expected):
    assert parse_bytes(text) == expected


@pytest.mark.parametrize("text", ["20%", "0%", "many"])
def test_a_share_needs_a_file(text):
    with pytest.raises(ValueError, match=f"{text}.*expected bytes such as"):
        parse_bytes(text)
