import math
import struct
import tracemalloc

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tracing import start_tracing

from cogsplat.codec.errors import FormatError, LimitError
from cogsplat.formats.cogs.canonical_msgpack import (
    MAX_DEPTH,
    MAX_INTEGER,
    VALUE_BYTES,
    pack,
    unpack,
)

LENGTHS = [0, 1, 15, 16, 31, 32, 255, 256, 65535, 65536]

EDGES = [s * (1 << b) + d for b in (5, 7, 8, 15, 16, 31, 32) for s in (1, -1) for d in (-1, 0, 1)]

scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-MAX_INTEGER, MAX_INTEGER),
    st.sampled_from(EDGES),
    st.floats(allow_nan=False),
    st.text(max_size=20),
    st.binary(max_size=20),
)
keys = st.text("abcé", max_size=3)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(keys, inner, max_size=4),
    max_leaves=8,
)
maps = st.dictionaries(keys, values, max_size=4)
quick = settings(max_examples=60, deadline=None)


def code(data):
    with pytest.raises(FormatError) as caught:
        unpack(data, "here")
    assert caught.value.clause == "4.1"
    assert caught.value.message.startswith("here: ")
    return caught.value.code


def depth(value):
    inner = (
        value.values() if isinstance(value, dict) else value if isinstance(value, list) else None
    )
    return 0 if inner is None else 1 + max(map(depth, inner), default=0)


@quick
@given(maps)
def test_what_was_packed_comes_back(value):
    data = pack(value)
    if depth(value) > MAX_DEPTH:
        assert code(data) == "msgpack-depth"
    else:
        assert repr(unpack(data, "here")) == repr(value)


@pytest.mark.parametrize("length", LENGTHS)
def test_lengths_at_which_headers_change(length):
    for content in ("x" * length, b"x" * length, [None] * length):
        value = {"": content}
        assert unpack(pack(value), "here", max_values=1 << 18) == value
    wide = {str(i): None for i in range(length)}
    assert unpack(pack(wide), "here", max_values=1 << 18) == wide


def test_values_are_counted_with_their_keys():
    # The map, two keys, an array and its three elements, an empty map.
    value = {"a": [1, [], {}], "b": {"c": None}}
    data = pack(value)
    assert unpack(data, "here", max_values=10) == value
    with pytest.raises(FormatError) as caught:
        unpack(data, "here", max_values=9)
    assert caught.value.code == "msgpack-count"
    assert unpack(data, "here", allowed_bytes=10 * VALUE_BYTES) == value
    with pytest.raises(LimitError) as refused:
        unpack(data, "here", allowed_bytes=10 * VALUE_BYTES - 1)
    assert refused.value.code == "decoded-size"


def test_values_take_no_more_memory_than_is_counted():
    count = 60_000
    data = pack({"names": [f"{i:06}.jpg" for i in range(count)], "numbers": [1.5] * count})
    start_tracing()
    found = unpack(data, "here", max_values=1 << 18)
    used, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(found["names"]) == count
    # The characters of a str are counted by the bytes they take in the file.
    assert used < (2 * count + 5) * VALUE_BYTES + len(data)


def test_order_of_keys_is_kept():
    assert list(unpack(pack({"b": 1, "a": 2}), "here")) == ["b", "a"]


def test_floats_keep_their_bits():
    for value in (-0.0, math.inf, 5e-324, 1 / 3):
        assert struct.pack(">d", unpack(pack({"": value}), "x")[""]) == struct.pack(">d", value)
    assert math.isnan(unpack(pack({"": math.nan}), "x")[""])


def oracle(data):
    """Return the value that msgpack reads; None if msgpack or our rules refuse the bytes."""

    def pairs(items):
        if len({k for k, _ in items}) != len(items) or not all(
            isinstance(k, str) for k, _ in items
        ):
            raise ValueError("keys")
        return dict(items)

    def integers(value):
        if isinstance(value, int) and abs(value) > MAX_INTEGER:
            raise ValueError("integer")
        for inner in (
            value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        ):
            integers(inner)

    try:
        value = msgpack.unpackb(data, strict_map_key=False, object_pairs_hook=pairs)
        integers(value)
        same = isinstance(value, dict) and msgpack.packb(value) == data
    except (ValueError, TypeError, OverflowError):
        return None
    return value if same else None


@quick
@given(maps, st.data())
def test_mutated_bytes_are_read_as_msgpack_reads_them(value, draw):
    data = bytearray(pack(value))
    for _ in range(draw.draw(st.integers(1, 3))):
        data[draw.draw(st.integers(0, len(data) - 1))] = draw.draw(st.integers(0, 255))
    found = oracle(bytes(data))
    if found is None or depth(found) > MAX_DEPTH:
        code(bytes(data))
    else:
        assert repr(unpack(bytes(data), "here")) == repr(found)


@quick
@given(maps)
def test_every_cut_is_a_truncation(value):
    data = pack(value)
    for length in range(len(data)):
        assert code(data[:length]) in ("msgpack-truncated", "msgpack-depth")


def test_nests_of_large_claims_allocate_nothing():
    # Each header claims as many elements as there are bytes left.
    data = b"\x81\xa1x" + b"\xdc\xff\xff" * 7 + bytes(1 << 16)
    start_tracing()
    with pytest.raises(FormatError) as caught:
        unpack(data, "here", max_values=1 << 20)
    assert caught.value.code == "msgpack-truncated"
    assert code(data) == "msgpack-count"
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20 * len(data)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"", "msgpack-truncated"),
        (b"\xc0", "msgpack-type"),
        (b"\x80\x80", "msgpack-trailing"),
        (b"\x81\xa1a", "msgpack-truncated"),
        (b"\x81\xc0\xc0", "msgpack-key"),
        (b"\x81\xa1a\xc7\x03\xff\x00\x00\x00", "msgpack-type"),
        (b"\x81\xa1a\xd8\xff" + bytes(16), "msgpack-type"),
        (b"\x81\xa1a\x91" * 5, "msgpack-depth"),
    ],
)
def test_codes(data, expected):
    assert code(data) == expected


def test_deepest_nest_that_is_legal():
    value = None
    for _ in range(MAX_DEPTH - 1):
        value = [value]
    assert unpack(pack({"": value}), "here") == {"": value}
    assert code(pack({"": [value]})) == "msgpack-depth"
