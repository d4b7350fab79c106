import math
from dataclasses import replace

import numpy as np
import oracle
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from cogsplat.codec.capture import capture_of_cameras
from cogsplat.codec.errors import Cancelled
from cogsplat.codec.fit.downscaling import downscale_picture
from cogsplat.codec.geometry import sh
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import RenderConfig, render, render_tiles, render_views
from cogsplat.codec.splats import SceneInfo, Splats, empty

# Share of pixels that may land on the other side of the 1/255 or 1e-4 cut in float32.
_ON_THE_EDGE = 0.003


def _assert_same_picture(actual, expected):
    assert actual.dtype == np.float32
    assert actual.shape == expected.shape
    off = np.abs(actual - expected).max(axis=2)
    assert np.mean(off > 1e-4) <= _ON_THE_EDGE, f"{np.mean(off > 1e-4):.2%} of the pixels are off"
    assert off.max() < 0.05


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("info", oracle.INFOS.values(), ids=oracle.INFOS)
@pytest.mark.parametrize("kernel_px", [0.3, 0.1])
def test_picture_equals_brute_force(seed, info, kernel_px):
    splats = oracle.scene(seed, n=150, info=replace(info, kernel_px=kernel_px))
    camera = oracle.camera(angle=seed, shift=2.0 * seed)
    background = (0.6, 0.0, 0.4)
    expected = oracle.view(splats, camera, background=background)
    found = render(splats, camera, RenderConfig(background=background))
    _assert_same_picture(found, expected.image)


@pytest.mark.parametrize("info", oracle.INFOS.values(), ids=oracle.INFOS)
def test_reduced_picture_equals_brute_force(info):
    splats, camera = oracle.scene(3, n=150, info=info), oracle.camera()
    expected = oracle.view(splats, camera, reduction=4.0)
    found = render(splats, camera, RenderConfig(reduction=4.0))
    _assert_same_picture(found, expected.image)
    usual = render(splats, camera)
    assert np.array_equal(found, usual) == bool(info.antialiased or info.capture)


def test_picture_of_a_training_camera_is_the_usual_one_to_the_bit():
    splats, camera = oracle.scene(4, n=150), oracle.camera(angle=0.7)
    others = [oracle.camera(angle=angle, focal=71.3) for angle in (0.1, 1.9)]
    capture = capture_of_cameras([others[0], camera, others[1]])
    # Viewpoints are stored as float32: a camera at such a place.
    stored = np.array(capture[1][:3])
    assert np.allclose(stored, camera.position, atol=1e-5)
    camera = replace(
        camera, translation=-camera.rotation @ stored, fx=capture[1][3], fy=capture[1][3]
    )
    captured = replace(splats, info=SceneInfo(capture=capture))
    np.testing.assert_array_equal(render(captured, camera), render(splats, camera))
    assert not np.array_equal(render(captured, others[0]), render(captured, camera))


def test_small_and_far_pictures_are_the_full_picture_averaged():
    """The right rule is far nearer to the average than the usual one, at any size."""
    rng = np.random.default_rng(5)
    splats = oracle.scene(5, n=400, opacity=3.0)
    splats.means[:] *= 0.8
    splats.scales[:] = rng.normal(-3.4, 0.4, size=(400, 3))
    camera = oracle.camera(width=256, height=192, focal=230.0)
    captured = replace(splats, info=SceneInfo(capture=capture_of_cameras([camera])))
    full = render(splats, camera)
    for factor in (2, 4, 8):
        small, expected = camera.downscaled(factor), downscale_picture(full, factor)
        right = psnr(expected, render(captured, small))
        assert right > psnr(expected, render(splats, small)) + 6.0


@pytest.mark.parametrize("degree", range(4))
def test_picture_equals_brute_force_at_every_sh_degree(degree):
    splats, camera = oracle.scene(7, degree=degree), oracle.camera()
    _assert_same_picture(render(splats, camera), oracle.view(splats, camera).image)


def test_opaque_layers_stop_the_pixel():
    splats, camera = oracle.scene(8, n=200, opacity=8.0), oracle.camera()
    seen = oracle.view(splats, camera)
    assert (seen.weights.sum(axis=1) > 0.98).any()
    _assert_same_picture(render(splats, camera), seen.image)


def test_second_fully_opaque_splat_is_not_blended():
    # (1 - 0.99f)² is below 1e-4f in float32: 3DGS stops there.
    splats = empty(0, 2)
    splats.scales[:] = 3.0
    splats.opacities[:] = np.inf
    splats.means[:, 2] = [0.0, 1.0]
    splats.sh0[0] = -10.0  # black
    splats.sh0[1] = 10.0
    picture = render(splats, oracle.camera())
    assert picture[18, 26].tolist() == [0.0, 0.0, 0.0]


def test_views_from_inside_the_scene_equal_brute_force():
    splats, camera = oracle.scene(9, n=120), oracle.camera(distance=0.3)
    _assert_same_picture(render(splats, camera), oracle.view(splats, camera).image)


def test_config_comes_from_the_scene_when_none_is_given():
    info = SceneInfo(kernel_px=0.1, antialiased=True)
    splats, camera = oracle.scene(10, info=info), oracle.camera()
    default = render(splats, camera)
    np.testing.assert_array_equal(default, render(splats, camera, RenderConfig()))
    assert not np.array_equal(default, render(replace(splats, info=SceneInfo()), camera))


def test_empty_scene_is_background():
    picture = render(empty(3), oracle.camera(), RenderConfig(background=(0.25, 0.5, 2.0)))
    assert (picture == np.array([0.25, 0.5, 2.0], np.float32)).all()


def test_scene_behind_the_camera_is_background():
    picture = render(oracle.scene(0), oracle.camera(distance=-20.0))
    assert not picture.any()


def test_one_splat_reaches_exactly_the_pixels_of_alpha_1_255():
    splats = empty(0, 1)
    splats.scales[0] = [-1.0, -2.0, -1.5]
    splats.quats[0] = [0.9, 0.1, -0.2, 0.4]
    splats.sh0[0] = 1.0
    camera = oracle.camera()
    touched = render(splats, camera).max(axis=2) > 0
    np.testing.assert_array_equal(
        touched, (oracle.view(splats, camera).weights[:, 0] > 0).reshape(touched.shape)
    )


def test_infinite_opacities_are_capped_or_gone():
    splats = empty(0, 2)
    splats.scales[:] = 2.0
    splats.opacities[:] = [np.inf, -np.inf]
    splats.means[1, 2] = -0.5  # nearer, invisible
    picture = render(splats, oracle.camera())
    np.testing.assert_allclose(picture[18, 26], 0.5 * 0.99, rtol=1e-3)


def test_picture_is_not_clipped():
    splats = empty(0, 1)
    splats.scales[:] = 2.0
    splats.opacities[:] = 10.0
    splats.sh0[:] = 20.0
    assert render(splats, oracle.camera()).max() > 5.0


def test_lower_sh_degree_draws_as_the_cut_scene():
    splats, camera = oracle.scene(11), oracle.camera()
    for degree in range(4):
        np.testing.assert_array_equal(
            render(splats, camera, RenderConfig(sh_degree=degree)),
            render(splats.with_sh_degree(degree), camera),
        )
    flat = splats.with_sh_degree(0)
    np.testing.assert_array_equal(
        render(flat, camera, RenderConfig(sh_degree=3)), render(flat, camera)
    )


def test_pictures_do_not_depend_on_threads():
    splats = oracle.scene(12, n=400)
    cameras = [oracle.camera(angle=0.5 * k, width=40 + 9 * k, height=61) for k in range(5)]
    expected = [render(splats, camera, RenderConfig(threads=1)) for camera in cameras]
    for threads in (1, 2, 3, 8):
        config = RenderConfig(threads=threads)
        for camera, picture in zip(cameras, expected, strict=True):
            np.testing.assert_array_equal(render(splats, camera, config), picture)
        for several, picture in zip(render_views(splats, cameras, config), expected, strict=True):
            np.testing.assert_array_equal(several, picture)


def test_order_of_rows_does_not_matter_but_for_ties():
    splats, camera = oracle.scene(13), oracle.camera()
    shuffled = splats.take(np.random.default_rng(0).permutation(len(splats)))
    np.testing.assert_array_equal(render(splats, camera), render(shuffled, camera))


def test_progress_is_reported_and_may_cancel():
    splats = oracle.scene(14, n=10)
    cameras = [oracle.camera(angle=k) for k in range(6)]
    calls = []
    render_views(splats, cameras, progress=lambda *call: calls.append(call))
    assert calls == [("render", done, 6) for done in range(7)]

    def stop(stage, done, total):
        if done == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        render_views(splats, cameras, progress=stop)


def test_no_views_give_no_pictures():
    assert render_views(oracle.scene(0), []) == []


@pytest.mark.parametrize(
    "options",
    [
        {"reduction": 0.9},
        {"reduction": math.nan},
        {"near_plane": 0.0},
        {"sh_degree": 4},
        {"threads": -1},
    ],
)
def test_invalid_settings_are_refused(options):
    with pytest.raises(ValueError, match="expected"):
        RenderConfig(**options)


def test_colours_in_pictures_are_those_of_sh():
    splats, camera = oracle.scene(15, n=1), oracle.camera()
    splats.means[:] = 0.0
    splats.scales[:] = 3.0
    splats.opacities[:] = np.inf
    colour = sh.colours(splats.sh0, splats.shN, oracle.directions(splats, camera))[0]
    np.testing.assert_allclose(render(splats, camera)[18, 26] / 0.99, colour, atol=2e-3)


# Anything a float32 can hold, and often the sizes at which squares overflow.
_wild = st.floats(width=32, allow_nan=True, allow_infinity=True) | st.sampled_from(
    [0.0, -0.0, 1e-30, 1e9, -1e9, 1e18, 3e38, -3e38, 40.0, 88.0, 700.0, -700.0]
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    values=arrays.arrays(np.float32, (3, 11), elements=_wild),
    info=st.sampled_from(list(oracle.INFOS.values())),
    kernel_px=st.sampled_from([0.0, 0.3]),
)
def test_wild_splats_give_finite_pictures(values, info, kernel_px):
    splats = Splats(
        means=np.ascontiguousarray(values[:, :3]),
        scales=np.ascontiguousarray(values[:, 3:6]),
        quats=np.ascontiguousarray(values[:, 6:10]),
        opacities=np.ascontiguousarray(values[:, 10]),
        sh0=np.ones((3, 3), np.float32),
        shN=np.zeros((3, 0, 3), np.float32),
        info=replace(info, kernel_px=kernel_px),
    )
    camera = replace(oracle.camera(), rotation=np.eye(3))
    picture = render(splats, camera)
    assert np.isfinite(picture).all()
    assert picture.min() >= 0.0
    assert picture.max() <= 1.0


def test_huge_splat_covers_the_picture():
    splats = empty(0, 1)
    splats.scales[:] = 60.0
    splats.opacities[:] = np.inf
    splats.sh0[:] = 1.0
    picture = render(splats, oracle.camera())
    np.testing.assert_allclose(picture, 0.99 * (0.5 + sh.C0), rtol=1e-5)


@pytest.mark.parametrize("every", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("size", [(96, 64), (101, 75)])
def test_some_tiles_are_those_of_the_picture(every, size):
    splats = oracle.scene(3, n=150)
    camera = replace(oracle.camera(), width=size[0], height=size[1])
    whole = render(splats, camera)
    found = render_tiles(splats, camera, every)
    again = render_tiles(splats.take(slice(0, 75)), camera, every)
    assert found.shape == again.shape
    assert found.dtype == np.float32
    assert len(found) / whole[..., 0].size == pytest.approx(1 / every, abs=0.12)
    if every == 1:
        np.testing.assert_array_equal(found, whole.reshape(-1, 3))
    # Every returned pixel is a pixel of the picture, in its order.
    at = 0
    pixels = whole.reshape(-1, 3)
    for pixel in found:
        at += int(np.flatnonzero((pixels[at:] == pixel).all(axis=1))[0]) + 1
