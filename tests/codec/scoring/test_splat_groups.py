"""Groups of neighbouring splats, and their shares of pictures."""

from __future__ import annotations

import numpy as np
import oracle
import pytest

from cogsplat.codec.render import front_to_back, splat_blocks
from cogsplat.codec.scoring import splat_groups
from cogsplat.codec.scoring.contribution import Scorer
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.scoring.splat_groups import group_splats, measure_shares

CAMERAS = [
    oracle.camera(angle=0.3),
    oracle.camera(angle=1.4, width=40, height=50, shift=3.0),
    oracle.camera(angle=-0.9, width=33, height=17, distance=2.0),
]


def test_groups_are_small_and_compact() -> None:
    means = np.random.default_rng(4).uniform(size=(4096, 3)).astype(np.float32)
    groups = group_splats(means)
    assert len(groups) == 16
    for number in range(16):
        own = means[groups.numbers == number]
        assert len(own) == 256
        np.testing.assert_allclose(groups.centres[number], own.mean(axis=0), atol=1e-6)
        # Half of the scene along each axis, but where the curve jumps.
        assert np.median(np.abs(own - groups.centres[number])) < 0.25


def test_few_groups_hold_a_large_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(splat_groups, "_MOST_GROUPS", 3)
    groups = group_splats(np.random.default_rng(4).uniform(size=(1000, 3)).astype(np.float32))
    assert np.bincount(groups.numbers).tolist() == [333, 333, 334]


def test_no_splats_are_one_empty_group() -> None:
    groups = group_splats(np.zeros((0, 3), np.float32))
    assert (len(groups), len(groups.numbers)) == (1, 0)


@pytest.mark.parametrize("blocks", [False, True])
def test_scoring_records_what_single_pictures_measure(
    blocks: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(splat_groups, "_GROUP_SPLATS", 100)
    if blocks:
        monkeypatch.setattr(splat_blocks, "MIN_BLOCKED_SPLATS", 1)
        monkeypatch.setattr(front_to_back, "_FIRST", 512)
    splats = oracle.scene(7, n=1000)
    config = ScoreConfig(threads=1, top_k=0, least_weight=0.0)
    scorer = Scorer(splats, config, groups=group_splats(splats.means))
    scorer.add(CAMERAS[:1], jittered=True)
    scorer.add(CAMERAS[:2], covering=True)
    scorer.add(CAMERAS[1:], jittered=True)
    found, expected = scorer.group_shares, measure_shares(splats, CAMERAS)
    assert found is not None
    np.testing.assert_array_equal(found.groups.numbers, expected.groups.numbers)
    np.testing.assert_allclose(found.shares, expected.shares, atol=1e-3)
    for camera, shares in zip(CAMERAS, found.shares, strict=True):
        weights = oracle.view(splats, camera).weights.sum(axis=0)
        sums = np.bincount(found.groups.numbers, weights)
        np.testing.assert_allclose(shares, sums / (camera.width * camera.height), atol=1e-3)
    assert Scorer(splats, ScoreConfig()).group_shares is None
