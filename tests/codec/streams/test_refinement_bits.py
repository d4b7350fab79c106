import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams import kinds, records, refinement_bits, scale_differences, sorted_means
from cogsplat.codec.streams.adaptive_step import StepModel
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import Stream
from cogsplat.codec.streams.stream_inputs import Inputs

COARSE = StepModel((0.5, 1.0, 0.5, -0.25, 0.75, 0.25))


def scales_of(rows, seed=1):
    rng = np.random.default_rng(seed)
    steps = np.abs(rng.normal(1, 1, size=(rows, 3))).astype(np.float32)
    steps[:, 0] = rng.normal(0, 3, size=rows)
    return scale_differences.scales_of(steps)


def stored(*made):
    return records.unpack(memoryview(records.pack(made)), "x", 1 << 18)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(st.integers(0, 32), st.integers(1, 15), st.integers(0, 10**6))
def test_codes_come_apart_and_together(extra_bits, bits, seed):
    rng = np.random.default_rng(seed)
    codes = rng.integers(0, (1 << extra_bits + bits) + 1, (50, 3))
    coarse = refinement_bits.coarse_codes(codes, bits)
    # The coarse code is the nearest one.
    assert (np.abs(codes - (coarse << bits)) <= 1 << bits - 1).all()
    (stream,) = stored(refinement_bits.write(codes, bits))
    back, gained = refinement_bits.read(stream, coarse)
    assert gained == bits
    assert np.array_equal(back, codes)


def cells(rows, seed=3):
    rng = np.random.default_rng(seed)
    minimum = np.array([-2, 0, 5], np.float32)
    grid = Grid(minimum, minimum + np.float32(4), np.array([9, 17, 5], np.uint32))
    return grid, (rng.random((rows, 3)) * 4 + minimum).astype(np.float32)


@pytest.mark.parametrize("bits", [1, 2, 5, 15])
def test_means_are_as_fine_as_in_one_piece(bits, kernels):
    grid, means = cells(700)
    scales = scales_of(700)
    extra = COARSE.extra_bits(scales)
    fine = sorted_means.quantise(means, grid, extra, bits)
    codes = refinement_bits.coarse_codes(fine, bits)
    order = sorted_means.morton_order(codes, extra)
    codes, fine, extra, scales = codes[order], fine[order], extra[order], scales[order]
    (head,) = stored(sorted_means.write(codes, grid, extra, COARSE))
    (below,) = stored(refinement_bits.write(fine, bits))
    out = np.empty((700, 3), np.float32)
    kinds.read(head, out, Inputs(scales=scales))
    assert np.array_equal(out, sorted_means.dequantise(codes, grid, extra))
    kinds.read(head, out, Inputs(scales=scales, refinement=below))
    assert np.array_equal(out, sorted_means.dequantise(fine, grid, extra + np.uint8(bits)))
    step = np.ldexp(grid.step, -(extra + bits).astype(int)[:, None])
    inside = means[order] < grid.maximum
    missed = np.abs(out - means[order])
    assert (missed <= 0.51 * step + 1e-6)[inside].all()


def head_of_zeros(rows):
    grid, _ = cells(rows)
    codes = np.zeros((rows, 3), np.int64)
    stream = sorted_means.write(codes, grid, np.zeros(rows, np.uint8), StepModel.constant(0))
    return stored(stream)[0], Inputs(scales=np.zeros((rows, 3), np.float32)), codes


def refusal(rows, below):
    head, inputs, _ = head_of_zeros(rows)
    inputs = Inputs(scales=inputs.scales, refinement=stored(below)[0])
    with pytest.raises(FormatError) as caught:
        kinds.read(head, np.empty((rows, 3), np.float32), inputs)
    return caught.value.code


def test_codes_below_0_are_refused(kernels):
    below = refinement_bits.write(np.zeros((6, 3), np.int64), 4)
    for row in range(6):
        for axis in range(3):
            codes = np.zeros((6, 3), np.int64)
            codes[row, axis] = -1
            assert refusal(6, refinement_bits.write(codes, 4)) == "code-range"
    head, inputs, codes = head_of_zeros(6)
    inputs = Inputs(scales=inputs.scales, refinement=stored(below)[0])
    out = np.empty((6, 3), np.float32)
    kinds.read(head, out, inputs)
    assert (out == cells(6)[0].minimum).all()


def test_padding_behind_bits_is_zeros(kernels):
    below = refinement_bits.write(np.zeros((5, 3), np.int64), 1)
    below.planes[0][-1] |= 0x80
    assert refusal(5, below) == "bits-padding"


def test_other_parameters_are_refused(kernels):
    good = refinement_bits.write(np.zeros((5, 3), np.int64), 2)
    for params, code in (
        (b"", "stream-params"),
        (bytes([2]), "stream-params"),
        (bytes([2, 0, 0, 0, 0]), "stream-params"),
        (bytes([0, 0, 0, 0]), "refinement-bits"),
        (bytes([16, 0, 0, 0]), "refinement-bits"),
        (bytes([2, 1, 0, 0]), "refinement-bits"),
        (bytes([2, 0, 0, 1]), "refinement-bits"),
    ):
        stream = Stream(good.attribute, good.kind, 5, params, good.planes)
        assert refusal(5, stream) == code
    stream = Stream(good.attribute, good.kind, 5, good.params, [])
    assert refusal(5, stream) == "stream-planes"
