"""PrefixLoss that are taught while a scene is trained: what they ask for, and what comes of it."""

from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.encode.compensation_fit import plan_layers
from cogsplat.codec.fit.differentiable_rendering import Gradients
from cogsplat.codec.fit.prefix_loss import PrefixLoss
from cogsplat.codec.fit.trainer import TrainConfig, Trainer
from cogsplat.codec.fit.training_views import make_training_views
from cogsplat.codec.order import prefix_inflation
from cogsplat.codec.render.rasteriser import render
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras


@pytest.fixture(scope="module")
def scene():
    splats = synth(600, seed=3)
    return splats, make_training_views(splats, synth_cameras(4, 64, 48), copies=False)


def squared_error(splats, prefixes, number, training_views, view):
    """Half the squared error of a prefix, summed over the pixels of a view."""
    prefix = prefix_inflation.inflate(
        splats.take(prefixes.rows[number]), prefixes.inflations[number]
    )
    drawn = render(prefix, training_views.cameras[view], training_views.configs[view])
    return 0.5 * float(np.sum(np.square(drawn - training_views.pictures[view], dtype=np.float64)))


def taught(splats, prefixes, training_views, error):
    gradients = Gradients.zeros(splats)
    prefixes.add_gradients(
        splats,
        training_views.cameras[0],
        training_views.configs[0],
        training_views.pictures[0],
        loss="squared",
        error=error,
        rng=np.random.default_rng(0),
        gradients=gradients,
    )
    return gradients


def test_prefixes_are_those_of_the_layers_with_their_usual_inflation():
    chunks = [np.arange(0, 40), np.arange(40, 100), np.arange(100, 300)]
    prefixes = PrefixLoss.for_layers(chunks, 300, 1.0)
    ends = plan_layers([40, 60, 200], 300)
    assert [len(rows) for rows in prefixes.rows] == [[40, 100][end - 1] for end in ends]
    assert prefixes.inflations[0] == prefix_inflation.typical_inflation(40 / 300)


def test_gradients_are_those_of_the_prefix_and_touch_no_other_splat(scene):
    splats, training_views = scene
    rows = np.arange(0, 600, 2)
    prefixes = PrefixLoss([rows], [prefix_inflation.typical_inflation(0.5)], 1.0)
    pixels = training_views.pictures[0].size
    # As large as the prefix's own error: the weight that is left is that of the class, 1.
    error = squared_error(splats, prefixes, 0, training_views, 0) * 2 / pixels
    gradients = taught(splats, prefixes, training_views, error)
    assert not gradients.sh0[1::2].any()
    splat = int(rows[np.argmax(np.abs(gradients.sh0[rows]).max(axis=1))])
    moved = splats.take(np.arange(600))
    moved.sh0[splat, 0] += 0.01
    more = squared_error(moved, prefixes, 0, training_views, 0)
    moved.sh0[splat, 0] -= 0.02
    less = squared_error(moved, prefixes, 0, training_views, 0)
    assert gradients.sh0[splat, 0] == pytest.approx((more - less) / 0.02, rel=0.02)
    twice = taught(
        splats, PrefixLoss(prefixes.rows, prefixes.inflations, 2.0), training_views, error
    )
    np.testing.assert_allclose(twice.sh0, 2 * gradients.sh0, rtol=1e-5)


def test_no_prefix_asks_for_nothing(scene):
    splats, training_views = scene
    assert not taught(splats, PrefixLoss([], [], 1.0), training_views, 1.0).sh0.any()


def test_prefixes_that_are_taught_show_more(scene):
    splats, training_views = scene
    prefixes = PrefixLoss([np.arange(200)], [prefix_inflation.typical_inflation(1 / 3)], 3.0)

    off = np.random.default_rng(1).normal(0.0, 0.3, splats.sh0.shape).astype(np.float32)
    begin = replace(splats, sh0=splats.sh0 + off)

    def trained(threads, taught):
        trainer = Trainer(begin, training_views, TrainConfig(threads=threads))
        trainer.run(40, 0.5, 0.1, prefix_loss=taught)
        return trainer.splats

    found = trained(1, prefixes)
    views = range(len(training_views))
    before, alone, after = (
        sum(squared_error(each, prefixes, 0, training_views, view) for view in views)
        for each in (begin, trained(1, None), found)
    )
    assert after < 0.9 * min(before, alone)
    np.testing.assert_array_equal(trained(2, prefixes).sh0, found.sh0)
