from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.render.projection import project
from cogsplat.codec.render.sensitivities import view_colours
from cogsplat.codec.render.shading import footprint_colours, row_colours


@pytest.mark.parametrize("degree", range(4))
def test_colours_are_those_that_are_drawn(degree):
    splats, camera = oracle.scene(3, n=80, degree=degree), oracle.camera()
    rows = np.flatnonzero(np.arange(80) % 3 > 0).astype(np.int32)
    footprints = project(splats.take(rows), camera, kernel_px=0.3, antialiased=False)
    assert 20 < len(footprints) < len(rows)
    of_scene = replace(footprints, index=rows[footprints.index])
    found = footprint_colours(splats, rows, camera, footprints)
    np.testing.assert_array_equal(found, view_colours(splats, camera, of_scene))
    every = row_colours(splats, np.arange(80, dtype=np.int32), camera)
    np.testing.assert_array_equal(found, every[of_scene.index])


def test_no_footprints_have_no_colours():
    splats, camera = oracle.scene(1, n=5), oracle.camera()
    splats.means[:] = np.nan
    footprints = project(splats, camera, kernel_px=0.3, antialiased=False)
    found = footprint_colours(splats, np.arange(5, dtype=np.int32), camera, footprints)
    assert found.shape == (0, 3)
