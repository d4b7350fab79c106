import numpy as np
import oracle
import pytest

from cogsplat.codec.fit.deletion_errors import deletion_errors
from cogsplat.codec.fit.training_views import make_training_views
from cogsplat.codec.render.rasteriser import render


def test_errors_are_those_of_scenes_without_the_splat():
    # Faint enough that no pixel ends: what lies behind the last splat cannot come to light.
    splats = oracle.scene(0, n=40, opacity=0.5)
    splats.opacities[:] -= 2.0
    training_views = make_training_views(splats, [oracle.camera()], threads=1)
    found = deletion_errors(splats, training_views, threads=2)
    expected = np.zeros(len(splats))
    for camera, config in zip(training_views.cameras, training_views.configs, strict=True):
        whole = render(splats, camera, config)
        for row in range(len(splats)):
            without = render(splats.take(np.arange(len(splats)) != row), camera, config)
            expected[row] += np.square(whole - without, dtype=np.float64).sum()
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4 * expected.max())
    assert found.max() > 10 * np.median(found)


def test_only_the_views_asked_for_count():
    splats = oracle.scene(1, n=30)
    training_views = make_training_views(
        splats, [oracle.camera(0.1), oracle.camera(0.9)], copies=False
    )
    each = [deletion_errors(splats, training_views, [view]) for view in (0, 1)]
    assert deletion_errors(splats, training_views) == pytest.approx(each[0] + each[1])
    assert np.any(each[0] != each[1])
