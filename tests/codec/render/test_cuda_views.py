"""Views drawn with gsplat against the CPU kernels: gsplat's references, a CUDA device if any."""

from dataclasses import replace

import numpy as np
import oracle
import pytest
from gsplat_on_cpu import on_cpu

from cogsplat.codec.errors import LimitError, MissingExtraError
from cogsplat.codec.render import cuda_views
from cogsplat.codec.render.blend_weights import add_weights
from cogsplat.codec.render.cuda_device import cuda_device
from cogsplat.codec.render.cuda_views import CudaScene
from cogsplat.codec.render.projection import project
from cogsplat.codec.render.rasteriser import (
    RenderConfig,
    cuda_view,
    render,
    render_tiles,
    render_views,
)
from cogsplat.codec.render.sensitivities import MOMENTS, add_moments
from cogsplat.codec.render.shading import footprint_colours
from cogsplat.codec.render.tiles import sampled_tiles, tile_lists

CONFIGS = {
    "plain": RenderConfig(device="cuda"),
    "background": RenderConfig(background=(0.2, 0.5, 0.9), device="cuda"),
    "near": RenderConfig(near_plane=3.5, sh_degree=1, background=(1.0, 1.0, 1.0), device="cuda"),
}


def scene():
    """Some splats hide others behind alphas that are capped, and some rows cannot be drawn."""
    splats = oracle.scene(5, n=120)
    splats.opacities[::3] = 9.0
    splats.opacities[7] = np.inf
    splats.means[11, 0] = np.nan
    splats.quats[13] = 0.0
    splats.opacities[17] = -9.0
    return splats


def has_device():
    try:
        return bool(cuda_device())
    except MissingExtraError:
        return False


@pytest.fixture(params=["references", *["device"] * has_device()])
def device(request, monkeypatch):
    """gsplat's references on the processor; then its kernels, where there is a device."""
    if request.param == "references":
        on_cpu(monkeypatch)


@pytest.mark.skipif(not has_device(), reason="no CUDA device, or gsplat is not there")
def test_a_device_draws_a_picture():
    """If this test is skipped, the other tests used gsplat's references only."""
    splats, camera = oracle.scene(2), oracle.camera()
    found = render(splats, camera, CONFIGS["plain"])
    assert_near(found, render(splats, camera), jumps=0.01)


@pytest.fixture(params=CONFIGS)
def config(request):
    return CONFIGS[request.param]


def ours(splats, camera, config):
    footprints = project(splats, camera, near_plane=config.near_plane)
    return footprints, footprint_colours(splats, camera, footprints, sh_degree=config.sh_degree)


def assert_near(found, expected, off=1e-4, jumps=0.0):
    """Check that nearly all values are close: cuts may decide some pairs differently."""
    wrong = np.abs(found - expected) > off * np.abs(expected).max(axis=0)
    assert np.isfinite(found).all()
    assert wrong.mean() <= jumps


@pytest.mark.usefixtures("device")
def test_footprints_and_colours_are_ours(config):
    splats, camera = scene(), oracle.camera(shift=1.5)
    expected, colours = ours(splats, camera, config)
    seen = cuda_view(CudaScene(splats), camera, config)
    np.testing.assert_array_equal(seen.footprints.index, expected.index)
    np.testing.assert_array_equal(seen.footprints.ellipse, expected.ellipse)
    np.testing.assert_allclose(seen.colours, colours, atol=2e-6)


@pytest.mark.usefixtures("device")
def test_pictures_are_ours(config, monkeypatch):
    splats, camera = scene(), oracle.camera()
    expected = render(splats, camera, replace(config, device="cpu"))
    found = render(splats, camera, config)
    assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
    assert_near(found, expected, jumps=0.01)
    # Bands of one row of tiles.
    monkeypatch.setattr(cuda_views, "_BAND_PIXELS", 1)
    np.testing.assert_allclose(render(splats, camera, config), found, atol=1e-6)


@pytest.mark.usefixtures("device")
def test_capped_alphas_hide_as_they_do_here():
    """gsplat's own cap of 0.999 would show 0.9 % less of what lies behind."""
    splats = oracle.scene(1, n=6)
    splats.means[:] = [[0.1 * k, 0.0, 0.2 * k] for k in range(6)]
    splats.scales[:] = 0.0
    splats.opacities[:] = 12.0
    camera = oracle.camera()
    expected = oracle.view(splats, camera)
    found = render(splats, camera, CONFIGS["plain"])
    np.testing.assert_allclose(found, expected.image, atol=2e-5)


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize(("top_k", "least_weight"), [(0, 0.0), (0, 0.05), (3, 0.0)])
def test_weights_are_ours(config, top_k, least_weight):
    splats, camera = scene(), oracle.camera()
    footprints, _ = ours(splats, camera, config)
    expected = np.zeros((len(footprints), 3))
    for lists in tile_lists(footprints, camera.width, camera.height):
        add_weights(lists, footprints, camera, top_k, 1, expected, least_weight=least_weight)
    seen = cuda_view(CudaScene(splats), camera, config)
    assert_near(seen.weights(top_k, least_weight), expected, jumps=0.02)


@pytest.mark.usefixtures("device")
def test_moments_are_ours(config):
    splats, camera = scene(), oracle.camera()
    footprints, colours = ours(splats, camera, config)
    expected = np.zeros((len(footprints), 13))
    tiles = sampled_tiles(camera.width, camera.height, 2, 1)
    for lists in tile_lists(footprints, camera.width, camera.height):
        measured = lists.of_pairs(lists.pairs_in(tiles))
        add_moments(measured, footprints, colours, camera, 1, expected)
    found = cuda_view(CudaScene(splats), camera, config).moments(tiles)
    assert_near(found[:, :MOMENTS], expected[:, :MOMENTS], off=1e-3, jumps=0.02)
    assert not found[:, MOMENTS:].any()


@pytest.mark.usefixtures("device")
def test_the_picture_over_one_background_is_drawn_once(monkeypatch):
    splats, camera = scene(), oracle.camera()
    config = CONFIGS["background"]
    seen = cuda_view(CudaScene(splats), camera, config)
    every = sampled_tiles(camera.width, camera.height, 1, 0)
    expected = seen.moments(every)
    listed = []
    pairs = seen.pairs
    monkeypatch.setattr(seen, "pairs", lambda: listed.append(None) or pairs())
    picture = seen.picture(config.background)
    seen.loss_sums(picture, config.background)
    assert len(listed) == 2
    # Moments take a picture without a background.
    assert_near(seen.moments(every), expected, off=1e-9)
    assert len(listed) == 4
    np.testing.assert_array_equal(seen.picture(config.background), picture)


@pytest.mark.usefixtures("device")
def test_several_views_and_some_tiles_of_one():
    splats, cameras = scene(), [oracle.camera(), oracle.camera(angle=0.9)]
    config = CONFIGS["plain"]
    for found, camera in zip(render_views(splats, cameras, config), cameras, strict=True):
        np.testing.assert_allclose(found, render(splats, camera, config), atol=1e-6)
    some = render_tiles(splats, cameras[0], 3, config)
    assert_near(
        some, render_tiles(splats, cameras[0], 3, replace(config, device="cpu")), jumps=0.01
    )


@pytest.mark.usefixtures("device")
def test_a_view_of_nothing():
    splats, camera = oracle.scene(1, n=3), oracle.camera()
    splats.means[:] = [0.0, 0.0, -50.0]
    seen = cuda_view(CudaScene(splats), camera, CONFIGS["background"])
    assert len(seen.footprints) == 0
    assert seen.weights(0, 0.0).shape == (0, 3)
    background = CONFIGS["background"].background
    assert (seen.picture(background) == np.array(background, np.float32)).all()


def test_a_device_without_memory_is_refused(monkeypatch):
    torch = pytest.importorskip("torch", reason="needs torch")
    import gsplat

    def full(*args):
        raise torch.OutOfMemoryError("tried to allocate 80 GiB")

    on_cpu(monkeypatch)
    monkeypatch.setattr(gsplat, "isect_tiles", full)
    with pytest.raises(LimitError, match="tried to allocate 80 GiB") as refusal:
        render(scene(), oracle.camera(), CONFIGS["plain"])
    assert refusal.value.code == "device-memory"
