from dataclasses import replace

import numpy as np
import oracle
import pytest
from numba.core import sigutils

from cogsplat.codec.compiling import kernels_in
from cogsplat.codec.fit.deletion_errors import deletion_errors
from cogsplat.codec.fit.differentiable_rendering import Gradients
from cogsplat.codec.fit.trainer import TrainConfig, Trainer
from cogsplat.codec.fit.training_views import make_training_views
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render


@pytest.fixture(scope="module")
def taught():
    source = oracle.scene(0, n=60)
    training_views = make_training_views(
        source, [oracle.camera(angle) for angle in (0.0, 0.4, 0.8)]
    )
    rng = np.random.default_rng(1)
    noisy = replace(
        source,
        **{
            name: (values + 0.1 * rng.normal(size=values.shape)).astype(np.float32)
            for name in Gradients.names()
            for values in [getattr(source, name)]
        },
    )
    return source, training_views, noisy


def mean_db(splats, training_views):
    views = zip(
        training_views.cameras, training_views.configs, training_views.pictures, strict=True
    )
    return np.mean(
        [psnr(picture, render(splats, camera, config)) for camera, config, picture in views]
    )


@pytest.mark.parametrize("loss", ["squared", "photo"])
def test_training_brings_a_scene_near_to_its_lessons(taught, loss):
    _, training_views, noisy = taught
    trainer = Trainer(noisy, training_views, TrainConfig(loss=loss, worst_views=0.5))
    before = mean_db(noisy, training_views)
    seen = trainer.run(60, 1.0, 0.1)
    after = mean_db(trainer.splats, training_views)
    assert after > before + 2.0
    assert before < seen < after
    assert trainer.steps == 60
    # The scene that was given is a copy's original.
    assert mean_db(noisy, training_views) == before


def test_the_result_depends_on_the_seed_and_not_on_the_threads(taught):
    _, training_views, noisy = taught
    found = []
    for seed, threads in ((0, 1), (0, 3), (1, 1)):
        trainer = Trainer(noisy, training_views, TrainConfig(seed=seed, threads=threads))
        trainer.run(5, 1.0, 1.0)
        found.append(trainer.splats)
    for name in Gradients.names():
        one, three, other = (getattr(splats, name) for splats in found)
        np.testing.assert_array_equal(one, three, err_msg=name)
        assert not np.array_equal(one, other), name


def test_a_restored_trainer_goes_on_as_it_would_have(taught):
    _, training_views, noisy = taught
    config = TrainConfig(seed=3, worst_views=1.0)
    whole = Trainer(noisy, training_views, config)
    whole.run(6, 1.0, 1.0)
    whole.keep(np.arange(0, 60, 2))
    state = {name: np.array(values) for name, values in whole.state().items()}
    whole.run(4, 0.5, 0.5)
    resumed = Trainer(noisy, training_views, config)
    resumed.restore(state)
    resumed.run(4, 0.5, 0.5)
    assert len(resumed.splats) == 30
    for name in Gradients.names():
        np.testing.assert_array_equal(getattr(resumed.splats, name), getattr(whole.splats, name))


def test_what_is_drawn_in_place_of_the_values_decides_how_they_move(taught):
    source, training_views, noisy = taught
    # Drawn as the source itself, nothing is wrong, whatever the values are.
    trainer = Trainer(noisy, training_views, TrainConfig())
    assert trainer.run(1, 1.0, 1.0, decoded=source) > 90.0
    straight = Trainer(noisy, training_views, TrainConfig())
    straight.run(30, 1.0, 0.3, decoded=replace(noisy, sh0=noisy.sh0 + np.float32(0.2)))
    shown = replace(straight.splats, sh0=straight.splats.sh0 + np.float32(0.2))
    assert mean_db(shown, training_views) > mean_db(straight.splats, training_views)


def test_kernels_are_called_with_the_types_that_are_declared(taught):
    _, training_views, noisy = taught
    Trainer(noisy, training_views, TrainConfig(loss="photo")).run(1, 1.0, 1.0)
    modules = ("tile_kernels", "splat_kernels", "splat_adam", "image_losses")
    kernels = kernels_in(f"cogsplat.codec.fit.{name}" for name in modules)
    assert len(kernels) == 6
    for kernel in kernels:
        types, _ = sigutils.normalize_signature(f"({kernel.types},)")
        called = kernel.function.signatures  # type: ignore[attr-defined]
        assert called == [types], f"{kernel.name}: called with {called}, declared {types}"


def test_steps_measure_what_pictures_would_lose_without_each_splat(taught):
    _, _, noisy = taught
    training_views = make_training_views(noisy, [oracle.camera()])
    assert len(training_views) == 3
    trainer = Trainer(noisy, training_views, TrainConfig(worst_views=0.0, rates={}))
    trainer.run(1, 1.0, 1.0)
    # One of the two copies has not been drawn.
    assert trainer.deletion_errors() is None
    trainer.run(1, 1.0, 1.0)
    # The camera itself was drawn in both steps.
    expected = deletion_errors(noisy, training_views) + deletion_errors(noisy, training_views, [0])
    np.testing.assert_allclose(trainer.deletion_errors(), expected, rtol=0.02, atol=1e-3)
    resumed = Trainer(noisy, training_views, TrainConfig())
    resumed.restore(trainer.state())
    np.testing.assert_array_equal(resumed.deletion_errors(), trainer.deletion_errors())
    trainer.keep(np.arange(30))
    assert trainer.deletion_errors() is None


def test_arrays_without_a_rate_stay(taught):
    _, training_views, noisy = taught
    trainer = Trainer(noisy, training_views, TrainConfig(rates={"sh0": 0.01}))
    trainer.run(3, 1.0, 1.0)
    for name in Gradients.names():
        same = np.array_equal(getattr(trainer.splats, name), getattr(noisy, name))
        assert same == (name != "sh0")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"loss": "l3"}, "loss 'l3'"),
        ({"worst_views": 2.0}, "worst_views 2.0"),
        ({"rates": {"colour": 0.1}}, "learning rates of"),
        ({"seed": -1}, "seed -1"),
        ({"threads": -1}, "-1 threads"),
    ],
)
def test_settings_that_mean_nothing_are_refused(settings, said):
    with pytest.raises(ValueError, match=said):
        TrainConfig(**settings)


def test_slopes_are_weighed_against_the_error_of_the_pictures(taught):
    source, training_views, _ = taught
    # The training_views are met: nothing but the slopes moves anything, and one way.
    slopes = Gradients.zeros(source)
    slopes.sh0[:, 0] = 1.0
    trainer = Trainer(source, training_views, TrainConfig())
    trainer.run(3, 1.0, 1.0, extra_gradients=slopes)
    assert (trainer.splats.sh0[:, 0] < source.sh0[:, 0]).all()
    # Pictures that are wrong outweigh slopes that are small beside their error, and not others.
    off = replace(source, sh0=source.sh0 + np.float32(0.1))
    moved = []
    for factor in (0.0, -1e-7, -1.0):
        trainer = Trainer(off, training_views, TrainConfig(worst_views=0.0))
        trainer.run(20, 1.0, 1.0, extra_gradients=slopes.times(factor))
        moved.append(np.median(trainer.splats.sh0[:, 0] - off.sh0[:, 0]))
    assert moved[0] == pytest.approx(moved[1], abs=0.01)
    assert moved[0] < 0.0 < moved[2]


def test_photos_outweigh_the_renders_of_the_source_that_teach_beside_them():
    source = oracle.scene(0, n=60)
    brighter = replace(source, sh0=source.sh0 + np.float32(0.6))
    camera = oracle.camera(0.0)
    photo, plain = (np.clip(render(each, camera), 0, 1) for each in (brighter, source))
    training_views = make_training_views(source, [camera], photos=[photo])
    assert (training_views.num_photos, len(training_views)) == (1, 3)
    trainer = Trainer(source, training_views, TrainConfig(worst_views=0.0))
    trainer.run(80, 1.0, 0.3)
    drawn = np.clip(render(trainer.splats, camera), 0, 1)
    assert psnr(photo, drawn) > psnr(plain, drawn) + 6.0
    # Where only renders teach, the photo is one view of three.
    alike = Trainer(source, replace(training_views, num_photos=0), TrainConfig(worst_views=0.0))
    alike.run(80, 1.0, 0.3)
    assert psnr(photo, drawn) > psnr(photo, np.clip(render(alike.splats, camera), 0, 1))
    # And what the copies show is not given up.
    off = [psnr(training_views.pictures[view], render(trainer.splats, training_views.cameras[view]))
           for view in (1, 2)]  # fmt: skip
    assert min(off) > 12.0
