"""Parts of a scene by chunks, objects and splats."""

import numpy as np
import pytest

from cogsplat.formats.cogs.index_tables import ChunkTable
from cogsplat.formats.cogs.selection import select_chunks


def table():
    splats = np.array([10, 20, 30, 40], np.uint32)
    none = np.zeros(4, np.uint32)
    objects = np.array([0, 1, 1, 2], np.uint32)
    until = np.array([3, 0, 0, 0], np.uint32)
    box, quality = np.zeros((4, 6), np.float32), np.zeros(4, np.float32)
    return ChunkTable(splats, box, np.zeros(4), none, none, objects, quality, until)


@pytest.mark.parametrize(
    ("conditions", "expected"),
    [
        ({}, [1, 2, 3]),
        ({"complete": 2}, [0, 1]),
        ({"chunks": (0, 2)}, [0, 1]),
        ({"chunks": (None, None)}, [0, 1, 2, 3]),
        ({"splats": 11}, [0, 1]),
        ({"splats": 31}, [1, 2]),
        ({"splats": 0}, []),
        ({"objects": [1]}, [1, 2]),
        ({"objects": [0, 2]}, [3]),
        ({"objects": [1, 2], "splats": 21}, [1, 2]),
    ],
)
def test_conditions_hold_together(conditions, expected):
    complete = conditions.pop("complete", 4)
    assert select_chunks(table(), complete, **conditions) == expected


@pytest.mark.parametrize(
    "conditions", [{"chunks": (2, 1)}, {"chunks": (0, 5)}, {"objects": [3]}, {"splats": -1}]
)
def test_what_the_file_does_not_have_is_misuse(conditions):
    with pytest.raises(ValueError, match=next(iter(conditions)).rstrip("s")):
        select_chunks(table(), 4, **conditions)
