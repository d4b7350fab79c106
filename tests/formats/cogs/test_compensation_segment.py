"""Layers of compensation as payloads: as they were, refused, or about chunks not known yet."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tracing import start_tracing

from cogsplat.codec.errors import CogsplatError, FormatError, LimitError
from cogsplat.codec.segments.prefix_compensation import Layer, pack_codes, unpack_codes
from cogsplat.formats.cogs.compensation_segment import pack_layer, unpack_layer
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.storage.source import FileSource

COUNTS = [3, 2, 4]


def layer(chunks, rows, codes):
    rng = np.random.default_rng(chunks + rows)
    return Layer(
        rng.integers(-128, 128, chunks).astype(np.int8),
        rng.integers(-128, 128, chunks).astype(np.int8),
        rng.integers(0, 256, (chunks, 2)).astype(np.uint8),
        rng.integers(-128, 128, (rows, 2)).astype(np.int8),
        rng.integers(0, max(rows, 1), codes).astype(np.uint8),
    )


@pytest.mark.parametrize("rows", [0, 1, 2, 5, 256])
def test_layers_come_back_as_they_were(rows):
    expected = layer(3, rows, 6 if rows else 0)
    found = unpack_layer(pack_layer(expected), "here", 1, COUNTS, 3, 1 << 20)
    assert found is not None
    for name in ("scales", "opacities", "strengths", "book", "codes"):
        assert getattr(found, name).dtype == getattr(expected, name).dtype
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_a_layer_of_chunks_not_known_waits():
    payload = pack_layer(layer(3, 2, 9))
    assert unpack_layer(payload, "here", 0, COUNTS[:2], 3, 1 << 20) is None
    with pytest.raises(FormatError, match="expected 1 to 2"):
        unpack_layer(payload, "here", 0, COUNTS[:2], 2, 1 << 20)


def test_codes_count_for_the_limit():
    payload = pack_layer(layer(3, 3, 9))
    assert unpack_layer(payload, "here", 0, COUNTS, 3, 9) is not None
    with pytest.raises(LimitError) as caught:
        unpack_layer(payload, "here", 0, COUNTS, 3, 8)
    assert caught.value.code == "decoded-size"


@pytest.mark.parametrize("bits", range(1, 9))
def test_many_codes_come_back_with_little_memory(bits):
    codes = np.random.default_rng(bits).integers(0, 1 << bits, (1 << 17) + 3).astype(np.uint8)
    packed = pack_codes(codes, bits)
    start_tracing()
    found = unpack_codes(packed, bits, len(codes))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    np.testing.assert_array_equal(found, codes)
    # The codes themselves, and the bits of 2^16 of them.
    assert peak < len(codes) + 40 * (1 << 16)


@settings(derandomize=True, max_examples=200, deadline=None)
@given(st.data())
def test_damaged_layers_are_read_or_refused(data):
    payload = bytearray(pack_layer(layer(2, 3, 5)))
    for _ in range(data.draw(st.integers(1, 3))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    try:
        found, code = unpack_layer(bytes(payload), "here", 0, COUNTS, 3, 1 << 20), ""
    except CogsplatError as error:
        found, code = None, error.code
    if found is None:
        assert code.startswith(("msgpack-", "root-"))
        return
    assert len(found.codes) == (sum(COUNTS[: found.chunks]) if len(found.book) else 0)
    assert int(found.codes.max(initial=0)) < max(len(found.book), 1)


@pytest.mark.parametrize("chunks", [[1], [0, 4], [0, 2, 1]])
def test_sets_without_parents_or_out_of_order_are_refused(chunks: list[int]) -> None:
    path = Path(__file__).parents[2] / "vectors" / "valid" / "compensation-cells.cogs"
    with open_cogs(FileSource(path)) as file:
        assert len(file.decode([0, 2, 4], compensate=True)) == 5 + 2 + 1
        with pytest.raises(ValueError, match="include their parents"):
            file.decode(chunks, compensate=True)
