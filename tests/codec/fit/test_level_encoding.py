"""Encoding of scenes with levels."""

import numpy as np
import pytest

from cogsplat.codec.fit.level_encoding import encode_levels
from cogsplat.codec.fit.level_training import LevelledSplats
from cogsplat.codec.fit.train_config import LevelsConfig
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.segments.opacities import decode_opacities
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

COUNT = 900
CAMERAS = synth_cameras(3, 96, 72)


@pytest.fixture(scope="module")
def levels():
    """Three levels of 300 splats added each; a quarter of the first two is left out later."""
    splats = synth(COUNT)
    first = np.arange(COUNT) // 300
    last = np.full(COUNT, 2)
    last[:40] = 0
    last[40:75] = last[300:375] = 1
    opacities = np.tile(splats.opacities, (3, 1))
    opacities[1:, :300] -= np.float32(0.7)
    opacities[2, :600] += np.linspace(-1, 1, 600, dtype=np.float32)
    return LevelledSplats(splats, (4, 2, 1), first, last, opacities)


@pytest.fixture(scope="module")
def encoded(levels):
    return encode_levels(levels, CAMERAS, LevelsConfig(quality_db=45.0, threads=1))


def test_chunks_are_ordered_by_level_and_end_with_a_level(levels, encoded):
    ends = [level.chunks for level in encoded.levels]
    assert [level.scale for level in encoded.levels] == [4.0, 2.0, 1.0]
    assert ends[-1] == len(encoded.chunks)
    assert ends == sorted(set(ends))
    counts = np.array([chunk.splats for chunk in encoded.chunks])
    for level, end in enumerate(ends):
        drawn = [c.until == 0 or c.until > end for c in encoded.chunks[:end]]
        assert counts[:end][drawn].sum() == len(levels.rows(level))
        assert {c.until for c in encoded.chunks} <= {0, *ends[1:]}
    assert all(c.attributes is None and c.object == 0 for c in encoded.chunks)


def test_every_level_decodes_to_nearly_the_given_splats(levels, encoded):
    """Chunks are decoded as a reader does, with the opacities of the level."""
    starts = np.cumsum([0, *(chunk.splats for chunk in encoded.chunks)])
    first_level = np.searchsorted(
        [level.chunks for level in encoded.levels], np.arange(len(encoded.chunks)), "right"
    )
    for level, entry in enumerate(encoded.levels):
        rows, logits = [], []
        for number, chunk in enumerate(encoded.chunks[: entry.chunks]):
            if chunk.until and chunk.until <= entry.chunks:
                continue
            own = slice(starts[number], starts[number + 1])
            values = encoded.decoded.opacities[own].copy()
            later = chunk.opacities[: level - first_level[number]]
            if later:
                decode_opacities(memoryview(later[-1]), values, "chunk")
            rows.append(np.arange(own.start, own.stop))
            logits.append(values)
        scene = encoded.decoded.take(np.concatenate(rows))
        scene.opacities[:] = np.concatenate(logits)
        for camera in CAMERAS:
            assert psnr(render(scene, camera), render(levels.scene(level), camera)) > 34


def test_bytes_do_not_depend_on_threads(levels, encoded):
    other = encode_levels(levels, CAMERAS, LevelsConfig(quality_db=45.0, threads=2))
    for found, expected in zip(other.chunks, encoded.chunks, strict=True):
        assert found.payloads == expected.payloads
        assert (found.opacities, found.until) == (expected.opacities, expected.until)


def test_levels_without_chunks_are_left_out(levels):
    first = np.where(levels.first_level == 1, 0, levels.first_level)
    merged = LevelledSplats(
        levels.splats, levels.scales, first, levels.last_level, levels.opacities
    )
    made = encode_levels(merged, CAMERAS, LevelsConfig(threads=1))
    assert [level.scale for level in made.levels] == [4.0, 1.0]
