import numpy as np
import oracle

from cogsplat.codec.order import prefix_inflation


def test_the_best_inflation_falls_to_nothing():
    assert prefix_inflation.best_inflation(2.0) == prefix_inflation.Inflation(0.0, 0.0)
    few, some = prefix_inflation.best_inflation(0.0), prefix_inflation.best_inflation(0.1)
    assert few == prefix_inflation.best_inflation(0.001)
    assert few.scales > some.scales > 0
    assert few.opacities > some.opacities > 0


def test_effective_splats_bring_most_of_the_contribution():
    assert prefix_inflation.effective_splats(np.array([1.0, 90.0, 6.0, 3.0])) == 2
    assert prefix_inflation.effective_splats(np.ones(100)) == 95
    assert prefix_inflation.effective_splats(np.zeros(7)) == 7
    assert prefix_inflation.effective_splats(np.zeros(0)) == 1


def test_inflated_splats_are_larger_and_more_opaque():
    splats = oracle.scene(1, n=4)
    thick = prefix_inflation.inflate(splats, prefix_inflation.Inflation(0.25, 1.5))
    np.testing.assert_allclose(thick.scales - splats.scales, 0.25, rtol=1e-5)
    np.testing.assert_allclose(thick.opacities - splats.opacities, 1.5, rtol=1e-5)
    assert thick.scales.dtype == thick.opacities.dtype == np.float32
