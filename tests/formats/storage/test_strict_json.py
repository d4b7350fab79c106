"""JSON of unknown origin: every wrong value names its place, its key, and what was expected."""

import json
from collections.abc import Callable

import pytest

from cogsplat.codec.errors import FormatError, LimitError
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.strict_json import JsonObject, parse_object


def parsed(**values: object) -> JsonObject:
    return parse_object(json.dumps(values).encode(), "file", "a-code")


def test_values_come_with_their_types() -> None:
    found = parsed(
        n=1.5,
        i=3.0,
        s="x",
        b=True,
        o={"n": 2},
        os=[{"n": 1}, {"n": 2}],
        ns=[1, 2.5],
        ts=["a"],
        js=[4],
    )
    assert found.number("n") == 1.5
    assert found.number("no", 7.0) == 7.0
    assert found.integer("i", 0, 3) == 3
    assert found.integer("no", 0, 3, default=2) == 2
    assert found.text("s") == "x"
    assert found.text("no", "y") == "y"
    assert found.boolean("b", False) is True
    assert found.boolean("no", False) is False
    assert found.child("o").number("n") == 2
    assert [child.number("n") for child in found.children("os")] == [1, 2]
    assert found.children("no") == []
    assert found.numbers("ns", 2) == [1, 2.5]
    assert found.texts("ts", 1) == ["a"]
    assert found.integers("js", 0, 4) == [4]
    assert "n" in found
    assert "no" not in found


@pytest.mark.parametrize(
    ("value", "take", "expected"),
    [
        ("x", lambda o: o.number("k"), "a number"),
        (True, lambda o: o.number("k"), "a number"),
        (10**400, lambda o: o.number("k"), "fits a double"),
        (2.5, lambda o: o.integer("k", 0, 9), "a whole number from 0 to 9"),
        (10, lambda o: o.integer("k", 0, 9), "a whole number from 0 to 9"),
        (-1, lambda o: o.integer("k", 0, 9), "a whole number from 0 to 9"),
        (1, lambda o: o.text("k"), "a string"),
        (1, lambda o: o.boolean("k", False), "true or false"),
        ([], lambda o: o.child("k"), "an object"),
        ({}, lambda o: o.children("k"), "an array"),
        ([1], lambda o: o.children("k"), "an array of objects"),
        ([1, 2], lambda o: o.numbers("k", 3), "an array of 3 numbers"),
        ([1, [2]], lambda o: o.numbers("k"), "numbers"),
        (["a", 1], lambda o: o.texts("k"), "an array of strings"),
        (["a"], lambda o: o.texts("k", 2), "an array of 2 strings"),
        ([1, 1.5], lambda o: o.integers("k", 0, 9), "whole numbers from 0 to 9"),
    ],
)
def test_wrong_values_are_refused_by_place_and_key(
    value: object, take: Callable[[JsonObject], object], expected: str
) -> None:
    with pytest.raises(FormatError) as caught:
        take(parsed(k=value))
    assert caught.value.code == "a-code"
    assert caught.value.message.startswith("file: 'k' is ")
    assert expected in caught.value.message


def test_a_key_that_is_not_there_is_said_to_be_missing() -> None:
    with pytest.raises(FormatError, match="file, o: 'n' is missing, expected a number"):
        parsed(o={}).child("o").number("n")
    with pytest.raises(FormatError, match="file, os 1: 'n' is missing"):
        parsed(os=[{"n": 1}, {}]).children("os")[1].number("n")


@pytest.mark.parametrize(
    "text",
    [b"", b"{", b"[1]", b"3", b'{"a": NaN}', b'{"a": -Infinity}', b"\xff", b"[" * 100_000],
)
def test_what_is_no_object_is_refused(text: bytes) -> None:
    with pytest.raises(FormatError) as caught:
        parse_object(text, "file", "a-code", limits=Limits(small_bytes=1 << 30))
    assert caught.value.code == "a-code"
    assert len(caught.value.message) < 300


def test_a_byte_order_mark_is_legal_to_find() -> None:
    assert parse_object(b'\xef\xbb\xbf{"n": 1}', "file", "a-code").number("n") == 1


def test_text_that_would_take_more_than_the_limit_is_not_parsed() -> None:
    text = json.dumps({"a": [0] * 1000}).encode()
    assert parse_object(text, "file", "a-code").integers("a", 0, 0) == [0] * 1000
    with pytest.raises(LimitError) as caught:
        parse_object(text, "file", "a-code", limits=Limits(small_bytes=10_000))
    assert caught.value.code == "json-too-long"
