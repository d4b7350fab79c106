"""Extra attributes as payloads: to the bit, and refused where they are not whole."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.errors import CogsplatError, FormatError
from cogsplat.codec.segments.attributes import (
    AttributeType,
    attribute_bytes,
    attribute_types,
    pack_attributes,
    unpack_attributes,
)
from cogsplat.codec.splats import EXTRA_DTYPES


def some(rows, seed=1):
    rng = np.random.default_rng(seed)
    extras = {}
    for dtype in EXTRA_DTYPES:
        for components in (0, 1, 3):
            shape = (rows, components) if components else (rows,)
            raw = rng.integers(0, 256, (*shape, int(dtype[1])), np.uint8)
            extras[f"{dtype} x{components}"] = raw.view(dtype)[..., 0]
    extras["label"] = np.arange(rows, dtype=np.uint16) // 50
    return extras


CODES = {
    "",
    "attribute-record",
    "plane-length",
    "plane-radix",
    "plane-digits",
    "zstd-frame",
    "zstd-size",
    "zstd-window",
    "zstd-dictionary",
    "zstd-checksum",
}


def refusal(call):
    """The reason code of what `call` raises, nothing where it goes through."""
    try:
        call()
    except CogsplatError as error:
        return error.code
    return ""


def unpacked(payload, types, rows):
    out = {kind.name: kind.allocate(rows) for kind in types}
    unpack_attributes(memoryview(payload), types, out, "here")
    return out


@pytest.mark.parametrize("rows", [1, 2, 700])
def test_every_type_comes_back_to_the_bit(rows):
    extras = some(rows)
    types = attribute_types(extras)
    found = unpacked(pack_attributes(extras), types, rows)
    for name, values in extras.items():
        assert found[name].dtype == values.dtype
        assert found[name].shape == values.shape
        assert found[name].tobytes() == values.tobytes(), name


def test_types_say_what_a_row_takes():
    kinds = {kind.name: kind for kind in attribute_types(some(2))}
    assert kinds["f8 x3"] == AttributeType("f8 x3", "f8", 3)
    assert (kinds["f8 x3"].row_bytes, kinds["f8 x0"].row_bytes, kinds["u1 x1"].row_bytes) == (
        24,
        8,
        1,
    )


def test_labels_take_little():
    labels = {"label": np.repeat(np.arange(8, dtype=np.int32), 500)}
    assert len(pack_attributes(labels)) < 150


@pytest.mark.parametrize("rows", [1, 64])
def test_any_cut_and_any_byte_more_is_refused(rows):
    extras = {"a": some(rows)["f4 x3"], "b": np.zeros(rows, np.uint8)}
    payload, types = pack_attributes(extras), attribute_types(extras)
    for broken in (*(payload[:stop] for stop in range(len(payload))), payload + b"\0"):
        with pytest.raises(FormatError, match="expected") as caught:
            unpacked(broken, types, rows)
        assert caught.value.code == "attribute-record"
        with pytest.raises(FormatError, match="expected") as caught:
            attribute_bytes(memoryview(broken), types, "here")
        assert caught.value.code == "attribute-record"


def test_sizes_of_attributes_add_up_to_the_payload():
    extras = some(700)
    payload = pack_attributes(extras)
    sizes = attribute_bytes(memoryview(payload), attribute_types(extras), "here")
    assert list(sizes) == list(extras)
    assert sum(sizes.values()) == len(payload)
    assert sizes["label"] < sizes["u4 x3"]


def test_no_attributes_are_no_bytes():
    assert pack_attributes({}) == b""
    assert unpacked(b"", (), 5) == {}


@settings(max_examples=300, deadline=None)
@given(
    st.binary(max_size=200),
    st.lists(st.tuples(st.sampled_from(EXTRA_DTYPES), st.integers(0, 3)), max_size=3),
    st.integers(1, 300),
)
def test_any_bytes_are_decoded_or_refused(payload, kinds, rows):
    types = [AttributeType(str(i), *kind) for i, kind in enumerate(kinds)]
    refused = refusal(lambda: unpacked(payload, types, rows))
    assert refused in CODES


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_a_flipped_bit_is_decoded_or_refused(data):
    extras = {"a": np.arange(300, dtype=np.uint32), "b": np.zeros((300, 2), np.float32)}
    payload = bytearray(pack_attributes(extras))
    payload[data.draw(st.integers(0, len(payload) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    assert refusal(lambda: unpacked(bytes(payload), attribute_types(extras), 300)) in CODES
