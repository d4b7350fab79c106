import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.streams import grid_planes

checked = settings(derandomize=True, deadline=None, max_examples=100)


def test_planes_are_as_many_bytes_as_the_largest_code_needs():
    for levels in (0, 1, 2, 255, 256, 257, 65535, 65536, 65537, 2**24 - 1, 2**24):
        largest = max(levels, 1) - 1
        assert grid_planes.code_bytes(levels) == len(largest.to_bytes(8, "little").rstrip(b"\0"))


@checked
@given(st.integers(1, 2**24), st.lists(st.floats(0, 1), min_size=0, max_size=20))
def test_planes_are_the_bytes_of_the_codes_lowest_first(levels, shares):
    codes = np.array([round(share * (levels - 1)) for share in shares], np.uint32)
    planes = grid_planes.split_planes(codes, levels)
    for row, code in enumerate(codes.tolist()):
        octets = bytes(int(plane[row]) for plane in planes)
        assert octets == code.to_bytes(len(planes), "little")
    np.testing.assert_array_equal(grid_planes.join_planes(planes, len(codes)), codes)
