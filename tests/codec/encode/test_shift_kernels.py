import numpy as np
import pytest

from cogsplat.codec.clustering import few_rows
from cogsplat.codec.encode.shift_adam import ShiftAdam
from cogsplat.codec.encode.shift_kernels import (
    add_gradient,
    choose_rows,
    draw_shifts,
    move_shifts,
)

COUNTS = (5, 1, 9, 4)
STARTS = np.concatenate([[0], np.cumsum(COUNTS)]).astype(np.int64)
SPLATS = int(STARTS[-1])
CHUNK_OF = np.repeat(np.arange(len(COUNTS)), COUNTS)
# The last chunk has no shifts of its own.
CODED = int(STARTS[3])
RATES = np.array([0.04, 0.2])


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def own_shifts(rng):
    return rng.normal(size=(CODED, 2)).astype(np.float32)


def padded(own):
    return np.concatenate([own, np.zeros((SPLATS - CODED, 2), np.float32)])


def test_a_splat_is_drawn_with_its_chunks_shift_and_its_own(rng):
    own = own_shifts(rng)
    chunk_shifts, strengths = rng.normal(size=(2, 6, 2))
    scales = rng.normal(size=(SPLATS, 3)).astype(np.float32)
    opacities = rng.normal(size=SPLATS).astype(np.float32)
    drawn_scales, drawn_opacities = np.empty_like(scales), np.empty_like(opacities)
    draw_shifts(
        STARTS, chunk_shifts, strengths, own, scales, opacities, drawn_scales, drawn_opacities
    )
    shifts = chunk_shifts[CHUNK_OF] + strengths[CHUNK_OF] * padded(own)
    np.testing.assert_allclose(drawn_scales, scales + shifts[:, :1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(drawn_opacities, opacities + shifts[:, 1], rtol=0, atol=1e-6)


def test_views_add_up_where_they_show_a_splat(rng):
    gradients = np.zeros((SPLATS, 2))
    expected = np.zeros((SPLATS, 2))
    for weight in (0.5, 2.0):
        rows = rng.permutation(SPLATS)[:7].astype(np.int32)
        by_scale, by_opacity = rng.normal(size=(2, 7))
        add_gradient(rows, by_scale, by_opacity, weight, gradients)
        expected[rows] += weight * np.stack([by_scale, by_opacity], axis=1)
    np.testing.assert_allclose(gradients, expected, rtol=1e-12)


def test_steps_are_those_of_adam_and_sums_those_of_the_chunks(rng):
    strengths = rng.uniform(0.2, 1.0, (len(COUNTS), 2))
    shifts = np.zeros((CODED, 2), np.float32)
    means, squares = np.zeros((2, CODED, 2), np.float32)
    counts = np.zeros(len(COUNTS), np.int64)
    expected, adam = np.zeros((CODED, 2)), ShiftAdam((CODED, 2), RATES)
    for _ in range(6):
        own = own_shifts(rng)
        gradients = rng.normal(size=(SPLATS, 2)) * 1e-3
        counts += 1
        of_chunks, of_strengths = np.zeros((2, len(COUNTS), 2))
        move_shifts(
            STARTS,
            gradients,
            strengths,
            RATES,
            counts,
            means,
            squares,
            shifts,
            own,
            of_chunks,
            of_strengths,
        )
        expected -= adam.step(slice(0, CODED), (gradients * strengths[CHUNK_OF])[:CODED])
        np.testing.assert_allclose(shifts, expected, rtol=1e-4, atol=1e-6)
        for chunk in range(len(COUNTS)):
            mine = chunk == CHUNK_OF
            np.testing.assert_allclose(of_chunks[chunk], gradients[mine].sum(axis=0))
            np.testing.assert_allclose(
                of_strengths[chunk], (gradients * padded(own))[mine].sum(axis=0), atol=1e-15
            )


def test_rows_are_the_nearest_ones(rng):
    shifts = own_shifts(rng)
    spread = np.array([0.3, 1.8])
    book = rng.normal(size=(8, 2))
    codes, own = np.full(CODED, 255, np.uint8), np.full((CODED, 2), np.nan, np.float32)
    choose_rows(shifts, spread, book, codes, own)
    expected = few_rows.nearest(shifts / spread, book / spread)
    np.testing.assert_array_equal(codes, expected)
    np.testing.assert_array_equal(own, book[expected].astype(np.float32))


def test_the_first_of_equal_rows_is_taken():
    codes, own = np.empty(1, np.uint8), np.empty((1, 2), np.float32)
    book = np.array([[1.0, 0.0], [-1.0, 0.0], [1.0, 0.0]])
    choose_rows(np.zeros((1, 2), np.float32), np.ones(2), book, codes, own)
    assert codes[0] == 0
