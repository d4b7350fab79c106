from dataclasses import replace

import numpy as np
import oracle
import pytest
from numba.core import sigutils

from cogsplat.codec.compiling import kernels_in
from cogsplat.codec.fit.deletion_errors import deletion_errors
from cogsplat.codec.fit.differentiable_rendering import Gradients
from cogsplat.codec.fit.train_config import TrainConfig
from cogsplat.codec.fit.trainer import Trainer
from cogsplat.codec.fit.training_views import make_training_views
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render


@pytest.fixture(scope="module")
def scenes():
    source = oracle.scene(0, n=60)
    views = make_training_views(source, [oracle.camera(angle) for angle in (0.0, 0.4, 0.8)])
    rng = np.random.default_rng(1)
    noisy = replace(
        source,
        **{
            name: (values + 0.1 * rng.normal(size=values.shape)).astype(np.float32)
            for name in Gradients.names()
            for values in [getattr(source, name)]
        },
    )
    return source, views, noisy


def mean_db(splats, views):
    return np.mean(
        [
            psnr(picture, render(splats, camera, config))
            for camera, config, picture in zip(
                views.cameras, views.configs, views.pictures, strict=True
            )
        ]
    )


@pytest.mark.parametrize("loss", ["squared", "photo"])
def test_training_reduces_the_error_of_renders(scenes, loss):
    _, views, noisy = scenes
    trainer = Trainer(noisy, views, TrainConfig(loss=loss))
    before = mean_db(noisy, views)
    seen = trainer.run(60, 1.0, 0.1)
    after = mean_db(trainer.splats, views)
    assert after > before + 2.0
    assert before < seen < after
    assert trainer.steps == 60
    # The given scene was copied.
    assert mean_db(noisy, views) == before


def test_the_result_depends_on_the_seed_but_not_on_threads(scenes):
    _, views, noisy = scenes
    found = []
    for seed, threads in ((0, 1), (0, 3), (1, 1)):
        trainer = Trainer(noisy, views, TrainConfig(seed=seed, threads=threads))
        trainer.run(5, 1.0, 1.0)
        found.append(trainer.splats)
    for name in Gradients.names():
        one, three, other = (getattr(splats, name) for splats in found)
        np.testing.assert_array_equal(one, three, err_msg=name)
        assert not np.array_equal(one, other), name


def test_a_restored_trainer_gives_the_same_result(scenes):
    _, views, noisy = scenes
    config = TrainConfig(seed=3)
    whole = Trainer(noisy, views, config)
    whole.run(6, 1.0, 1.0)
    whole.keep(np.arange(0, 60, 2))
    state = {name: np.array(values) for name, values in whole.state().items()}
    whole.run(4, 0.5, 0.5)
    resumed = Trainer(noisy, views, config)
    resumed.restore(state)
    resumed.run(4, 0.5, 0.5)
    assert len(resumed.splats) == 30
    for name in Gradients.names():
        np.testing.assert_array_equal(getattr(resumed.splats, name), getattr(whole.splats, name))


def test_gradients_are_those_at_the_decoded_values(scenes):
    source, views, noisy = scenes
    # With the source as decoded scene, renders equal the ground truth.
    trainer = Trainer(noisy, views, TrainConfig())
    assert trainer.run(1, 1.0, 1.0, decoded=source) > 90.0
    straight = Trainer(noisy, views, TrainConfig())
    straight.run(30, 1.0, 0.3, decoded=replace(noisy, sh0=noisy.sh0 + np.float32(0.2)))
    shown = replace(straight.splats, sh0=straight.splats.sh0 + np.float32(0.2))
    assert mean_db(shown, views) > mean_db(straight.splats, views)


def test_kernels_are_called_with_their_declared_types(scenes):
    _, views, noisy = scenes
    Trainer(noisy, views, TrainConfig(loss="photo")).run(1, 1.0, 1.0)
    modules = ("tile_kernels", "splat_kernels", "splat_adam", "image_losses")
    kernels = kernels_in(f"cogsplat.codec.fit.{name}" for name in modules)
    assert len(kernels) == 6
    for kernel in kernels:
        types, _ = sigutils.normalize_signature(f"({kernel.types},)")
        called = kernel.function.signatures  # type: ignore[attr-defined]
        assert called == [types], f"{kernel.name}: called with {called}, declared {types}"


def test_steps_accumulate_deletion_errors(scenes):
    _, _, noisy = scenes
    cameras = [oracle.camera(angle) for angle in (0.0, 0.4)]
    views = make_training_views(noisy, cameras, draw=False)
    trainer = Trainer(noisy, views, TrainConfig(rates={}))
    trainer.run(1, 1.0, 1.0)
    # One of the two cameras was not rendered yet.
    assert trainer.deletion_errors() is None
    trainer.run(1, 1.0, 1.0)
    expected = deletion_errors(noisy, views.sample(2, 0))
    np.testing.assert_allclose(trainer.deletion_errors(), expected, rtol=0.02, atol=1e-3)
    resumed = Trainer(noisy, views, TrainConfig())
    resumed.restore(trainer.state())
    np.testing.assert_array_equal(resumed.deletion_errors(), trainer.deletion_errors())
    trainer.keep(np.arange(30))
    assert trainer.deletion_errors() is None


def test_arrays_without_a_learning_rate_do_not_change(scenes):
    _, views, noisy = scenes
    trainer = Trainer(noisy, views, TrainConfig(rates={"sh0": 0.01}))
    trainer.run(3, 1.0, 1.0)
    for name in Gradients.names():
        same = np.array_equal(getattr(trainer.splats, name), getattr(noisy, name))
        assert same == (name != "sh0")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"loss": "l3"}, "loss 'l3'"),
        ({"rates": {"colour": 0.1}}, "learning rates of"),
        ({"seed": -1}, "seed -1"),
        ({"threads": -1}, "-1 threads"),
    ],
)
def test_invalid_settings_are_refused(settings, said):
    with pytest.raises(ValueError, match=said):
        TrainConfig(**settings)


def test_extra_gradients_are_added_to_those_of_pictures(scenes):
    source, views, _ = scenes
    # Renders of the source have no error: only the extra gradients move values.
    extra = Gradients.zeros(source)
    extra.sh0[:, 0] = 1.0
    trainer = Trainer(source, views, TrainConfig())
    trainer.run(3, 1.0, 1.0, extra_gradients=extra)
    assert (trainer.splats.sh0[:, 0] < source.sh0[:, 0]).all()
    # Picture errors outweigh small extra gradients, and not large ones.
    off = replace(source, sh0=source.sh0 + np.float32(0.1))
    moved = []
    for factor in (0.0, -1e-7, -1.0):
        trainer = Trainer(off, views, TrainConfig())
        trainer.run(20, 1.0, 1.0, extra_gradients=extra.times(factor))
        moved.append(np.median(trainer.splats.sh0[:, 0] - off.sh0[:, 0]))
    assert moved[0] == pytest.approx(moved[1], abs=0.01)
    assert moved[0] < 0.0 < moved[2]


def test_photos_outweigh_renders_of_the_source():
    source = oracle.scene(0, n=60)
    brighter = replace(source, sh0=source.sh0 + np.float32(0.6))
    camera = oracle.camera(0.0)
    photo, plain = (np.clip(render(each, camera), 0, 1) for each in (brighter, source))
    views = make_training_views(source, [camera], photos=[photo])
    assert (views.photos, len(views)) == (True, 1)
    trainer = Trainer(source, views, TrainConfig())
    trainer.run(80, 1.0, 0.3)
    drawn = np.clip(render(trainer.splats, camera), 0, 1)
    assert psnr(photo, drawn) > psnr(plain, drawn) + 6.0
    # If it is not known as a photo, it is shown in every third step alone.
    alike = Trainer(source, replace(views, photos=False), TrainConfig())
    alike.run(80, 1.0, 0.3)
    assert psnr(photo, drawn) > psnr(photo, np.clip(render(alike.splats, camera), 0, 1))
    # Views off the path still have an acceptable error.
    off = [psnr(render(source, camera, config), render(trainer.splats, camera, config))
           for camera, config in views.sample(4, 0)[1:]]  # fmt: skip
    assert min(off) > 12.0


def test_drawn_views_are_shown_twice_and_then_replaced(scenes):
    _, views, noisy = scenes
    renders = []

    def render_drawn(camera, config):
        renders.append(camera)
        return views.drawn.render(camera, config)

    class Recorded:
        camera = views.drawn.camera
        render = staticmethod(render_drawn)

    trainer = Trainer(noisy, replace(views, drawn=Recorded()), TrainConfig(threads=1))
    # In 32 steps: 11 given views, 21 drawn views on the path and 32 off it, each of them twice.
    trainer.run(32, 1.0, 1.0)
    assert 16 + 11 <= len(renders) <= 16 + 16
    trainer.run(32, 1.0, 1.0)
    assert len({camera.rotation.tobytes() for camera in renders}) == len(renders) > 2 * 26
