"""Close views: nearer to the surface that a view shows, with the same rotation."""

from dataclasses import replace

import numpy as np
import oracle
import pytest
from shapes import sphere

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.frustum import NEAR
from cogsplat.codec.splats import Splats, concatenate
from cogsplat.codec.views.close_views import close_views, view_distances
from cogsplat.codec.views.view_sets import CLOSE_SHARE, CLOSE_VIEWS

RADIUS = 1.0


@pytest.fixture(scope="module")
def ball() -> Splats:
    return sphere(RADIUS, 4000)


def cameras(distance: float, count: int = 3) -> list[Camera]:
    return [oracle.camera(angle, distance=distance) for angle in np.linspace(0, 5, count)]


def test_a_close_view_stands_nearer_to_the_surface_and_looks_the_same_way(ball: Splats) -> None:
    for view in view_distances(ball, cameras(5.0)):
        assert view.distance == pytest.approx(5.0 - RADIUS, rel=0.1)
        assert view.close is not None
        assert view.close.distance == CLOSE_SHARE * view.distance
        camera = view.close.camera
        assert camera.name == f"{view.camera.name}-close"
        assert (camera.rotation == view.camera.rotation).all()
        assert (camera.fx, camera.fy) == (view.camera.fx, view.camera.fy)
        left = np.linalg.norm(camera.position) - RADIUS
        assert left == pytest.approx(CLOSE_SHARE * view.distance, rel=0.2)


def test_it_zooms_in_where_the_near_plane_would_cut(ball: Splats) -> None:
    (view,) = view_distances(ball, cameras(RADIUS + 6 * NEAR, 1))
    assert view.close is not None
    camera = view.close.camera
    assert np.linalg.norm(camera.position) - RADIUS > 3 * NEAR
    assert camera.fx > 1.3 * view.camera.fx


def test_a_view_of_nothing_has_no_close_view(ball: Splats) -> None:
    (away,) = cameras(5.0, 1)
    turned = replace(away, rotation=np.diag([-1.0, 1.0, -1.0]) @ away.rotation)
    turned = replace(turned, translation=-turned.rotation @ away.position)
    (view,) = view_distances(ball, [turned])
    assert (view.distance, view.close) == (0.0, None)
    hidden = replace(ball, opacities=np.full(len(ball), -20, np.float32))
    assert view_distances(hidden, [away]) == []
    assert close_views([view]) == []


def test_large_scenes_are_thinned_and_measured_alike(
    ball: Splats, monkeypatch: pytest.MonkeyPatch
) -> None:
    from cogsplat.codec.views import close_views as room

    views = cameras(5.0)
    whole = [view.distance for view in view_distances(ball, views)]
    monkeypatch.setattr(room, "_DRAWN_SPLATS", len(ball) // 8)
    thinned = [view.distance for view in view_distances(ball, views)]
    assert thinned == pytest.approx(whole, rel=0.1)


def test_close_views_are_few_and_of_any_threads(ball: Splats) -> None:
    many = cameras(5.0, 3 * CLOSE_VIEWS)
    one, two = (close_views(view_distances(ball, many, threads=n)) for n in (1, 2))
    assert len(one) == CLOSE_VIEWS
    assert [view.distance for view in one] == [view.distance for view in two]


def test_splats_that_cannot_be_drawn_block_nothing(ball: Splats) -> None:
    veil = replace(ball.take(slice(0, 500)), opacities=np.full(500, -20, np.float32))
    veil = replace(veil, means=veil.means * 3)
    (bare,), (veiled,) = (
        view_distances(s, cameras(5.0, 1)) for s in (ball, concatenate([ball, veil]))
    )
    assert veiled.distance == pytest.approx(bare.distance, rel=0.1)
