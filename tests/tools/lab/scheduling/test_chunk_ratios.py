import numpy as np

from cogsplat.codec.segments.view_shares import ViewTable, encode_shares
from cogsplat.tools.lab.scheduling.chunk_ratios import (
    LEAST_RATIO,
    along,
    by_boxes,
    by_sgss,
    by_view_table,
    counted_splats,
    total,
)
from cogsplat.tools.lab.scheduling.poses import Pose

# Two rooms beside each other with a wall between them at x = 0; both chunks of a room fill it.
BOXES = np.array(
    [[x, -1.0, z, x + 3.9, 1.0, 9.0] for x in (-4.0, 0.1) for z in (1.0, 5.0)], np.float64
)
SAME = np.full(4, 100.0)
LEFT, RIGHT = np.array([-2.0, 0.0, 0.5]), np.array([2.0, 0.0, 0.5])
TABLE = ViewTable(
    np.array([LEFT, RIGHT], np.float32),
    np.array([[0, 0, 127], [0, 0, 127]], np.int8),
    encode_shares(np.array([[0.3, 0.6, 0.0, 0.0], [0.0, 0.0, 0.3, 0.6]])),
)


def looking(position, turn=0.0):
    cos, sin = np.cos(turn), np.sin(turn)
    rotation = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
    return Pose(np.array(position, np.float64), rotation, 1.0, 0.7)


def test_the_table_knows_of_walls_and_boxes_do_not():
    pose = looking([-1.5, 0.0, 0.5])
    boxes = by_boxes(BOXES, SAME)(pose)
    assert boxes[2] > 0.5
    table = by_view_table(TABLE, BOXES, SAME)(pose)
    assert table[2] < 0.05
    assert table[3] < 0.05
    assert table[0] > 0.5
    assert table[1] > 0.5


def test_what_is_beside_the_picture_comes_last_whatever_the_table_says():
    aside = looking([-2.0, 0.0, 0.5], -np.pi / 2)
    ratios = by_view_table(TABLE, BOXES, SAME)(aside)
    assert ratios[0] > 1.0
    assert ratios[1] == LEAST_RATIO
    # Where nothing at all is seen, all chunks are as urgent as usual.
    away = looking([-2.0, 0.0, -50.0], np.pi)
    assert by_view_table(TABLE, BOXES, SAME)(away).tolist() == [1.0] * 4
    assert by_boxes(BOXES, np.zeros(4))(aside).tolist() == [1.0] * 4


def test_chunks_that_no_viewpoint_looks_at_count_by_their_contribution():
    boxes = np.concatenate([BOXES, [[-4.0, -1.0, -9.0, 4.0, 1.0, -5.0]]])
    table = ViewTable(TABLE.positions, TABLE.directions, np.pad(TABLE.codes, ((0, 0), (0, 1))))
    ratios = by_view_table(table, boxes, np.full(5, 100.0))(looking([0.0, 0.0, 0.0], np.pi))
    assert ratios[4] == max(ratios) > 1.0


def test_ratios_are_shares_over_usual_shares():
    contribution = np.array([1.0, 2.0, 3.0, 4.0])
    ratios = by_view_table(TABLE, BOXES, contribution)(looking([-1.5, 0.0, 0.5]))
    usual = contribution / 10.0
    kept = ratios > LEAST_RATIO
    np.testing.assert_allclose((ratios * usual)[kept].sum(), 1.0, atol=0.02)


def test_sgss_orders_by_density_share_and_distance():
    splats = np.array([100.0, 1e6, 1e6, 1e6])
    ratios = by_sgss(BOXES, splats)(looking([-2.0, 0.0, 0.5]))
    # The first is sparse: low priority, whatever it shows.
    assert 0.0 < ratios[0] < 1e-4
    assert ratios[1] > ratios[0]
    assert by_sgss(BOXES, splats)(looking([-2.0, 0.0, -1.0], np.pi)).tolist() == [0.0] * 4


def test_a_path_is_the_weighted_sum_of_its_poses():
    rule = by_boxes(BOXES, SAME)
    first, second = looking(LEFT), looking(RIGHT, 0.4)
    found = along(rule, [(first, 1.0), (second, 0.25)])
    np.testing.assert_array_equal(found, rule(first) + rule(second) * 0.25)


def test_sums_are_taken_from_the_first_on():
    values = np.array([1e16, 1.0, -1e16, 1.0])
    assert total(values) == ((1e16 + 1.0) - 1e16) + 1.0
    assert total(np.zeros(0)) == 0.0


def test_chunks_count_by_what_a_pose_shows_of_them_and_never_for_more_than_they_have():
    splats = np.array([8192, 1000, 100, 1])
    ratios = np.array([2.0, 0.5, LEAST_RATIO, LEAST_RATIO])
    assert counted_splats(splats, ratios).tolist() == [8192, 500, 1, 1]
