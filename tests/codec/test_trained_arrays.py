"""Spaces and orders of trained arrays."""

import numpy as np
import pytest

from cogsplat.codec.errors import DataError
from cogsplat.codec.splats import Splats
from cogsplat.codec.trained_arrays import as_floats, log_scales, logits, wxyz


def test_logits_are_the_inverse_of_the_logistic_function():
    unit = np.array([0.0, 1e-6, 0.25, 0.5, 0.999, 1.0], np.float32)
    found = logits(unit, "unit")
    assert found.dtype == np.float32
    with np.errstate(over="ignore"):
        np.testing.assert_allclose(1 / (1 + np.exp(-found.astype(float))), unit, rtol=1e-6)
    assert found[0] == -np.inf
    assert found[-1] == np.inf
    assert logits(found, "logit") is found


def test_linear_scales_become_logarithms():
    linear = np.array([[0.5, 1.0, 20.0]], np.float32)
    np.testing.assert_allclose(log_scales(linear, "linear"), [[-0.6931472, 0.0, 2.9957323]])
    assert log_scales(linear, "log") is linear
    with pytest.raises(DataError, match=r"linear scale of 0\.0"):
        log_scales(np.zeros((1, 3), np.float32), "linear")


def test_w_comes_first():
    assert wxyz(np.array([[1, 2, 3, 4]], np.float32), "xyzw").tolist() == [[4, 1, 2, 3]]


def test_what_is_no_number_is_refused():
    assert as_floats("means", [[1, 2, 3]]).dtype == np.float32
    with pytest.raises(DataError, match="means: ") as caught:
        as_floats("means", ["a"])
    assert caught.value.code == "bad-dtype"


@pytest.mark.parametrize("name", ["scale_space", "opacity_space", "quat_order"])
def test_unknown_spaces_are_misuse(name):
    with pytest.raises(ValueError, match=f"{name} 'odd', expected"):
        Splats.from_arrays(
            np.zeros((1, 3)), np.zeros((1, 3)), np.ones((1, 4)), [0], np.zeros((1, 3)),
            **{name: "odd"},
        )  # fmt: skip
