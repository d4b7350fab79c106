from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.render.gradients import gradient
from cogsplat.codec.render.shading import row_colours

# Share of splats whose edge crosses a pixel's 1/255 within the difference.
_ON_THE_EDGE = 0.1


@pytest.mark.parametrize("info", oracle.INFOS.values(), ids=oracle.INFOS)
@pytest.mark.parametrize("seed", range(2))
def test_gradient_equals_finite_differences_of_brute_force(seed, info):
    splats = oracle.scene(seed, n=24, degree=1, info=info)
    splats.opacities[0] = np.inf
    camera = oracle.camera(angle=seed, width=24, height=18, focal=20.0)
    target = np.full((camera.height, camera.width, 3), 0.4, np.float32)

    def error(changed):
        seen = oracle.view(changed, camera)
        return np.sum((seen.image - target) ** 2)

    colours = row_colours(splats, np.arange(len(splats), dtype=np.int32), camera)
    found = gradient(splats, colours, camera, target)
    assert found.error == pytest.approx(error(splats), rel=1e-3)
    assert len(found.rows) > 10
    step = 5e-4
    off = []
    for place, row in enumerate(found.rows.tolist()):
        one = np.zeros(len(splats), np.float32)
        one[row] = step

        def slope(name, one):
            values = getattr(splats, name)
            up = error(replace(splats, **{name: (values + one).astype(np.float32)}))
            down = error(replace(splats, **{name: (values - one).astype(np.float32)}))
            return (up - down) / (2 * step)

        pairs = [(found.scales[place], slope("scales", one[:, None]))]
        if np.isfinite(splats.opacities[row]):
            pairs.append((found.opacities[place], slope("opacities", one)))
        else:
            assert found.opacities[place] == 0.0
        off += [abs(a - b) > 0.02 * abs(b) + 0.02 for a, b in pairs]
    assert np.mean(off) < _ON_THE_EDGE
