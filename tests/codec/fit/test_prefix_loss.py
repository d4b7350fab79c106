"""Loss of prefixes: its gradients, and its effect on training."""

from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.encode.compensation_fit import plan_layers
from cogsplat.codec.fit.differentiable_rendering import Gradients
from cogsplat.codec.fit.prefix_loss import PrefixLoss
from cogsplat.codec.fit.train_config import TrainConfig
from cogsplat.codec.fit.trainer import Trainer
from cogsplat.codec.fit.training_views import make_training_views
from cogsplat.codec.order import prefix_inflation
from cogsplat.codec.render.rasteriser import render
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras


@pytest.fixture(scope="module")
def scene():
    splats = synth(600, seed=3)
    return splats, make_training_views(splats, synth_cameras(4, 64, 48), draw=False)


def squared_error(splats, prefixes, number, views, view):
    """Return half the squared error of a prefix, summed over the pixels of a view."""
    prefix = prefix_inflation.inflate(
        splats.take(prefixes.rows[number]), prefixes.inflations[number]
    )
    drawn = render(prefix, views.cameras[view], views.configs[view])
    return 0.5 * float(np.sum(np.square(drawn - views.pictures[view], dtype=np.float64)))


def gradients_of(splats, prefixes, views, error):
    gradients = Gradients.zeros(splats)
    prefixes.add_gradients(
        splats,
        views.cameras[0],
        views.configs[0],
        views.pictures[0],
        loss="squared",
        error=error,
        rng=np.random.default_rng(0),
        gradients=gradients,
    )
    return gradients


def test_prefixes_are_those_of_compensation_layers_with_the_best_inflation():
    chunks = [np.arange(0, 40), np.arange(40, 100), np.arange(100, 300)]
    prefixes = PrefixLoss.for_layers(chunks, 300, 1.0)
    ends = plan_layers([40, 60, 200], 300)
    assert [len(rows) for rows in prefixes.rows] == [[40, 100][end - 1] for end in ends]
    assert prefixes.inflations[0] == prefix_inflation.best_inflation(40 / 300)


def test_gradients_are_finite_differences_and_0_outside_the_prefix(scene):
    splats, views = scene
    rows = np.arange(0, 600, 2)
    prefixes = PrefixLoss([rows], [prefix_inflation.best_inflation(0.5)], 1.0)
    pixels = views.pictures[0].size
    # With the prefix's own error, only the weight of the class, 1, remains.
    error = squared_error(splats, prefixes, 0, views, 0) * 2 / pixels
    gradients = gradients_of(splats, prefixes, views, error)
    assert not gradients.sh0[1::2].any()
    splat = int(rows[np.argmax(np.abs(gradients.sh0[rows]).max(axis=1))])
    moved = splats.take(np.arange(600))
    moved.sh0[splat, 0] += 0.01
    more = squared_error(moved, prefixes, 0, views, 0)
    moved.sh0[splat, 0] -= 0.02
    less = squared_error(moved, prefixes, 0, views, 0)
    assert gradients.sh0[splat, 0] == pytest.approx((more - less) / 0.02, rel=0.02)
    twice = gradients_of(splats, PrefixLoss(prefixes.rows, prefixes.inflations, 2.0), views, error)
    np.testing.assert_allclose(twice.sh0, 2 * gradients.sh0, rtol=1e-5)


def test_without_prefixes_there_are_no_gradients(scene):
    splats, views = scene
    assert not gradients_of(splats, PrefixLoss([], [], 1.0), views, 1.0).sh0.any()


def test_training_with_the_loss_improves_prefixes(scene):
    splats, views = scene
    prefixes = PrefixLoss([np.arange(200)], [prefix_inflation.best_inflation(1 / 3)], 3.0)

    off = np.random.default_rng(1).normal(0.0, 0.3, splats.sh0.shape).astype(np.float32)
    begin = replace(splats, sh0=splats.sh0 + off)

    def trained(threads, loss):
        trainer = Trainer(begin, views, TrainConfig(threads=threads))
        trainer.run(40, 0.5, 0.1, prefix_loss=loss)
        return trainer.splats

    found = trained(1, prefixes)
    numbers = range(len(views))
    before, alone, after = (
        sum(squared_error(each, prefixes, 0, views, number) for number in numbers)
        for each in (begin, trained(1, None), found)
    )
    assert after < 0.9 * min(before, alone)
    np.testing.assert_array_equal(trained(2, prefixes).sh0, found.sh0)
