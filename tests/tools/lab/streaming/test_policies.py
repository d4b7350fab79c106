"""Policies: what is near, seen, or known to be shown comes first."""

import numpy as np
import pytest

from cogsplat.codec.cameras import Camera
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.tools.lab.scheduling.chunk_ratios import by_boxes, by_view_table
from cogsplat.tools.lab.streaming.client import Units
from cogsplat.tools.lab.streaming.policies import (
    by_pose,
    by_ratios,
    file_order,
    nearest_boxes,
    sgss,
    table_of,
)

AHEAD = Camera(
    width=100,
    height=100,
    fx=50.0,
    fy=50.0,
    cx=50.0,
    cy=50.0,
    rotation=np.eye(3),
    translation=np.zeros(3),
    name="ahead",
)
BACK = Camera(
    width=100,
    height=100,
    fx=50.0,
    fy=50.0,
    cx=50.0,
    cy=50.0,
    rotation=np.diag([-1.0, 1.0, -1.0]),
    translation=np.zeros(3),
    name="back",
)
# Three chunks of a head each: far ahead, near ahead, behind.
BOXES = np.array(
    [[-1, -1, 9, 1, 1, 11], [-1, -1, 3, 1, 1, 5], [-1, -1, -5, 1, 1, -3]], dtype=np.float64
)
UNITS = Units(
    kind=np.full(3, int(SegmentKind.HEAD)),
    chunk=np.arange(3),
    end=np.array([100, 200, 300]),
    size_bytes=np.full(3, 100),
    after=[(), (), ()],
    opening_bytes=0,
)
SAME = np.ones(3)


def order(priorities: np.ndarray) -> list[int]:
    return np.argsort(-priorities, kind="stable").tolist()


def test_the_order_of_the_file_is_that_of_all_poses() -> None:
    assert order(file_order(UNITS)(AHEAD)) == order(file_order(UNITS)(BACK)) == [0, 1, 2]


def test_boxes_come_by_their_distance() -> None:
    assert order(nearest_boxes(UNITS, BOXES)(AHEAD)) == [1, 2, 0]


def test_sgss_takes_dense_near_boxes_that_fill_the_picture() -> None:
    dense = np.full(3, 1000.0)
    assert order(sgss(UNITS, BOXES, dense)(AHEAD)) == [1, 0, 2]
    assert order(sgss(UNITS, BOXES, np.array([1e6, 1000.0, 1000.0]))(AHEAD)) == [0, 1, 2]
    assert order(sgss(UNITS, BOXES, dense)(BACK))[0] == 2


def test_what_is_outside_the_frustum_is_put_off() -> None:
    assert order(by_ratios(UNITS, by_boxes(BOXES, SAME))(AHEAD)) == [1, 0, 2]
    assert order(by_ratios(UNITS, by_boxes(BOXES, SAME))(BACK))[0] == 2


def test_known_views_say_what_a_pose_shows() -> None:
    shown = np.array([[0.0, 3000.0, 0.0], [1000.0, 0.0, 5000.0]])
    wanted = by_ratios(UNITS, by_view_table(table_of([AHEAD, BACK], shown), BOXES, SAME))
    assert order(wanted(AHEAD))[0] == 1
    assert order(wanted(BACK))[0] == 2


def test_a_pose_that_shows_nothing_takes_the_order_of_the_file() -> None:
    assert order(by_pose(UNITS, lambda _: np.zeros(3), SAME)(AHEAD)) == [0, 1, 2]


@pytest.mark.parametrize("shown", [[1.0, 1.0, 1.0], [5.0, 5.0, 5.0]])
def test_chunks_that_show_their_usual_share_keep_their_places(shown: list[float]) -> None:
    wanted = by_pose(UNITS, lambda _: np.array(shown), SAME)
    np.testing.assert_allclose(1.0 / wanted(AHEAD), [1e4, 4e4, 9e4])


def test_segments_of_one_chunk_keep_their_order() -> None:
    units = Units(
        kind=np.array([1, 4, 7, 2, 1]),
        chunk=np.array([0, -1, 0, 0, 1]),
        end=np.array([10, 20, 30, 40, 50]),
        size_bytes=np.full(5, 10),
        after=[()] * 5,
        opening_bytes=0,
    )
    found = order(nearest_boxes(units, BOXES[:2])(AHEAD))
    assert found == [4, 0, 2, 3, 1]
