"""Pieces of rooms: on their faces, turned to who looks at them, in colours that can be shown."""

import numpy as np
import pytest

from cogsplat.tools.lab.synthetic import furniture
from cogsplat.tools.lab.synthetic.furniture import Paint, box, face, lathe

WHITE = (0.7, 0.7, 0.7)
DARK = (0.2, 0.1, 0.05)
PAINTS: dict[str, Paint] = {
    "plaster": furniture.plaster(WHITE, 1),
    "wallpaper": furniture.wallpaper(WHITE, DARK, 2),
    "bricks": furniture.bricks(DARK, 3),
    "planks": furniture.planks(WHITE, DARK, 4),
    "planks turned": furniture.planks(WHITE, DARK, 4, turned_by=True),
    "tiles": furniture.tiles(WHITE, DARK, 5),
    "rug": furniture.rug(WHITE, DARK, 6),
    "fabric": furniture.fabric(WHITE, 7),
    "books": furniture.books(8),
    "painting": furniture.painting(9),
    "daylight": furniture.window_view(10),
    "shining": furniture.lampshade(WHITE),
    "glazed": furniture.earthenware(DARK, 11),
}


@pytest.mark.parametrize("name", PAINTS)
def test_paint_has_colours_in_range_and_a_pattern(name: str) -> None:
    piece = face((1.0, 0.0, 2.0), (1.5, 0.0, 0.0), (0.0, 1.2, 0.0), PAINTS[name])
    surfels = piece.make(2000, np.random.default_rng(0))
    assert len(surfels.albedo) == 2000
    assert np.isfinite(surfels.albedo).all()
    assert surfels.albedo.min() >= 0.0
    assert surfels.albedo.max() < 3.0
    assert surfels.albedo.std(axis=0).max() > 0.005


def test_a_face_is_where_it_says_and_its_splats_stay_inside() -> None:
    piece = face((0.0, 1.0, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, -1.0), PAINTS["plaster"], 3.0)
    assert piece.area == pytest.approx(6.0)
    patch = piece.make(4000, np.random.default_rng(1)).patch
    np.testing.assert_array_equal(patch.points[:, 1], 1.0)
    np.testing.assert_allclose(patch.normals, [[0.0, 1.0, 0.0]] * 4000)
    assert patch.points[:, 0].min() >= 0.0
    assert patch.points[:, 0].max() <= 2.0
    assert patch.points[:, 2].min() >= -1.0


def test_a_box_has_five_sides_that_look_outwards() -> None:
    low, high = (1.0, 0.0, -2.0), (2.0, 0.5, 0.0)
    sides = box(low, high, PAINTS["fabric"], 1.0)
    assert len(sides) == 5
    assert sum(side.area for side in sides) == pytest.approx(2 * 0.5 + 2 * 1.0 + 2.0)
    middle = 0.5 * (np.array(low) + np.array(high))
    for side in sides:
        patch = side.make(50, np.random.default_rng(2)).patch
        outwards = ((patch.points - middle) * patch.normals).sum(axis=1)
        assert (outwards > 0.0).all()
        assert (patch.points >= np.array(low) - 1e-12).all()
        assert (patch.points <= np.array(high) + 1e-12).all()


def test_a_turned_piece_has_the_area_of_its_surface() -> None:
    upright = lathe([(0.5, 0.0), (0.5, 1.0), (0.5, 2.0)], (3.0, 1.0, 4.0), PAINTS["glazed"], 1.0)
    assert upright.area == pytest.approx(2.0 * np.pi * 0.5 * 2.0, rel=1e-6)
    patch = upright.make(300, np.random.default_rng(3)).patch
    away = patch.points - np.array([3.0, 1.0, 4.0])
    np.testing.assert_allclose(np.hypot(away[:, 0], away[:, 2]), 0.5, rtol=1e-6)
