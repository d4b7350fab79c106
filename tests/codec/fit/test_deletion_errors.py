import numpy as np
import oracle
import pytest

from cogsplat.codec.fit.deletion_errors import deletion_errors
from cogsplat.codec.fit.training_views import make_training_views
from cogsplat.codec.render.rasteriser import render


@pytest.mark.parametrize("background", [(0.0, 0.0, 0.0), (0.9, 0.1, 0.5)])
def test_errors_match_renders_without_each_splat(background):
    # Faint splats: no pixel becomes opaque, which would hide splats behind it.
    splats = oracle.scene(0, n=40, opacity=0.5)
    splats.opacities[:] -= 2.0
    made = make_training_views(splats, [oracle.camera()], background=background, threads=1)
    views = made.sample(3, 0)
    assert len(views) == 3
    found = deletion_errors(splats, views, threads=2)
    expected = np.zeros(len(splats))
    for camera, config in views:
        whole = render(splats, camera, config)
        for row in range(len(splats)):
            without = render(splats.take(np.arange(len(splats)) != row), camera, config)
            expected[row] += np.square(whole - without, dtype=np.float64).sum()
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4 * expected.max())
    assert found.max() > 10 * np.median(found)


def test_errors_of_views_are_added():
    splats = oracle.scene(1, n=30)
    cameras = [oracle.camera(0.1), oracle.camera(0.9)]
    views = make_training_views(splats, cameras, draw=False).sample(8, 0)
    each = [deletion_errors(splats, [view]) for view in views]
    assert deletion_errors(splats, views) == pytest.approx(each[0] + each[1])
    assert np.any(each[0] != each[1])
