import numpy as np
import oracle
import pytest

from cogsplat.codec.geometry import sh
from cogsplat.codec.render.projection import project
from cogsplat.codec.render.shading import footprint_colours, row_colours


@pytest.mark.parametrize("degree", range(4))
def test_colours_are_those_that_are_drawn(degree):
    splats, camera = oracle.scene(3, n=80, degree=degree), oracle.camera()
    rows = np.flatnonzero(np.arange(80) % 3 > 0).astype(np.int32)
    footprints = project(splats.take(rows), camera)
    assert 20 < len(footprints) < len(rows)
    of_scene = rows[footprints.index]
    found = footprint_colours(splats, camera, footprints, rows=rows)
    np.testing.assert_array_equal(found, row_colours(splats, of_scene, camera))
    every = row_colours(splats, np.arange(80, dtype=np.int32), camera)
    np.testing.assert_array_equal(found, every[of_scene])


@pytest.mark.parametrize("degree", range(4))
def test_colours_are_the_sum_of_the_bases(degree):
    splats, camera = oracle.scene(4, n=80), oracle.camera()
    rows = np.array([5, 3, 70, 3], np.int32)
    cut = splats.with_sh_degree(degree)
    expected = sh.colours(cut.sh0, cut.shN, oracle.directions(splats, camera))[rows]
    for found in (row_colours(cut, rows, camera), row_colours(splats, rows, camera, degree)):
        np.testing.assert_allclose(found, expected, atol=1e-5)


def test_no_footprints_have_no_colours():
    splats, camera = oracle.scene(1, n=5), oracle.camera()
    splats.means[:] = np.nan
    footprints = project(splats, camera)
    found = footprint_colours(splats, camera, footprints)
    assert found.shape == (0, 3)
