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


def test_a_step_costs_what_the_shares_of_two_codes_differ_by():
    # 90 values at 0 and 10 at 1, each counted with a half.
    values = np.concatenate([np.full(90, 0.3), np.full(10, 0.8)])[:, None]
    slopes = bits_per_step(values)
    np.testing.assert_allclose(slopes, np.log2(90.5 / 10.5))
    # All 100 are rounded to 0 now; for -1, which none has, a half is counted.
    below = bits_per_step(values - 0.4)
    np.testing.assert_allclose(below[:90], -np.log2(100.5 / 0.5))


def test_values_of_a_bell_are_dear_away_from_its_middle():
    rng = np.random.default_rng(0)
    values = rng.normal(0.0, 20.0, (20_000, 2))
    slopes = bits_per_step(values)
    # -log2 of a normal density has the slope x / (σ² ln 2).
    expected = values / (20.0**2 * np.log(2.0))
    inner = np.abs(values) < 40.0
    assert np.corrcoef(slopes[inner], expected[inner])[0, 1] > 0.9
    assert np.polyfit(expected[inner], slopes[inner], 1)[0] == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("name", ["opacities", "scales", "sh0", "shN"])
def test_a_scene_whose_values_move_down_the_slopes_takes_fewer_bytes(prepared, name):
    splats = prepared.source
    made = round_trip(prepared, splats, QUALITY)
    slopes = getattr(rate_gradients(made.encoded, splats, made.rows), name)
    values = getattr(splats, name)
    # As far, in the mean, as a tenth of what the values are spread over.
    step = np.float32(0.1 * values.std() / np.abs(slopes).mean())
    down, up = (
        round_trip(
            prepared, replace(splats, **{name: values + sign * step * slopes}), QUALITY
        ).encoded
        for sign in (-1, 1)
    )
    assert size_of(down) < size_of(made.encoded) < size_of(up)


def test_what_is_not_coded_on_a_grid_has_no_slope(prepared):
    splats = prepared.source
    made = round_trip(prepared, splats, QUALITY)
    slopes = rate_gradients(made.encoded, splats, made.rows)
    assert not slopes.means.any()
    assert not slopes.quats.any()


def test_of_the_profile_vq_opacities_and_colours_have_slopes():
    prepared = prepared_as("vq")
    splats = prepared.source
    made = round_trip(prepared, splats, QUALITY)
    slopes = rate_gradients(made.encoded, splats, made.rows)
    assert slopes.opacities.any()
    assert slopes.sh0.any()
    assert not slopes.shN.any()
    assert all(np.isfinite(getattr(slopes, each)).all() for each in Gradients.names())
