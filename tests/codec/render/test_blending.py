"""Blending of a tile against the rules of 3DGS, one pixel and one splat at a time in float64."""

import math

import numpy as np
import oracle
import pytest

from cogsplat.codec.render import blending
from cogsplat.codec.render.blending import (
    ALPHA_MAX,
    BLUE,
    GREEN,
    OFF_BLUE,
    OFF_GREEN,
    OFF_RED,
    PIXELS,
    PLANES,
    PLANES_COMPARED,
    RED,
    REST,
    blend_pixel,
    blend_tile,
    compare_tile,
    draw_and_reopen,
    falloff,
    open_pixels,
    rows_in_tile,
    store_lane_sums,
    tile_area,
)
from cogsplat.codec.render.projection import project
from cogsplat.codec.render.shading import row_colours
from cogsplat.codec.render.tiles import TILE, tile_lists
from cogsplat.codec.splats import concatenate


def test_falloff_is_exp_to_two_millionths():
    exponents = np.linspace(-6.0, 0.0, 2001, dtype=np.float32)
    actual = np.array([falloff(value) for value in exponents])
    np.testing.assert_allclose(actual, np.exp(exponents.astype(np.float64)), rtol=2e-6)
    assert falloff(np.float32(-np.inf)) < np.float32(1 / 255)


@pytest.mark.parametrize("live", [0.0, 2e-4, 0.3, 1.0])
@pytest.mark.parametrize("opacity", [0.003, 0.5, 0.99, 1.0])
@pytest.mark.parametrize("exponent", [-6.5, -1.0, 0.0])
def test_a_pixel_is_blended_by_the_rules_of_3dgs(live, opacity, exponent):
    raw, alpha, weight, drawn, after = blend_pixel(
        np.float32(live), np.float32(opacity), np.float32(exponent)
    )
    assert raw == pytest.approx(opacity * math.exp(max(exponent, -6.0)), rel=1e-5)
    assert alpha == min(raw, ALPHA_MAX)
    reached = alpha >= 1 / 255
    left = live * (1 - float(alpha))
    assert drawn == (reached and left >= 1e-4)
    assert weight == pytest.approx(live * alpha if drawn else 0.0, rel=1e-5)
    assert after == pytest.approx(left if drawn else 0.0 if reached else live, rel=1e-5)


def test_tiles_cover_an_image_row_by_row():
    # 40x20 px: three tiles a row, two rows.
    areas = [tile_area(tile, 40, 20) for tile in range(6)]
    assert areas == [
        (0, 0, 16, 16), (0, 16, 16, 16), (0, 32, 16, 8),
        (16, 0, 4, 16), (16, 16, 4, 16), (16, 32, 4, 8),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("rows", "expected"), [((0, 50), (0, 10)), ((18, 20), (2, 4)), ((40, 50), (24, 10))]
)
def test_rows_are_cut_to_the_tile(rows, expected):
    first, last = rows_in_tile(np.array(rows, np.int32), 16, 10)
    assert (first, last) == expected


def test_pixels_outside_the_image_are_not_open():
    state = np.full(PIXELS + 3, 7.0, np.float32)
    open_pixels(state, 3, 5)
    expected = np.zeros((TILE, TILE))
    expected[:3, :5] = 1.0
    np.testing.assert_array_equal(state[:PIXELS].reshape(TILE, TILE), expected)
    assert (state[PIXELS:] == 7.0).all(), "other planes stay"


@pytest.mark.parametrize("pixel", [0, 100, PIXELS - 1])
def test_a_row_is_open_while_one_of_its_pixels_is_live(pixel):
    state = np.zeros(PIXELS + 3, np.float32)
    # Beyond the first plane nothing counts.
    state[PIXELS:] = 1.0
    open_rows = np.full(TILE, 9, np.uint32)
    assert blending.find_open_rows(state, open_rows) == 0
    assert not open_rows.any()
    state[pixel] = 1e-4
    assert blending.find_open_rows(state, open_rows) == 1
    assert np.flatnonzero(open_rows).tolist() == [pixel // TILE]


def test_bits_have_the_order_of_the_numbers():
    numbers = np.array([0.0, 1e-40, 1e-4, 0.5, 0.99, 1.0], np.float32)
    found = [blending.bits(number) for number in numbers]
    assert found == numbers.view(np.uint32).tolist()
    assert found == sorted(found)


@pytest.mark.parametrize("pairs", [0, 3, blending.PAIRS_READ, blending.PAIRS_READ + 5])
def test_footprints_are_read_in_the_order_of_the_pairs(pairs):
    rng = np.random.default_rng(2)
    members = rng.integers(0, 40, 7 + pairs, np.int32)
    ellipse = rng.random((40, 8), np.float32)
    rows = rng.integers(0, 90, (40, 2), np.int32)
    near_ellipse = np.zeros((blending.PAIRS_READ, 8), np.float32)
    near_rows = np.zeros((blending.PAIRS_READ, 2), np.int32)
    blending.read_footprints(7, 7 + pairs, members, ellipse, rows, near_ellipse, near_rows)
    read = min(pairs, blending.PAIRS_READ)
    np.testing.assert_array_equal(near_ellipse[:read], ellipse[members[7 : 7 + read]])
    np.testing.assert_array_equal(near_rows[:read], rows[members[7 : 7 + read]])
    assert not near_ellipse[read:].any()


def _tile(splats, camera, present=None, keep_rest=True):
    """Blend a picture of at most one tile: its state as (planes, 16, 16), and the stop."""
    footprints = project(splats, camera)
    (lists,) = tile_lists(footprints, camera.width, camera.height)
    everything = np.ones(len(footprints), np.bool_)
    state = np.full(PLANES_COMPARED * PIXELS, 9.0, np.float32)
    stop = blend_tile(
        state,
        0,
        len(lists.members),
        lists.members,
        footprints.ellipse,
        footprints.rows,
        row_colours(splats, footprints.index, camera),
        everything if present is None else present[footprints.index],
        0,
        0,
        camera.height,
        camera.width,
        keep_rest,
    )
    return state, stop, len(lists.members)


def _plane(state, offset):
    return state[int(offset) : int(offset) + PIXELS].reshape(TILE, TILE)


def test_without_the_plane_of_the_rest_all_other_planes_are_the_same():
    splats, camera = oracle.scene(4, n=120, opacity=3.0), oracle.camera(width=13, height=11)
    (full, stop, _), (bare, other, _) = (
        _tile(splats, camera, None, keep) for keep in (True, False)
    )
    assert stop == other
    assert not _plane(bare, REST).any()
    assert _plane(full, REST).any()
    for offset in (0, RED, GREEN, BLUE):
        np.testing.assert_array_equal(_plane(bare, offset), _plane(full, offset))


@pytest.mark.parametrize("seed", range(3))
def test_a_tile_equals_brute_force(seed):
    splats = oracle.scene(seed, n=120, opacity=3.0)
    camera = oracle.camera(width=13, height=11, focal=12.0)
    present = np.random.default_rng(seed).random(len(splats)) < 0.6
    state, stop, pairs = _tile(splats, camera, present)
    seen = oracle.view(splats.take(np.flatnonzero(present)), camera)
    for channel, offset in enumerate((RED, GREEN, BLUE)):
        found = _plane(state, offset)[:11, :13]
        np.testing.assert_allclose(found, seen.image[:, :, channel], atol=1e-4)
    rest = 1.0 - seen.weights.sum(axis=1).reshape(11, 13)
    np.testing.assert_allclose(_plane(state, REST)[:11, :13], rest, atol=1e-4)
    live = _plane(state, 0)
    assert ((live[:11, :13] == _plane(state, REST)[:11, :13]) | (live[:11, :13] == 0.0)).all()
    for offset in (0, RED, GREEN, BLUE, REST):
        outside = _plane(state, offset).copy()
        outside[:11, :13] = 0.0
        assert not outside.any()
    assert stop <= pairs


def test_splats_behind_a_finished_tile_are_not_blended():
    splats, camera = oracle.scene(5, n=90), oracle.camera(width=16, height=16)
    wall = splats.take(np.zeros(6, np.int64))
    wall.means[:] = camera.position + camera.rotation[2] * np.linspace(0.5, 0.8, 6)[:, None]
    wall.scales[:] = 3.0
    wall.opacities[:] = np.inf
    state, stop, pairs = _tile(concatenate([splats, wall]), camera)
    assert pairs > 20
    assert stop == 2, "the second capped splat ends every pixel"
    assert not _plane(state, 0).any()
    np.testing.assert_allclose(_plane(state, REST), 0.01, rtol=1e-4)


def test_a_reopened_tile_keeps_its_picture_and_clears_the_sums_of_hidden_pairs():
    splats, camera = oracle.scene(5, n=40), oracle.camera(width=9, height=12)
    wall = splats.take(slice(0, 6))
    wall.means[:] = camera.position + camera.rotation[2] * np.linspace(0.5, 0.8, 6)[:, None]
    wall.scales[:] = 3.0
    wall.opacities[:] = np.inf
    splats = concatenate([splats, wall])
    expected, stop, pairs = _tile(splats, camera, keep_rest=False)
    footprints = project(splats, camera)
    (lists,) = tile_lists(footprints, camera.width, camera.height)
    state = np.full(PLANES * PIXELS, 9.0, np.float32)
    sums = np.full((pairs, 2), 7.0, np.float32)
    found = draw_and_reopen(
        state,
        sums,
        2,
        0,
        lists.first,
        lists.starts,
        lists.members,
        footprints.ellipse,
        footprints.rows,
        row_colours(splats, footprints.index, camera),
        np.ones(len(footprints), np.bool_),
        camera.width,
        camera.height,
    )
    assert found == (0, 0, 12, 9, 0, stop)
    for offset in (RED, GREEN, BLUE):
        np.testing.assert_array_equal(_plane(state, offset), _plane(expected, offset))
    assert (_plane(state, 0)[:12, :9] == 1.0).all()
    assert (sums[:stop] == 7.0).all()
    assert 0 < stop < pairs
    assert (sums[stop:] == 0.0).all()


def test_lanes_are_summed_by_column():
    lanes = np.arange(2 * TILE, dtype=np.float32)
    sums = np.zeros((3, 2), np.float32)
    store_lane_sums(lanes, sums, 2, 1)
    assert sums.tolist() == [[0, 0], [sum(range(16)), sum(range(16, 32))], [0, 0]]


def test_a_comparison_adds_the_error_and_keeps_the_differences():
    splats, camera = oracle.scene(2, n=40), oracle.camera(width=12, height=9)
    state, _, _ = _tile(splats, camera)
    picture = np.stack([_plane(state, offset)[:9, :12] for offset in (RED, GREEN, BLUE)], axis=2)
    target = np.random.default_rng(0).random((9, 12, 3)).astype(np.float32)
    error = compare_tile(state, target, 0, 0, 9, 12, 5.0)
    assert error == pytest.approx(5.0 + np.square(target.astype(float) - picture).sum(), rel=1e-5)
    off = np.stack([_plane(state, o)[:9, :12] for o in (OFF_RED, OFF_GREEN, OFF_BLUE)], axis=2)
    np.testing.assert_array_equal(off, target - picture)


def test_planes_do_not_overlap():
    offsets = [0, RED, GREEN, BLUE, REST, OFF_RED, OFF_GREEN, OFF_BLUE]
    assert [int(offset) for offset in offsets] == [k * PIXELS for k in range(8)]
    assert (PLANES, PLANES_COMPARED) == (5, 8)
    assert blending.LANES == TILE
