"""Growth of splats where chunks below theirs are missing (docs/streaming.md, 10)."""

import numpy as np

from cogsplat.tools.lab.scheduling.growth import growth, missing_splats

# Row 0 has the children 1 and 2, row 1 the child 3.
PARENTS = np.array([-1, 0, 0, 1])
SPLATS = np.array([100, 60, 33, 5])


def missing(*held):
    return missing_splats(np.isin(np.arange(4), held), PARENTS, SPLATS).tolist()


def test_what_is_missing_counts_with_all_below_it_as_a_power_of_two():
    assert missing(0) == [0, 64, 32, 4]
    assert missing(0, 1) == [0, 0, 32, 4]
    assert missing(0, 1, 2, 3) == [0] * 4
    assert missing() == [128, 64, 32, 4]
    assert missing_splats(np.zeros(2, bool), np.array([-1, 0]), np.zeros(2, np.int64)).tolist() == [
        0,
        0,
    ]


def test_a_splat_grows_for_the_first_box_around_it_if_that_is_missing():
    means = np.array([[1, 0, 0], [2, 0, 0], [3, 0, 0], [9, 0, 0]], np.float32)
    boxes = np.array([[0, 0, 0, 2, 0, 0], [2, 0, 0, 4, 0, 0]], np.float64)
    # The second splat is in both boxes and belongs to the first.
    assert growth(means, boxes, np.array([0, 3])).tolist() == [0.0, 0.0, 0.5, 0.0]
    assert growth(means, boxes, np.array([2, 0])).tolist() == [0.25, 0.25, 0.0, 0.0]
    assert growth(means, boxes, np.array([0, 0])).tolist() == [0.0] * 4
    assert growth(means[:0], boxes, np.array([4, 4])).shape == (0,)
    assert growth(means, boxes[:0], np.zeros(0, np.int64)).tolist() == [0.0] * 4


def test_growth_is_near_a_quarter_of_the_logarithm_and_has_a_limit():
    boxes = np.array([[0.0] * 6])
    for count in (1, 2, 3, 5):
        found = float(growth(np.zeros((1, 3), np.float32), boxes, np.array([count]))[0])
        assert 0.0 <= 0.25 * np.log2(1 + count) - found <= 0.25 * 0.0861
    assert growth(np.zeros((1, 3), np.float32), boxes, np.array([1 << 20])).tolist() == [
        float(np.float32(0.7))
    ]
