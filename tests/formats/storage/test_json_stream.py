import json
import tracemalloc

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tracing import start_tracing

from cogsplat.codec.errors import CogsplatError, FormatError, LimitError
from cogsplat.formats.storage.json_stream import MAX_VALUE_BYTES, JsonStream
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.strict_json import parse_object

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
    # Characters of every width in UTF-8, surrogates left out: no text holds them alone.
    | st.text(st.characters(codec="utf-8"), max_size=3000),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9), inner),
    max_leaves=12,
)  # fmt: skip


def stream_of(text: str | bytes) -> JsonStream:
    return JsonStream(text if isinstance(text, bytes) else text.encode(), "a.json", "bad")


def refused(text: str | bytes) -> CogsplatError:
    def read() -> None:
        stream = stream_of(text)
        for _ in stream.items():
            stream.value()
        stream.finish()

    with pytest.raises(CogsplatError) as caught:
        read()
    assert "a.json: " in caught.value.message
    return caught.value


@settings(max_examples=150, deadline=None)
@given(st.lists(VALUES, max_size=5), st.booleans(), st.sampled_from([None, 1]))
def test_items_are_what_the_parser_of_python_gives(
    values: list[object], ascii_only: bool, indent: int | None
) -> None:
    stream = stream_of(json.dumps(values, ensure_ascii=ascii_only, indent=indent))
    assert [stream.value() for _ in stream.items()] == values
    stream.finish()


@settings(max_examples=100, deadline=None)
@given(st.dictionaries(st.text(st.characters(codec="utf-8"), max_size=20), VALUES, max_size=4))
def test_members_are_what_the_parser_of_python_gives(values: dict[str, object]) -> None:
    stream = stream_of(b"\xef\xbb\xbf" + json.dumps(values, ensure_ascii=False).encode())
    assert {key: stream.value() for key in stream.members()} == values
    stream.finish()


@pytest.mark.parametrize("length", range(2040, 2056))
@pytest.mark.parametrize("value", ["123456.5e3", '"\\ud83d\\ude00"', '"😀"', "true", "[1,2]"])
def test_values_that_a_window_cuts_anywhere(length: int, value: str) -> None:
    text = f'["{"x" * length}", {value}]'
    stream = stream_of(f"[{text}]")
    assert [stream.value() for _ in stream.items()] == [json.loads(text)]


@pytest.mark.parametrize(
    "text",
    ["", "{}", "[", "[1", "[1,", "[1,]", "[1 2]", "[1]]", "[NaN]", "[-Infinity]", '["\ud800"]',
     "[" * 100_000, "[" + "9" * 5000 + "]", "[tru]", "[01]", b"[\xff]", b'["\xe2\x82"]'],
)  # fmt: skip
def test_text_that_is_no_array(text: str | bytes) -> None:
    data = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
    error = refused(data)
    assert isinstance(error, FormatError)
    assert error.code == "bad"


@pytest.mark.parametrize("text", ['{"a" 1}', '{"a": 1', '{"a": 1,}', "{1: 2}", "[1]"])
def test_text_that_is_no_object(text: str) -> None:
    def read() -> None:
        stream = stream_of(text)
        for _ in stream.members():
            stream.value()

    with pytest.raises(FormatError):
        read()


def test_a_fault_far_before_the_end_is_no_matter_of_length() -> None:
    assert refused("[tru" + " " * (2 * MAX_VALUE_BYTES)).code == "bad"


@pytest.mark.parametrize("item", ["[],", "{},", '"",', "0,", '{"a":{}},', '"\\ud83d\\ude00",'])
def test_a_long_value_is_refused_with_little_memory(item: str) -> None:
    text = f"[[{item * (4 * MAX_VALUE_BYTES // len(item))}0]]".encode()
    start_tracing()
    error = refused(text)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert isinstance(error, LimitError)
    assert error.code == "json-too-long"
    assert peak < 48 << 20


def parse_and_measure(text: bytes, limits: Limits) -> int:
    start_tracing()
    try:
        parse_object(text, "a.json", "bad", limits=limits)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return peak


@pytest.mark.parametrize(
    "item",
    ["[],", "[[]],", "{},", '"",', '"é",', "0,", "12345.5,", '{"a":0},',
     '{"a":{}},', '"\\ud83d\\ude00",', '"😀😀",', '"abcdefghijklmnop",', "[0,1],", "null,"],
)  # fmt: skip
def test_objects_never_take_more_than_was_counted(item: str) -> None:
    """The count that is made before parsing bounds what parsing takes."""
    text = f'{{"a": [{item * (400_000 // len(item))}0]}}'.encode()
    peak = parse_and_measure(text, Limits(small_bytes=1 << 30))
    # What took no more is refused where less is allowed.
    with pytest.raises(LimitError):
        parse_object(text, "a.json", "bad", limits=Limits(small_bytes=peak - 1))


def test_distinct_keys_never_take_more_than_was_counted() -> None:
    text = json.dumps({str(k): k for k in range(50_000)}).encode()
    peak = parse_and_measure(text, Limits(small_bytes=1 << 30))
    with pytest.raises(LimitError):
        parse_object(text, "a.json", "bad", limits=Limits(small_bytes=peak - 1))
