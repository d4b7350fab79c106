"""Difference images, pixel by pixel."""

import numpy as np
import pytest

from cogsplat.tools.pictures.difference import difference_image


def test_three_pictures_side_by_side() -> None:
    first = np.zeros((2, 3, 3), np.float32)
    second = first.copy()
    second[0, 0] = [0.05, 0.25, 0.5]
    second[1, 2] = -1.0
    image = np.asarray(difference_image(first, second))
    assert image.shape == (2, 9, 3)
    assert not image[:, :3].any()
    np.testing.assert_array_equal(image[0, 3], [13, 64, 128])
    np.testing.assert_array_equal(image[0, 6], [51, 255, 255])
    assert not image[1].any()
    with pytest.raises(ValueError, match="equal shapes"):
        difference_image(first, second[:1])
