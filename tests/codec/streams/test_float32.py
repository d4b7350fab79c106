import struct

import numpy as np

from cogsplat.codec.streams import float32
from cogsplat.codec.streams.records import Attribute


def test_planes_are_little_endian_whatever_the_order_of_the_array() -> None:
    """As on a machine of the other order, whose own arrays are like this."""
    numbers = [[1.0, -2.5, 3e-7], [1e20, 0.0, -0.0]]
    expected = np.array(
        [list(struct.pack("<3f", *row)) for row in numbers], np.uint8
    ).T  # one plane for each byte of each component
    for order in ("<f4", ">f4"):
        stream = float32.write(Attribute.MEANS, np.array(numbers, order))
        assert np.array_equal(np.array(stream.planes), expected), order
