"""Judging: the figures are those of rendered pictures, whatever the number of threads."""

from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.errors import Cancelled, DataError
from cogsplat.codec.metrics import psnr, ssim
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.scoring import view_quality
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.close_views import close_views, view_distances
from cogsplat.codec.views.roam_views import roam
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

CAMERAS = synth_cameras(4, 48, 36)


@pytest.fixture(scope="module")
def scene() -> Splats:
    return synth(1500)


def test_each_view_is_compared_as_rendered(scene: Splats) -> None:
    # The other scene states another kernel, and is drawn with it.
    other = replace(scene.take(slice(0, 1000)), info=replace(scene.info, kernel_px=0.1))
    found = view_quality.view_qualities(scene, other, CAMERAS, background=(0.2, 0.3, 0.4))
    for camera, quality in zip(CAMERAS, found, strict=True):
        config = RenderConfig(background=(0.2, 0.3, 0.4))
        first, second = (render(splats, camera, config) for splats in (scene, other))
        assert quality == view_quality.ViewQuality(
            camera.name, psnr(first, second), ssim(first, second)
        )


def test_roam_views_are_made_from_the_reference(scene: Splats) -> None:
    other = scene.take(slice(0, 700))
    found = view_quality.compare(scene, other, CAMERAS)
    plain = [replace(quality, distance=None) for quality in found.test]
    assert tuple(plain) == view_quality.view_qualities(scene, other, CAMERAS)
    distances = view_distances(scene, CAMERAS)
    assert [quality.distance for quality in found.test] == [view.distance for view in distances]
    near = [view.camera for view in close_views(distances)]
    plain = [replace(quality, distance=None) for quality in found.close]
    assert tuple(plain) == view_quality.view_qualities(scene, other, near)
    assert found.roaming == view_quality.view_qualities(scene, other, roam(scene, CAMERAS))
    assert found.worst == min(found.test, key=lambda quality: quality.psnr_db)


def test_figures_do_not_depend_on_threads(scene: Splats) -> None:
    other = scene.take(slice(0, 700))
    one, three = (view_quality.compare(scene, other, CAMERAS, threads=n) for n in (1, 3))
    assert one == three


def test_no_views_or_views_of_nothing_are_refused(scene: Splats) -> None:
    with pytest.raises(DataError) as caught:
        view_quality.compare(scene, scene, [])
    assert caught.value.code == "no-cameras"
    away = replace(CAMERAS[0], translation=np.array([0.0, 0.0, -1e6]))
    with pytest.raises(DataError) as caught:
        view_quality.compare(scene, scene, [away])
    assert caught.value.code == "cameras-see-nothing"


def test_progress_can_stop_it(scene: Splats) -> None:
    def stop(stage: str, done: int, total: int) -> None:
        if stage == "roam" and done == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        view_quality.compare(scene, scene, CAMERAS, progress=stop)
