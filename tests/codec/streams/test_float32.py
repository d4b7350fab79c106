import numpy as np
import pytest
from hypothesis import settings
from streamed import numbers, refused

from cogsplat.codec.streams import float32
from cogsplat.codec.streams.records import Attribute

checked = settings(derandomize=True, deadline=None, max_examples=100)


def test_float_streams_keep_every_bit():
    rng = np.random.default_rng(3)
    values = rng.normal(size=(9, 3)).astype(np.float32) * np.float32(1e-30)
    values[0] = [-0.0, 1e-45, -1e30]
    out = numbers(float32.write(Attribute.MEANS, values))
    assert out.tobytes() == values.tobytes()
    logits = np.array([[np.inf], [-np.inf], [3.5]], np.float32)
    assert numbers(float32.write(Attribute.OPACITIES, logits)).tobytes() == logits.tobytes()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 2e30, -2e30])
def test_floats_no_scene_can_hold_are_refused(value):
    values = np.zeros((3, 3), np.float32)
    values[1, 2] = value
    refused(lambda: numbers(float32.write(Attribute.SCALES, values)), "float-value", "6.8")


@pytest.mark.parametrize("value", [np.nan, 2e30, -2e30])
def test_opacities_may_be_infinite_but_not_nan_or_huge(value):
    values = np.full((3, 1), value, np.float32)
    refused(lambda: numbers(float32.write(Attribute.OPACITIES, values)), "float-value", "6.8")
