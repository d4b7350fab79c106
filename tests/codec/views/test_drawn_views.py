from dataclasses import replace

import numpy as np
import oracle

from cogsplat.codec.render.visible_depth import visible_depth
from cogsplat.codec.views.drawn_views import ViewDrawer


def angle_deg(one, other):
    cos = (np.trace(one.rotation @ other.rotation.T) - 1) / 2
    return np.degrees(np.arccos(np.clip(cos, -1, 1)))


def test_views_stay_near_the_path():
    splats = oracle.scene(0)
    one, other = (oracle.camera(angle) for angle in (0.2, 0.8))
    drawer, rng = ViewDrawer(splats, [one, other]), np.random.default_rng(1)
    gap = np.linalg.norm(other.position - one.position)
    shares = []
    for _ in range(200):
        view = drawer.draw(rng, off_path=False)
        along = (other.position - one.position) / gap
        share = (view.position - one.position) @ along / gap
        shares.append(share)
        aside = view.position - one.position - share * gap * along
        assert np.linalg.norm(aside) < 0.5 * gap
        assert min(angle_deg(view, one), angle_deg(view, other)) < 25 + angle_deg(one, other) / 2
        np.testing.assert_allclose(view.rotation @ view.rotation.T, np.eye(3), atol=1e-12)
        assert (view.width, view.fx) == (one.width, one.fx)
    # They cover the path.
    assert np.histogram(shares, bins=4, range=(0, 1))[0].min() > 25


def test_views_off_the_path_are_moved_and_turned():
    splats, camera = oracle.scene(1), oracle.camera(0.5)
    drawer, rng = ViewDrawer(splats, [camera]), np.random.default_rng(2)
    depth = visible_depth(splats, camera)
    views = [drawer.draw(rng, off_path=True) for _ in range(200)]
    turned = [angle_deg(view, camera) for view in views]
    assert 20 < max(turned) < 27
    moved = [np.linalg.norm(view.position - camera.position) / depth for view in views]
    assert 0.3 < max(moved) <= 0.4
    forwards = [(view.position - camera.position) @ view.rotation[2] > 0 for view in views]
    assert 40 < sum(forwards) < 120
    # A camera alone stays where it is, except off the path.
    assert np.allclose(drawer.draw(rng, off_path=False).position, camera.position)


def test_views_repeat_with_the_state_of_the_random_numbers():
    cameras = [replace(oracle.camera(0.3 * k), name=f"v{k}") for k in range(8)]
    drawer = ViewDrawer(oracle.scene(2), cameras)
    one, two = (drawer.draw(np.random.default_rng(5), off_path=True) for _ in range(2))
    np.testing.assert_array_equal(one.translation, two.translation)
    assert one.name.endswith("-drawn")
