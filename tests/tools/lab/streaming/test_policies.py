"""Fetch order of the policies."""

from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.cameras import Camera
from cogsplat.codec.segments.view_shares import ViewTable, encode_shares
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.tools.lab.scheduling.chunk_ratios import (
    PoseValues,
    ratios_from_boxes,
    ratios_from_view_table,
)
from cogsplat.tools.lab.scheduling.scene_rows import SceneRows
from cogsplat.tools.lab.streaming.client import Units
from cogsplat.tools.lab.streaming.policies import (
    ClientRatios,
    by_true_contribution,
    by_urgency,
    file_order,
    nearest_chunks,
    sgss_chunks,
)

FORWARD = Camera(
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
BACKWARD = Camera(
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
    row=np.arange(3),
    end=np.array([100, 200, 300]),
    size_bytes=np.full(3, 100),
    dependencies=[(), (), ()],
    index_bytes=0,
    gains=np.array([100.0, 25.0, 10.0]),
)
EQUAL = np.ones(3)
# The root lists the first chunk and a page, which lists the others.
ROWS = SceneRows(
    splats=np.array([10, 10, 10, 20]),
    first_chunk=np.array([0, 1, 2, 1]),
    chunks_below=np.array([1, 1, 1, 2]),
    parent=np.full(4, -1),
    listed_by=np.array([-1, 3, 3, -1]),
    box=np.concatenate([BOXES, [[-1, -1, -5, 1, 1, 5]]]),
    contribution=np.array([1.0, 1.0, 1.0, 2.0]),
    chunks=3,
)


def of_client(ratios: PoseValues) -> ClientRatios:
    """Return ratios that do not depend on what is present."""
    return lambda pose, _: ratios(pose)


def order(priorities: np.ndarray) -> list[int]:
    return np.argsort(-priorities, kind="stable").tolist()


def test_file_order_ignores_the_pose() -> None:
    assert (
        order(file_order(UNITS)(FORWARD, [])) == order(file_order(UNITS)(BACKWARD, [])) == [0, 1, 2]
    )


def test_nearest_chunks_come_first() -> None:
    assert order(nearest_chunks(UNITS, BOXES)(FORWARD, [])) == [1, 2, 0]


def test_sgss_takes_dense_near_boxes_that_fill_the_picture() -> None:
    dense = np.full(3, 1000.0)
    assert order(sgss_chunks(UNITS, BOXES, dense)(FORWARD, [])) == [1, 0, 2]
    assert order(sgss_chunks(UNITS, BOXES, np.array([1e6, 1000.0, 1000.0]))(FORWARD, [])) == [
        0,
        1,
        2,
    ]
    assert order(sgss_chunks(UNITS, BOXES, dense)(BACKWARD, []))[0] == 2


def test_chunks_outside_the_frustum_come_last() -> None:
    assert order(by_urgency(UNITS, of_client(ratios_from_boxes(BOXES, EQUAL)))(FORWARD, [])) == [
        1,
        0,
        2,
    ]
    assert (
        order(by_urgency(UNITS, of_client(ratios_from_boxes(BOXES, EQUAL)))(BACKWARD, []))[0] == 2
    )


def test_the_view_table_orders_chunks_by_pose() -> None:
    # The second viewpoint, far behind the first, sees another chunk.
    places = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -40.0]], np.float32)
    table = ViewTable(places, encode_shares(np.array([[0.0, 0.0, 0.03], [0.0, 0.003, 0.0]])))
    priorities = by_urgency(UNITS, of_client(ratios_from_view_table(table, BOXES, EQUAL)))
    far = replace(FORWARD, translation=np.array([0.0, 0.0, 40.0]))
    assert order(priorities(far, []))[0] == 1
    assert order(priorities(BACKWARD, []))[0] == 2


def test_a_pose_without_visible_chunks_gives_the_order_of_the_file() -> None:
    assert order(by_true_contribution(UNITS, lambda _: np.zeros(3), ROWS)(FORWARD, [])) == [0, 1, 2]


@pytest.mark.parametrize("shown", [[1.0, 1.0, 1.0], [5.0, 5.0, 5.0]])
def test_equal_ratios_give_the_order_of_the_file(shown: list[float]) -> None:
    priorities = by_true_contribution(UNITS, lambda _: np.array(shown), ROWS)
    np.testing.assert_allclose(priorities(FORWARD, []), [1.0, 0.25, 0.1])


def test_a_page_has_the_ratio_of_the_chunks_below_it_together() -> None:
    # With gains of 1 per byte, urgencies are ratios, squared below 1.
    units = replace(UNITS, row=np.array([0, 2, 3]), gains=np.full(3, 100.0))
    priorities = by_true_contribution(units, lambda _: np.array([1.0, 1.0, 5.0]), ROWS)
    np.testing.assert_allclose(priorities(FORWARD, []), [9 / 49, 15 / 7, 9 / 7])


def test_a_client_knows_the_rows_of_the_pages_that_it_has_read() -> None:
    assert ROWS.known([]).tolist() == [0, 3]
    assert ROWS.known([3]).tolist() == [0, 1, 2]
    assert ROWS.budget_splats == [10, 10, 10, 10]


def test_segments_of_one_chunk_keep_their_order() -> None:
    units = Units(
        kind=np.array([1, 4, 7, 2, 1]),
        row=np.array([0, -1, 0, 0, 1]),
        end=np.array([10, 20, 30, 40, 50]),
        size_bytes=np.full(5, 10),
        dependencies=[()] * 5,
        index_bytes=0,
    )
    found = order(nearest_chunks(units, BOXES[:2])(FORWARD, []))
    assert found == [4, 0, 2, 3, 1]
