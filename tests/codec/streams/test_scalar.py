import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from streamed import grid_of, numbers, refused

from cogsplat.codec.streams import grid_planes, scalar
from cogsplat.codec.streams.grid import MAX_LEVELS
from cogsplat.codec.streams.records import INFINITIES, Attribute, Kind, Stream

checked = settings(derandomize=True, deadline=None, max_examples=100)


@checked
@given(
    st.integers(0, 12),
    st.tuples(*[st.sampled_from([1, 2, 255, 256, 257, 65536, 65537, MAX_LEVELS])] * 3),
    st.integers(0, 2**32 - 1),
)
def test_scalar_streams_hold_the_grids_own_values(rows, levels, seed):
    rng = np.random.default_rng(seed)
    grid = grid_of(levels, -3.0, 7.5)
    codes = rng.integers(0, np.array(levels), (rows, 3)).astype(np.uint32)
    values = grid.dequantise(codes)
    stream = scalar.write(Attribute.SH0, values, grid)
    assert len(stream.planes) == sum(grid_planes.code_bytes(count) for count in levels)
    assert numbers(stream).tobytes() == values.tobytes()


def test_planes_come_by_component_then_lowest_byte_first():
    values = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]], np.float32)
    stream = scalar.write(Attribute.SH0, values, grid_of([0x1234, 1, 3]))
    assert [plane.tolist() for plane in stream.planes] == [[0, 0x33], [0, 0x12], [0, 2]]


def test_a_constant_of_negative_zero_decodes_as_its_level_does():
    grid = grid_of([1, 2, 2], -0.0, -0.0)
    values = np.zeros((2, 3), np.float32)
    out = numbers(scalar.write(Attribute.SH0, values, grid))
    assert out.tobytes() == bytes(24)


@checked
@given(
    st.lists(
        st.one_of(st.floats(-30, 30, width=32), st.sampled_from([math.inf, -math.inf])),
        min_size=1,
        max_size=20,
    ),
    st.sampled_from([1, 2, 254, 255, 256, 65534, 65535, MAX_LEVELS - 2]),
)
def test_infinities_take_two_codes_above_the_levels(values, levels):
    source = np.array(values, np.float32)[:, None]
    grid = grid_of([levels], -30.0, 30.0)
    stream = scalar.write_with_infinities(Attribute.OPACITIES, source, grid)
    assert stream.flags == INFINITIES
    out = numbers(stream)
    infinite = np.isinf(source)
    np.testing.assert_array_equal(out[infinite], source[infinite])
    expected = grid.dequantise(grid.quantise(np.where(infinite, grid.minimum, source)))
    np.testing.assert_array_equal(out[~infinite], expected[~infinite])


def test_codes_above_the_levels_are_refused():
    plane = np.array([0, 4, 5], np.uint8)
    zeros = np.zeros(3, np.uint8)
    params = grid_of([5, 2, 2]).pack()
    stream = Stream(Attribute.SH0, Kind.SCALAR, 3, params, [plane, zeros, zeros])
    refused(lambda: numbers(stream), "code-range", "6.4")
    infinite = Stream(Attribute.OPACITIES, Kind.SCALAR, 3, grid_of([4]).pack(), [plane], INFINITIES)
    assert numbers(infinite)[:, 0].tolist() == [0.0, math.inf, -math.inf]
    beyond = Stream(Attribute.OPACITIES, Kind.SCALAR, 3, grid_of([3]).pack(), [plane], INFINITIES)
    refused(lambda: numbers(beyond), "code-range", "6.4")


def test_infinities_leave_two_codes_less():
    planes = [np.zeros(2, np.uint8)] * 3
    for levels, fits in ((MAX_LEVELS - 2, True), (MAX_LEVELS - 1, False)):
        params = grid_of([levels]).pack()
        stream = Stream(Attribute.OPACITIES, Kind.SCALAR, 2, params, planes, INFINITIES)
        if fits:
            assert (numbers(stream) == 0).all()
        else:
            refused(lambda stream=stream: numbers(stream), "grid-levels", "6.4")
