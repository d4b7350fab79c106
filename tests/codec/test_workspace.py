from dataclasses import replace

import numpy as np
import oracle

from cogsplat.codec.splats import SceneInfo
from cogsplat.codec.workspace import IN_MEMORY, Workspace


def test_rows_that_are_gathered_in_blocks_are_the_same_rows():
    calls = []
    blockwise = Workspace(in_files=True, trim=lambda: calls.append(1))
    values = np.random.default_rng(1).normal(size=(3000, 4, 3)).astype(np.float32)
    rows = np.random.default_rng(2).integers(0, 3000, 1700)
    for some in (rows, rows[:1], rows[:0]):
        np.testing.assert_array_equal(blockwise.gather(values, some), values[some])
        np.testing.assert_array_equal(IN_MEMORY.gather(values, some), values[some])
    # Four blocks of 1,700 rows, one of a single row.
    assert len(calls) == 5


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
