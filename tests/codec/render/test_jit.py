"""The options that every kernel is compiled with."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from cogsplat.codec.render.jit import kernel


@kernel
def _ratio(values, divisor):
    total = 0.0
    for i in range(len(values)):
        total += values[i] / divisor
    return total


def test_kernels_divide_as_numpy_does():
    assert _ratio(np.ones(3), 2.0) == 1.5
    assert _ratio(np.ones(3), 0.0) == np.inf
    assert np.isnan(_ratio(np.zeros(2), 0.0))


def test_kernels_give_the_same_in_any_thread():
    values = np.random.default_rng(0).random(1000)
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lambda divisor: _ratio(values, divisor), [3.0, 7.0, 3.0, 7.0]))
    assert found[:2] == found[2:] == [_ratio(values, 3.0), _ratio(values, 7.0)]
    np.testing.assert_allclose(found[0], values.sum() / 3.0, rtol=1e-12)
