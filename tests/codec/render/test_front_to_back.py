from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.render import front_to_back
from cogsplat.codec.render.front_to_back import FrontToBack
from cogsplat.codec.render.splat_blocks import BLOCK_SPLATS, splat_blocks
from cogsplat.codec.scoring.contribution import Scorer
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.splats import Splats

CAMERAS = [
    oracle.camera(angle=0.3),
    oracle.camera(angle=1.4, width=70, height=50, shift=3.0),
    oracle.camera(angle=-0.9, width=33, height=17, distance=0.5),
]


@pytest.fixture(autouse=True)
def thin_slabs(monkeypatch):
    monkeypatch.setattr(front_to_back, "_FIRST", BLOCK_SPLATS)
    monkeypatch.setattr(front_to_back, "_LARGEST", 2 * BLOCK_SPLATS)


def walls(n=9000, **changes) -> Splats:
    """Walls one behind the other in equal depths, a few huge splats, and some far away."""
    rng = np.random.default_rng(5)
    splats = oracle.scene(3, n=n, **changes)
    means = rng.uniform(-2.0, 2.0, (n, 3)).astype(np.float32)
    means[:, 2] = np.round(means[:, 2] * 2.0) / 2.0
    means[:9] *= 40.0
    scales = rng.uniform(-4.0, -2.5, (n, 3)).astype(np.float32)
    scales[9:12] = 1.0
    opacities = rng.uniform(-7.0, 9.0, n).astype(np.float32)
    return replace(splats, means=means, scales=scales, opacities=opacities)


def scores(splats, config, blocks):
    scorer = Scorer(splats, config)
    scorer._blocks = blocks
    scorer._hidden = np.zeros(0 if blocks is None else len(blocks), np.int32)
    scorer.add(CAMERAS, jittered=True)
    return scorer.scores()


def assert_equal(found, expected):
    # The spread is a sum over splats, in the order of the slabs.
    largest = np.abs(expected.basis_spread).max()
    np.testing.assert_allclose(found.basis_spread, expected.basis_spread, atol=1e-10 * largest)
    for name in expected.__dataclass_fields__:
        if name not in ("sensitivities", "basis_spread"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)
    for name in expected.sensitivities.__dataclass_fields__:
        values = getattr(expected.sensitivities, name)
        np.testing.assert_array_equal(getattr(found.sensitivities, name), values, name)


@pytest.mark.parametrize("top_k", [0, 4])
@pytest.mark.parametrize("info", oracle.INFOS.values(), ids=oracle.INFOS)
def test_scores_are_the_same_with_blocks(info, top_k):
    splats = walls(info=info)
    config = ScoreConfig(top_k=top_k, sensitivity_every=2, threads=1)
    assert_equal(scores(splats, config, splat_blocks(splats)), scores(splats, config, None))


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_splats_that_cannot_be_drawn_hide_no_others():
    splats = walls()
    splats.means[50::1000, 0] = np.nan
    splats.means[51::1000, 1] = np.inf
    splats.scales[52::1000, 2] = np.nan
    splats.quats[53::1000] = 0.0
    splats.opacities[54::1000] = np.nan
    config = ScoreConfig(sensitivity_every=2, top_k=0, jitter=False, threads=1)
    assert_equal(scores(splats, config, splat_blocks(splats)), scores(splats, config, None))


def test_splats_behind_walls_are_not_projected():
    splats = walls()
    splats.opacities[:] = 9.0
    splats.scales[:] = -2.0
    walk = FrontToBack(splats, splat_blocks(splats), CAMERAS[1], near_plane=0.2, hides=True)
    for number, footprints in enumerate(walk.slabs()):
        assert len(footprints)
        if number == 2:
            walk.transmittances[:] = 0.0
    assert len(walk.hidden) > 5


def test_a_block_is_a_part_of_space():
    splats = walls()
    blocks = splat_blocks(splats)
    assert len(blocks) == -(-len(splats) // BLOCK_SPLATS)
    np.testing.assert_array_equal(np.sort(blocks.rows), np.arange(len(splats)))
    for block in (0, len(blocks) - 1):
        rows = blocks.rows_of(np.array([block]))
        np.testing.assert_array_equal(blocks.low[block], splats.means[rows].min(axis=0))
        np.testing.assert_array_equal(blocks.high[block], splats.means[rows].max(axis=0))
        assert blocks.widest[block] == splats.scales[rows].max()
    assert np.median(blocks.high - blocks.low, axis=0).max() < 2.0
