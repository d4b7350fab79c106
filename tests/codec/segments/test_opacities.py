"""Opacities of later levels."""

import numpy as np
import pytest

from cogsplat.codec.segments.opacities import MAX_LOGIT, decode_opacities, pack_opacities
from cogsplat.codec.streams import records
from cogsplat.codec.streams.records import Kind

ROWS = 500


def decoded(payload, first):
    out = first.copy()
    decode_opacities(memoryview(payload), out, "here")
    return out


def kind_of(payload):
    (stream,) = records.unpack(memoryview(payload), "here", ROWS)
    return stream.kind


@pytest.mark.parametrize("step", [0.5, 0.05, 0.004])
def test_opacities_come_back_within_half_a_step(step):
    rng = np.random.default_rng(3)
    first = rng.normal(0, 3, ROWS).astype(np.float32)
    for values in (first + rng.normal(0, 0.2, ROWS), rng.normal(0, 3, ROWS), first):
        given = values.astype(np.float32)
        payload = pack_opacities(given, first, step)
        wanted = np.clip(given, -MAX_LOGIT, MAX_LOGIT)
        np.testing.assert_allclose(decoded(payload, first), wanted, atol=step * 0.51)


def test_the_smaller_of_two_ways_is_taken():
    rng = np.random.default_rng(3)
    first = rng.normal(0, 3, ROWS).astype(np.float32)
    near = first + rng.normal(0, 0.1, ROWS).astype(np.float32)
    far = (rng.integers(0, 2, ROWS) * 2 - 1).astype(np.float32)
    assert kind_of(pack_opacities(near, first, 0.05)) == Kind.DIFFERENCES
    assert kind_of(pack_opacities(far, first, 0.05)) == Kind.SCALAR


def test_differences_to_infinite_opacities_are_not_stored():
    first = np.array([np.inf, -np.inf, 0], np.float32)
    values = np.array([1, 2, 3], np.float32)
    np.testing.assert_allclose(
        decoded(pack_opacities(values, first, 0.1), first), values, atol=0.06
    )
