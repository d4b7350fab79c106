from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.prepared import prepare
from cogsplat.codec.fit.differentiable_rendering import Gradients
from cogsplat.codec.fit.rate_gradients import bits_per_step, rate_gradients
from cogsplat.codec.fit.round_trip import round_trip
from cogsplat.codec.scoring.contribution import score
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

QUALITY = 36.0


def size_of(encoded):
    parts = [chunk.payloads for chunk in encoded.chunks]
    return sum(
        len(payload)
        for part in parts
        for payload in (part.head, part.refinement or b"", part.tail or b"")
    )


def prepared_as(profile):
    splats, cameras = synth(3000, seed=4), synth_cameras(6, 64, 48)
    config = EncodeConfig(
        profile=profile, order="contribution", compensate=False, prune=None, threads=1
    )
    return prepare(splats, score(splats, cameras), config, views=cameras)


@pytest.fixture(scope="module")
def prepared():
    return prepared_as("transform")


def test_a_step_costs_the_log_ratio_of_code_frequencies():
    # 90 values with code 0 and 10 with code 1, plus the prior count of a half.
    values = np.concatenate([np.full(90, 0.3), np.full(10, 0.8)])[:, None]
    gradients = bits_per_step(values)
    np.testing.assert_allclose(gradients, np.log2(90.5 / 10.5))
    # All 100 values have code 0 now; the unused code -1 has the prior count.
    below = bits_per_step(values - 0.4)
    np.testing.assert_allclose(below[:90], -np.log2(100.5 / 0.5))


def test_gradients_of_normal_values_follow_their_density():
    rng = np.random.default_rng(0)
    values = rng.normal(0.0, 20.0, (20_000, 2))
    gradients = bits_per_step(values)
    # -log2 of a normal density has the slope x / (σ² ln 2).
    expected = values / (20.0**2 * np.log(2.0))
    inner = np.abs(values) < 40.0
    assert np.corrcoef(gradients[inner], expected[inner])[0, 1] > 0.9
    assert np.polyfit(expected[inner], gradients[inner], 1)[0] == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("name", ["opacities", "scales", "sh0", "shN"])
def test_moving_against_the_gradients_reduces_the_size(prepared, name):
    splats = prepared.source
    made = round_trip(prepared, splats, QUALITY)
    gradients = getattr(rate_gradients(made.encoded, splats, made.rows), name)
    values = getattr(splats, name)
    # The mean move is a tenth of the standard deviation.
    step = np.float32(0.1 * values.std() / np.abs(gradients).mean())
    down, up = (
        round_trip(
            prepared, replace(splats, **{name: values + sign * step * gradients}), QUALITY
        ).encoded
        for sign in (-1, 1)
    )
    assert size_of(down) < size_of(made.encoded) < size_of(up)


def test_means_and_rotations_have_no_gradient(prepared):
    splats = prepared.source
    made = round_trip(prepared, splats, QUALITY)
    gradients = rate_gradients(made.encoded, splats, made.rows)
    assert not gradients.means.any()
    assert not gradients.quats.any()


def test_opacities_and_colours_have_gradients_in_profile_vq():
    prepared = prepared_as("vq")
    # Few colours, so that all tails are indices of a codebook.
    colours = np.random.default_rng(1).normal(0, 0.3, (4, 15, 3)).astype(np.float32)
    splats = replace(prepared.source, shN=colours[np.arange(len(prepared.source)) % 4])
    made = round_trip(prepared, splats, QUALITY)
    gradients = rate_gradients(made.encoded, splats, made.rows)
    assert gradients.opacities.any()
    assert gradients.sh0.any()
    assert not gradients.shN.any()
    assert all(np.isfinite(getattr(gradients, each)).all() for each in Gradients.names())
