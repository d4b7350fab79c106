"""Downscaled pictures and cameras."""

import numpy as np

from cogsplat.codec.fit.downscaling import downscale_picture
from cogsplat.tools.lab.synthetic.terrace import synth_cameras


def test_downscaled_pictures_match_downscaled_cameras():
    picture = np.arange(7 * 9 * 3, dtype=np.float32).reshape(7, 9, 3)
    small = downscale_picture(picture, 2)
    assert small.shape == (3, 4, 3)
    np.testing.assert_allclose(small[1, 2], picture[2:4, 4:6].mean(axis=(0, 1)))
    camera = synth_cameras(1, 9, 7)[0]
    found = camera.downscaled(2)
    assert (found.width, found.height) == (4, 3)
    assert found.fx == camera.fx / 2
    assert found.cy == camera.cy / 2
