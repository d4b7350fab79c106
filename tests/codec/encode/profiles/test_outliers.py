import numpy as np
import oracle

from cogsplat.codec.encode.profiles.outliers import (
    MAX_COEFFICIENT,
    MAX_LOG_SCALE,
    clip_outliers,
)


def test_strays_are_clipped_and_others_left_alone():
    splats = oracle.scene(1, n=5)
    same = clip_outliers(splats)
    assert all(getattr(same, f) is getattr(splats, f) for f in ("scales", "sh0", "shN"))
    assert clip_outliers(splats.take(slice(0, 0))).sh_degree == 3
    splats.sh0[1, 2] = -1e20
    splats.shN[3, 7, 0] = 1e20
    splats.scales[2] = [-1e20, 1, 1e20]
    out = clip_outliers(splats)
    assert out.sh0[1, 2] == -MAX_COEFFICIENT
    assert out.shN[3, 7, 0] == MAX_COEFFICIENT
    assert out.scales[2].tolist() == [-MAX_LOG_SCALE, 1, MAX_LOG_SCALE]
    assert splats.shN[3, 7, 0] == np.float32(1e20)
    assert out.means is splats.means
    untouched = np.ones((5, 15, 3), bool)
    untouched[3, 7, 0] = False
    np.testing.assert_array_equal(out.shN[untouched], splats.shN[untouched])
