import numpy as np
import pytest
from hypothesis import settings
from streamed import grid_of, numbers, refused, stored

from cogsplat.codec.streams import codebook_index, kinds, quaternion, scalar
from cogsplat.codec.streams.codebook_index import CodebookUse
from cogsplat.codec.streams.records import Attribute, Kind, Stream

checked = settings(derandomize=True, deadline=None, max_examples=100)


@pytest.mark.parametrize("change", [-1, 1])
def test_another_number_of_planes_is_refused(change):
    planes = [np.zeros(2, np.uint8)] * (3 + change)
    stream = Stream(Attribute.SH0, Kind.SCALAR, 2, grid_of([9, 9, 9]).pack(), planes)
    refused(lambda: numbers(stream), "stream-planes", "6.2")
    floats = Stream(Attribute.SH0, Kind.FLOAT, 2, b"", [np.zeros(2, np.uint8)] * (12 + change))
    refused(lambda: numbers(floats), "stream-planes", "6.2")


def test_other_lengths_of_parameters_are_refused():
    for params in (b"", grid_of([1, 1]).pack(), grid_of([1] * 4).pack(), bytes(35), bytes(37)):
        for kind in (Kind.SCALAR, Kind.FLOAT)[: 1 + bool(params)]:
            stream = Stream(Attribute.SH0, kind, 2, params, [])
            refused(lambda stream=stream: numbers(stream), "stream-params", "6.2")


def test_attributes_of_another_kind_are_refused():
    quats = np.array([[1, 0, 0, 0]], np.float32)
    stream = quaternion.write(quats, 0.1)
    other = Stream(Attribute.SH0, stream.kind, stream.rows, stream.params, stream.planes)
    refused(lambda: numbers(other), "stream-kind", "6.2")
    plain = scalar.write(Attribute.SH0, quats[:, :3].copy(), grid_of([2] * 3))
    for attribute in (Attribute.QUATS, Attribute.SHAPE, Attribute.SHN):
        other = Stream(attribute, plain.kind, plain.rows, plain.params, plain.planes)
        refused(lambda other=other: numbers(other), "stream-kind", "6.2")


def test_every_kind_stands_for_some_attribute():
    kept = {kind for codecs in kinds.KINDS.values() for kind in codecs}
    refining = {c.refined_by for codecs in kinds.KINDS.values() for c in codecs.values()}
    assert kept | refining - {None} == set(Kind)
    assert kept & refining == set()
    assert set(kinds.KINDS) == set(Attribute)


def test_codebooks_are_asked_of_streams_that_have_one():
    plain = scalar.write(Attribute.SH0, np.zeros((2, 3), np.float32), grid_of([1] * 3))
    index = codebook_index.write(Attribute.SHAPE, np.array([0, 4], np.uint32), 7, 4)
    first, second = stored(plain, index)
    assert kinds.codebook_use(second) == CodebookUse(7, 1)
    with pytest.raises(ValueError, match="refers to no codebook"):
        kinds.codebook_use(first)
