import numpy as np

from cogsplat.codec.segments.view_shares import ViewTable, encode_shares
from cogsplat.tools.lab.scheduling.chunk_ratios import (
    MIN_RATIO,
    ordered_sum,
    ratios_from_boxes,
    ratios_from_view_table,
    sgss_priorities,
    visibility_of_view_table,
    visible_splat_counts,
    weighted_ratios,
)
from cogsplat.tools.lab.scheduling.poses import Pose

# Two adjacent rooms, a wall between them at x = 0; two chunks fill each room.
BOXES = np.array(
    [[x, -1.0, z, x + 3.9, 1.0, 9.0] for x in (-4.0, 0.1) for z in (1.0, 5.0)], np.float64
)
EQUAL = np.full(4, 100.0)
LEFT, RIGHT = np.array([-2.0, 0.0, 0.5]), np.array([2.0, 0.0, 0.5])
TABLE = ViewTable(
    np.array([LEFT, RIGHT], np.float32),
    encode_shares(np.array([[0.1, 0.05, 0.0, 0.0], [0.0, 0.0, 0.1, 0.05]])),
)


def pose_at(position, turn=0.0):
    cos, sin = np.cos(turn), np.sin(turn)
    rotation = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
    return Pose(np.array(position, np.float64), rotation, 1.0, 0.7)


def test_a_viewpoint_tells_of_what_is_behind_it_too():
    # The pose stands in the left room and looks back to where its viewpoint is.
    pose = Pose(np.array([-2.0, 0.0, 4.0]), np.diag([-1.0, 1.0, -1.0]), 1.0, 0.7)
    boxes = ratios_from_boxes(BOXES, EQUAL)(pose)
    assert boxes[2] > 0.5
    ratios = ratios_from_view_table(TABLE, BOXES, EQUAL)(pose)
    assert ratios[0] > 10.0 * ratios[2]


def test_walls_occlude_by_the_view_table_only():
    pose = pose_at([-1.5, 0.0, 0.5])
    boxes = ratios_from_boxes(BOXES, EQUAL)(pose)
    assert boxes[2] > 0.5
    table = ratios_from_view_table(TABLE, BOXES, EQUAL)(pose)
    assert table[2] < 0.05
    assert table[3] < 0.05
    assert table[0] > 0.5
    assert table[1] > 0.5


def test_chunks_outside_the_frustum_have_the_minimum_ratio():
    sideways = pose_at([-2.0, 0.0, 0.5], -np.pi / 2)
    ratios = ratios_from_view_table(TABLE, BOXES, EQUAL)(sideways)
    assert ratios[0] > 1.0
    assert ratios[1] == MIN_RATIO
    # If no chunk is visible, all ratios are 1.
    away = pose_at([-2.0, 0.0, -50.0], np.pi)
    assert ratios_from_view_table(TABLE, BOXES, EQUAL)(away).tolist() == [1.0] * 4
    assert ratios_from_boxes(BOXES, np.zeros(4))(sideways).tolist() == [1.0] * 4


def test_a_chunk_that_no_viewpoint_sees_counts_by_its_contribution():
    # The last chunk, behind the others, is in scored views, but not in any viewpoint's panorama.
    boxes = np.concatenate([BOXES, [[-4.0, -1.0, 10.0, -0.1, 1.0, 12.0]]])
    table = ViewTable(TABLE.positions, np.pad(TABLE.codes, ((0, 0), (0, 1))))
    at_viewpoint, far_away = pose_at(LEFT), pose_at([-2.0, 0.0, 9.5])
    shares = []
    for contribution in (100.0, 200.0):
        visible = visibility_of_view_table(table, boxes, np.append(EQUAL, contribution))
        shares.append([visible(pose)[4] for pose in (at_viewpoint, far_away)])
    assert 0.0 < shares[0][0] < 1e-3 < 0.01 < shares[0][1]
    np.testing.assert_array_less(shares[0], shares[1])


def test_the_viewpoint_counts_that_sees_a_chunk_from_the_same_side():
    # Seen from a chunk far away, the near viewpoint in the street is on another side than the pose
    # over the roofs; the viewpoint twice as high is on the same side.
    boxes = np.array([[-5.0, -5.0, 95.0, 5.0, 5.0, 105.0], [-5.0, -5.0, 15.0, 5.0, 5.0, 25.0]])
    table = ViewTable(
        np.array([[0.0, 0.0, 60.0], [0.0, -80.0, 20.0]], np.float32),
        encode_shares(np.array([[0.0, 0.0], [0.001, 0.0]])),
    )
    down = np.sqrt(0.5)
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, down, -down], [0.0, down, down]])
    pose = Pose(np.array([0.0, -40.0, 60.0]), rotation, 1.0, 0.7)
    street = np.linalg.norm(pose.position - table.positions[0])
    roofs = np.linalg.norm(pose.position - table.positions[1])
    assert street < roofs
    contribution = np.array([100.0, 100.0])
    found = visibility_of_view_table(table, boxes, contribution)(pose)[0]
    seen = ViewTable(table.positions[1:], table.codes[1:])
    most = visibility_of_view_table(seen, boxes, contribution)(pose)[0]
    assert 0.5 * most < found < most


def test_ratios_weighted_by_contribution_sum_to_one():
    contribution = np.array([1.0, 2.0, 3.0, 4.0])
    ratios = ratios_from_view_table(TABLE, BOXES, contribution)(pose_at([-1.5, 0.0, 0.5]))
    average = contribution / 10.0
    kept = ratios > MIN_RATIO
    np.testing.assert_allclose((ratios * average)[kept].sum(), 1.0, atol=0.02)


def test_sgss_orders_by_density_share_and_distance():
    splats = np.array([100.0, 1e6, 1e6, 1e6])
    ratios = sgss_priorities(BOXES, splats)(pose_at([-2.0, 0.0, 0.5]))
    # The first chunk is sparse and has low priority.
    assert 0.0 < ratios[0] < 1e-4
    assert ratios[1] > ratios[0]
    assert sgss_priorities(BOXES, splats)(pose_at([-2.0, 0.0, -1.0], np.pi)).tolist() == [0.0] * 4


def test_ratios_of_several_poses_are_summed_by_weight():
    rule = ratios_from_boxes(BOXES, EQUAL)
    first, second = pose_at(LEFT), pose_at(RIGHT, 0.4)
    found = weighted_ratios(rule, [(first, 1.0), (second, 0.25)])
    np.testing.assert_array_equal(found, rule(first) + rule(second) * 0.25)


def test_ordered_sum_adds_from_the_first_value_on():
    values = np.array([1e16, 1.0, -1e16, 1.0])
    assert ordered_sum(values) == ((1e16 + 1.0) - 1e16) + 1.0
    assert ordered_sum(np.zeros(0)) == 0.0


def test_visible_splat_counts_scale_with_ratios_below_one():
    splats = np.array([8192, 1000, 100, 1])
    ratios = np.array([2.0, 0.5, MIN_RATIO, MIN_RATIO])
    assert visible_splat_counts(splats, ratios).tolist() == [8192, 250, 0, 0]
