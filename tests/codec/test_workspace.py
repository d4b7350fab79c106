from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec import workspace
from cogsplat.codec.splats import SceneInfo
from cogsplat.codec.workspace import IN_MEMORY, Rearrangement, Workspace


def test_rows_that_are_gathered_in_blocks_are_the_same_rows():
    calls = []
    blockwise = Workspace(in_files=True, trim=lambda: calls.append(1))
    values = np.random.default_rng(1).normal(size=(3000, 4, 3)).astype(np.float32)
    rows = np.random.default_rng(2).integers(0, 3000, 1700)
    for some in (rows, rows[:1], rows[:0], np.arange(40, 90), np.array([5, 7, 6, 8])):
        np.testing.assert_array_equal(blockwise.gather(values, some), values[some])
        np.testing.assert_array_equal(IN_MEMORY.gather(values, some), values[some])
    # Four blocks of 1,700 rows, one of each other choice but the empty one.
    assert len(calls) == 7


@pytest.mark.parametrize("rows_per_part", [1, 7, 64, 4096])
def test_rearranged_rows_are_the_same_rows(rows_per_part, monkeypatch):
    monkeypatch.setattr(workspace, "_ROWS_PER_PART", rows_per_part)
    rng = np.random.default_rng(5)
    rows = rng.permutation(500)[:321]
    wide = rng.normal(size=(500, 13))
    arrays = [
        rng.integers(0, 99, 500).astype(np.uint16),
        rng.normal(size=(500, 8, 3)).astype(np.float32),
        wide[:, 4:7],
        wide[:, 0],
        np.zeros((500, 0, 3), np.float32),
    ]
    for some in (rows, np.sort(rows), rows[:1], rows[:0]):
        mover = Rearrangement(Workspace(in_files=True), some)
        for values in arrays:
            moved = mover.gather(values, some)
            np.testing.assert_array_equal(moved, values[some])
            assert moved.dtype == values.dtype
            assert moved.flags.c_contiguous


def test_rows_of_a_scene_keep_their_extras():
    scene = oracle.scene(2, n=900)
    scene = replace(scene, extras={"object": np.arange(900, dtype=np.uint16)})
    rows = np.random.default_rng(3).permutation(900)
    part = Workspace(in_files=True).take(scene, rows)
    expected = scene.take(rows)
    for name in ("means", "scales", "quats", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(getattr(part, name), getattr(expected, name))
    np.testing.assert_array_equal(part.extras["object"], rows)


def test_a_blank_scene_comes_from_the_callable():
    made = []

    def zeros(shape, dtype):
        made.append(shape)
        return np.zeros(shape, dtype)

    blank = Workspace(zeros).splats(5, 1, SceneInfo(kernel_px=0.1))
    assert len(blank) == 5
    assert blank.sh_degree == 1
    assert blank.info.kernel_px == 0.1
    assert made == [(5, 3), (5, 3), (5, 4), (5,), (5, 3), (5, 3, 3)]
