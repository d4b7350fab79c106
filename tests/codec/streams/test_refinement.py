import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams import (
    kinds,
    records,
    refinement_bits,
    scale_differences,
    sorted_means,
    swing_twist,
)
from cogsplat.codec.streams.adaptive_step import StepModel
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.inputs import Inputs
from cogsplat.codec.streams.records import Attribute

COARSE = StepModel((0.5, 1.0, 0.5, -0.25, 0.75, 0.25))


def scales_of(rows, seed=1):
    rng = np.random.default_rng(seed)
    steps = np.abs(rng.normal(1, 1, size=(rows, 3))).astype(np.float32)
    steps[:, 0] = rng.normal(0, 3, size=rows)
    return scale_differences.accumulate(steps)


def stored(*made):
    return records.unpack(memoryview(records.pack(made)), "x", 1 << 18)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(st.integers(0, 15), st.integers(0, 15), st.integers(0, 10**6))
def test_codes_come_apart_and_together(halvings, extra, seed):
    codes = np.random.default_rng(seed).integers(0, (1 << halvings + extra) + 1, 50)
    gains = np.full(50, extra, np.uint8)
    coarse, fields = refinement_bits.coarse_of(codes.astype(np.uint32), gains)
    assert (coarse <= 1 << halvings).all()
    assert (fields < 1 << extra).all()
    back = (coarse.astype(int) << extra) + fields.astype(int) - refinement_bits.half_of(gains)
    assert np.array_equal(back, codes)
    # The coarse code is the nearest one.
    assert (np.abs(codes - (coarse.astype(int) << extra)) <= 1 << max(extra - 1, 0)).all()


def test_no_row_loses_halvings():
    scales = scales_of(500)
    halvings = COARSE.extra_bits(scales)
    for constant in (-50.0, 0.0, 2.5, 4.0, 50.0):
        finer = refinement_bits.with_constant(COARSE, constant)
        total = halvings + refinement_bits.gained(finer, scales, halvings)
        assert np.array_equal(total, np.maximum(finer.extra_bits(scales), halvings))


@pytest.mark.parametrize("constant", [0.5, 1.5, 3.0, 6.25, 20.0])
def test_turns_are_as_fine_as_in_one_piece(constant, kernels):
    rng = np.random.default_rng(2)
    values = rng.uniform(-0.7, 0.7, size=(800, 3))
    values[:4] = [[-1, 0, 1], [1, 0, -1], [0, 1, 0], [0, -1, 1]]
    coarse, fine = scales_of(800), scales_of(800) + np.float32(0.3)
    constants = [constant, constant - 0.75]
    head, below, alone = swing_twist.refined_turns(values, coarse, COARSE, COARSE, fine, constants)
    read = stored(head)[0]
    finer = Inputs(scales=coarse, refined_scales=fine, refinement=stored(below)[0])
    out = np.empty((800, 4), np.float32)
    kinds.read(read, out, Inputs(scales=coarse))
    assert np.array_equal(out, swing_twist.quats_of(alone))
    kinds.read(read, out, finer)
    halvings = [
        np.maximum(
            refinement_bits.with_constant(COARSE, c).extra_bits(fine), COARSE.extra_bits(coarse)
        )
        for c in constants
    ]
    expected = np.empty((800, 3), np.float32)
    for column, own in enumerate((halvings[0], halvings[0], halvings[1])):
        expected[:, column] = swing_twist.dequantise(
            swing_twist.quantise(values[:, column], own), own
        )
    assert np.array_equal(out, swing_twist.quats_of(expected))


def cells(rows, seed=3):
    rng = np.random.default_rng(seed)
    minimum = np.array([-2, 0, 5], np.float32)
    grid = Grid(minimum, minimum + np.float32(4), np.array([9, 17, 5], np.uint32))
    return grid, (rng.random((rows, 3)) * 4 + minimum).astype(np.float32)


@pytest.mark.parametrize("constant", [0.5, 2.0, 5.0, 30.0])
def test_means_are_as_fine_as_in_one_piece(constant, kernels):
    grid, means = cells(700)
    coarse, fine = scales_of(700), scales_of(700) - np.float32(0.4)
    halvings = COARSE.extra_bits(coarse)
    finer = refinement_bits.with_constant(COARSE, constant)
    extra = refinement_bits.gained(finer, fine, halvings)
    codes = sorted_means.codes_of(means, grid, halvings + extra)
    kept, _ = refinement_bits.coarse_of(codes, extra[:, None])
    order = sorted_means.morton_order(kept, halvings)
    kept, below = sorted_means.refine(codes[order], extra[order], constant)
    head = sorted_means.write(kept, grid, halvings[order], COARSE)
    out = np.empty((700, 3), np.float32)
    kinds.read(stored(head)[0], out, Inputs(scales=coarse[order]))
    assert np.array_equal(out, sorted_means.values(kept, grid, halvings[order]))
    inputs = Inputs(scales=coarse[order], refined_scales=fine[order], refinement=stored(below)[0])
    kinds.read(stored(head)[0], out, inputs)
    assert np.array_equal(out, sorted_means.values(codes[order], grid, (halvings + extra)[order]))
    step = np.ldexp(grid.step, -(halvings + extra).astype(int)[:, None])
    inside = means < grid.maximum
    missed = np.abs(out - means[order])
    assert (missed <= 0.51 * step[order] + 1e-6)[inside[order]].all()


@pytest.mark.parametrize("filling", [0, 255])
def test_bits_that_lead_out_of_a_turn_are_refused(filling, kernels):
    values = np.full((6, 3), -1.0 if filling == 0 else 1.0)
    scales = np.zeros((6, 3), np.float32)
    four = StepModel((4.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    head, below, _ = swing_twist.refined_turns(values, scales, four, four, scales, [7.0, 7.0])
    # Six rows of nine bits and two of padding.
    plane = np.full(len(below.planes[-1]), filling, np.uint8)
    plane[-1] &= 0x3F
    below = refinement_bits.bits_stream(Attribute.QUATS, [7.0, 7.0], [*below.planes[:-1], plane], 6)
    inputs = Inputs(scales=scales, refined_scales=scales, refinement=stored(below)[0])
    with pytest.raises(FormatError) as caught:
        kinds.read(stored(head)[0], np.empty((6, 4), np.float32), inputs)
    assert caught.value.code == "code-range"


def test_padding_behind_bits_is_zeros(kernels):
    grid, means = cells(5)
    two = StepModel((2.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    scales = np.zeros((5, 3), np.float32)
    gains = np.full(5, 1, np.uint8)
    codes = sorted_means.codes_of(means, grid, gains + np.uint8(2))
    kept, _ = refinement_bits.coarse_of(codes, gains[:, None])
    codes = codes[sorted_means.morton_order(kept, gains + np.uint8(1))]
    kept, below = sorted_means.refine(codes, gains, 3.0)
    head = sorted_means.write(kept, grid, gains + np.uint8(1), two)
    below.planes[0][-1] |= 0x80
    inputs = Inputs(scales=scales, refined_scales=scales, refinement=stored(below)[0])
    with pytest.raises(FormatError) as caught:
        kinds.read(stored(head)[0], np.empty((5, 3), np.float32), inputs)
    assert caught.value.code == "bits-padding"
