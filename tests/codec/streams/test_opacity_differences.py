"""Differences streams of opacities."""

import numpy as np

from cogsplat.codec.streams import grid, kinds, opacity_differences, records
from cogsplat.codec.streams.records import Attribute, Kind


def test_differences_are_added_to_what_there_is_in_float32():
    rng = np.random.default_rng(1)
    first = rng.normal(0, 3, (200, 1)).astype(np.float32)
    added = rng.normal(0, 1, (200, 1)).astype(np.float32)
    own = grid.fit(added, 0.01)
    payload = records.pack([opacity_differences.write(added, own)])
    (stream,) = records.unpack(memoryview(payload), "here", 200)
    assert (stream.attribute, stream.kind) == (Attribute.OPACITIES, Kind.DIFFERENCES)
    out = first.copy()
    kinds.read(stream, out)
    np.testing.assert_array_equal(out, first + own.dequantise(own.quantise(added)))
    np.testing.assert_allclose(out, first + added, atol=0.006)
