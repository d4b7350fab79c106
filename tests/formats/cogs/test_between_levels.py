"""Scenes at a level, and between two."""

import math

import numpy as np
import pytest
from levelled import levelled_file, unit

from cogsplat.formats.cogs.between_levels import decode_between, interpolate_logits
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.storage.source import BytesSource


@pytest.fixture(scope="module")
def file():
    with open_cogs(BytesSource(levelled_file())) as opened:
        yield opened


def test_whole_levels_are_those_that_decode_gives(file):
    for level in range(3):
        found, expected = decode_between(file, level), file.decode(level=level)
        for name in ("means", "opacities", "shN"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("part", [0.25, 0.5, 0.9])
def test_opacities_lie_on_the_line_between_two_levels(file, part):
    """Splats are told apart by their means, which no level changes."""
    levels = [file.decode(level=level) for level in range(3)]
    for below in (0, 1):
        between = decode_between(file, below + part)
        opacity = {}
        for share, level in ((1 - part, levels[below]), (part, levels[below + 1])):
            for mean, logit in zip(level.means.tolist(), level.opacities, strict=True):
                opacity[tuple(mean)] = opacity.get(tuple(mean), 0.0) + share * unit(logit)
        assert len(between) == len(opacity)
        for mean, logit in zip(between.means.tolist(), between.opacities, strict=True):
            assert unit(logit) == pytest.approx(opacity[tuple(mean)], abs=2**-12)


def test_levels_that_are_not_there_are_refused(file):
    for level in (-0.5, 2.5, 3, math.nan):
        with pytest.raises(ValueError, match="level"):
            decode_between(file, level)


def test_opacities_of_nothing_and_of_everything_keep_their_ends():
    lower = np.array([-np.inf, np.inf, -np.inf, np.inf], np.float32)
    upper = np.array([-np.inf, np.inf, np.inf, -np.inf], np.float32)
    found = interpolate_logits(lower, upper, 0.5)
    np.testing.assert_array_equal(found, np.array([-np.inf, np.inf, 0, 0], np.float32))
