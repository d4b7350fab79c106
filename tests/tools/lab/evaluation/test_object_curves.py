"""Objects against orders: what comes first, and over which pixels it is measured."""

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.splats import empty
from cogsplat.tools.lab.evaluation.object_curves import object_charts, object_curves, object_first

CAMERA = Camera(
    width=60, height=40, fx=40.0, fy=40.0, cx=30.0, cy=20.0,
    rotation=np.eye(3), translation=np.zeros(3), name="front",
)  # fmt: skip


def test_the_splats_of_an_object_come_first_in_their_order() -> None:
    rows = np.array([4, 2, 0, 1, 3])
    labels = np.array([7, 1, 7, 1, 7], np.uint32)
    assert object_first(rows, labels, 1).tolist() == [1, 3, 4, 2, 0]
    assert object_first(rows, labels, 7).tolist() == [4, 2, 0, 1, 3]


def test_an_object_is_whole_once_its_own_splats_are_there() -> None:
    scene = empty(0, 4)
    scene.means[:] = [[-2, 0, 6], [-1, 0, 6], [1, 0, 6], [2, 0, 6]]
    scene.scales[:] = np.log(0.3)
    scene.opacities[:] = 8.0
    scene.sh0[:] = 1.0
    scene = replace(scene, extras={"object": np.array([1, 1, 2, 2], "u1")})
    orders = {"left to right": np.arange(4)}
    points = object_curves(scene, orders, [], (0.25, 0.5, 1.0), [CAMERA])
    assert [(p.name, p.object, p.splats) for p in points] == [
        (name, label, splats)
        for label in (1, 2)
        for name in ("left to right", "left to right, object first")
        for splats in (1, 2, 4)
    ]
    quality = {(p.name, p.object, p.splats): p.psnr_db or 0.0 for p in points}
    # The first object stands left, so that the order itself has it first.
    for splats in (1, 2, 4):
        own = quality["left to right, object first", 1, splats]
        assert quality["left to right", 1, splats] == own
    assert quality["left to right", 2, 2] < 15
    assert 5 < quality["left to right, object first", 2, 1] < 15
    assert quality["left to right, object first", 2, 2] > 30
    assert quality["left to right", 2, 4] == 100.0
    assert points[0].report()["psnr_db"] == pytest.approx(points[0].psnr_db)
    pages = object_charts(points, "balls")
    assert list(pages) == ["object-1.svg", "object-2.svg"]
    text = "".join(ET.fromstring(pages["object-2.svg"]).itertext())
    assert "balls, object 2" in text
    assert "left to right, object first" in text


def test_an_object_that_is_not_there_is_refused() -> None:
    scene = replace(empty(0, 2), extras={"object": np.zeros(2, "u1")})
    for wanted in ([3], []):
        with pytest.raises(DataError) as caught:
            object_curves(scene, {"source": np.arange(2)}, wanted, (1.0,), [CAMERA])
        assert caught.value.code == "object-missing"
