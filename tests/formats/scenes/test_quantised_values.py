"""Quantised opacities, quaternions and row orders that several formats share."""

import numpy as np
import pytest

from cogsplat.formats.scenes.quantised_values import (
    BYTE_LOGITS,
    from_smallest_three,
    morton_order,
    opacity_bytes,
    opacity_logits,
    to_smallest_three,
    unit_opacities,
)


def test_logits_and_opacities_are_each_others_inverse() -> None:
    unit = np.linspace(0.001, 0.999, 999)
    np.testing.assert_allclose(unit_opacities(opacity_logits(unit)), unit, rtol=1e-5)
    ends = opacity_logits(np.array([0.0, 1.0, np.nan]))
    assert ends[0] == -np.inf
    assert ends[1] == np.inf
    assert np.isnan(ends[2])
    # The textbook form overflows here.
    np.testing.assert_array_equal(
        unit_opacities(np.float32([-1e4, -np.inf, 0, 1e4])), [0, 0, 0.5, 1]
    )


def test_every_byte_of_opacity_comes_back() -> None:
    np.testing.assert_array_equal(opacity_bytes(BYTE_LOGITS), np.arange(256))
    # Half way between two bytes lies the decision.
    for part, nearest in ((0.49, 0), (0.51, 1)):
        between = opacity_logits((np.arange(255) + part) / 255)
        np.testing.assert_array_equal(opacity_bytes(between), np.arange(255) + nearest)


def test_the_smallest_three_give_the_same_rotation_back() -> None:
    rng = np.random.default_rng(1)
    quats = rng.normal(size=(40_000, 4)).astype(np.float32) * rng.uniform(
        1e-20, 9, (40_000, 1)
    ).astype(np.float32)
    largest, others = to_smallest_three(quats)
    np.testing.assert_array_equal(largest, np.abs(quats).argmax(axis=1))
    assert np.abs(others).max() <= np.sqrt(0.5) + 1e-6
    back = from_smallest_three(largest, others)
    unit = quats.astype(np.float64)
    unit /= np.abs(unit).max(axis=1, keepdims=True)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    np.testing.assert_allclose(np.abs((back * unit).sum(axis=1)), 1.0, atol=1e-6)
    assert (back[np.arange(len(back)), largest] > 0).all()


def test_a_missing_component_is_never_imaginary() -> None:
    back = from_smallest_three(np.array([0]), np.float32([[0.9, 0.9, 0.0]]))
    np.testing.assert_array_equal(back, np.float32([[0.0, 0.9, 0.9, 0.0]]))


def test_the_row_order_is_that_of_interleaved_bits() -> None:
    corners = np.float32([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
    shuffled = np.random.default_rng(2).permutation(8)
    np.testing.assert_array_equal(shuffled[morton_order(corners[shuffled])], np.arange(8))
    assert morton_order(np.zeros((0, 3), np.float32)).tolist() == []


@pytest.mark.parametrize("n", [1, 5])
def test_equal_means_keep_their_order(n: int) -> None:
    assert morton_order(np.full((n, 3), 2.5, np.float32)).tolist() == list(range(n))
