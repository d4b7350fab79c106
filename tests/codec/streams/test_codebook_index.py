import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streamed import refused, stored

from cogsplat.codec.streams import codebook_index, kinds
from cogsplat.codec.streams.records import Attribute, Kind, Stream
from cogsplat.codec.streams.stream_inputs import Inputs

checked = settings(derandomize=True, deadline=None, max_examples=100)


@checked
@given(st.integers(0, 70_000), st.integers(0, 20), st.integers(0, 2**32 - 1))
def test_indices_come_back(size, escape, seed):
    rng = np.random.default_rng(seed)
    indices = rng.integers(0, max(size, 1), escape + 5 if size else escape).astype(np.uint32)
    own = rng.permutation(len(indices))[:escape]
    indices[own] = size
    (one,) = stored(codebook_index.write(Attribute.SHAPE, indices, 3, size))
    assert codebook_index.parse(one) == codebook_index.CodebookUse(3, escape)
    # Escape rows are taken one after the other.
    indices[np.sort(own)] = size + np.arange(escape)
    np.testing.assert_array_equal(codebook_index.read_indices(one, size), indices)


def test_indices_beyond_codebook_and_escape_rows_are_refused():
    indices = np.array([0, 9, 8], np.uint32)
    (one,) = stored(codebook_index.write(Attribute.SHAPE, indices, 0, 10))
    np.testing.assert_array_equal(codebook_index.read_indices(one, 10), indices)
    refused(lambda: codebook_index.read_indices(one, 9), "index-range", "6.7")
    refused(lambda: codebook_index.read_indices(one, 10_000), "stream-planes", "6.2")
    (past,) = stored(codebook_index.write(Attribute.SHAPE, np.array([3, 2], np.uint32), 0, 2))
    refused(lambda: codebook_index.read_indices(past, 2), "index-range", "6.7")


@pytest.mark.parametrize("stated", [0, 1, 3, 4])
def test_another_number_of_escape_rows_than_stated_is_refused(stated):
    stream = codebook_index.write(Attribute.SHAPE, np.array([10, 2, 10, 0], np.uint32), 0, 10)
    (one,) = stored(replace(stream, params=struct.pack("<II", 0, stated)))
    refused(lambda: codebook_index.read_indices(one, 10), "index-range", "6.7")


def test_more_escape_rows_than_rows_are_refused():
    stream = codebook_index.write(Attribute.SHAPE, np.zeros(4, np.uint32), 0, 10)
    (one,) = stored(replace(stream, params=struct.pack("<II", 0, 5)))
    refused(lambda: codebook_index.parse(one), "stream-rows", "6.7")
    params = struct.pack("<I", 0)
    (short,) = stored(Stream(Attribute.SHAPE, Kind.VQ, 1, params, []))
    refused(lambda: codebook_index.parse(short), "stream-params", "6.2")


def test_rows_come_from_the_codebook_and_then_from_escape_rows():
    codebook = np.arange(12, dtype=np.float32).reshape(3, 4)
    escape = -codebook[:2]
    (one,) = stored(codebook_index.write(Attribute.SHAPE, np.array([2, 3, 0, 3], np.uint32), 0, 3))
    out = np.empty((4, 4), np.float32)
    kinds.read(one, out, Inputs(codebook=codebook, escape=escape))
    assert np.array_equal(out, [codebook[2], escape[0], codebook[0], escape[1]])
    with pytest.raises(ValueError, match="no codebook"):
        kinds.read(one, out)
