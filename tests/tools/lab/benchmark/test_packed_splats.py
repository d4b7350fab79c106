"""Packed splats of browsers come back as arrays, by the layout that tools/web describes."""

import numpy as np
import pytest

from cogsplat.codec.geometry.rotations import matrices
from cogsplat.codec.splats import SceneInfo
from cogsplat.tools.lab.benchmark.packed_splats import unpack, words_of_band

INFO = SceneInfo(axes="RUB")


def half(value: float) -> int:
    return int(np.float16(value).view(np.uint16))


def one_splat() -> np.ndarray:
    """Pack, bit by bit, a splat turned by 90° about +y."""
    colour = 51 | 102 << 8 | 255 << 16 | 204 << 24
    # The octahedron's +y: x = 0 in the middle, 127.5, which no code is; 128 is the nearest.
    third = half(-0.5) | 128 << 16 | 255 << 24
    scales = 1 | 128 << 8 | 0 << 16 | 127 << 24
    return np.array([[colour, half(1.5) | half(-2.25) << 16, third, scales]], np.uint32)


def test_one_splat() -> None:
    splats = unpack(one_splat(), [], (-0.5, 1.5), [], INFO)
    assert splats.info == INFO
    assert splats.means.tolist() == [[1.5, -2.25, -0.5]]
    assert splats.scales[0] == pytest.approx([-12.0, -12 + 127 * 21 / 254, -30.0], abs=1e-5)
    assert splats.opacities[0] == pytest.approx(np.log(0.8 / 0.2), abs=1e-5)
    colours = 0.28209479 * splats.sh0[0] + 0.5
    assert colours == pytest.approx([-0.1, 0.3, 1.5], abs=1e-5)
    # About +y, a quarter turn takes z to x, within a step of the code for the axis.
    turned = matrices(splats.quats)[0] @ np.array([0.0, 0.0, 1.0])
    assert turned == pytest.approx([1.0, 0.0, 0.0], abs=0.01)


def test_what_is_transparent_is_not_there() -> None:
    words = np.concatenate([np.zeros((3, 4), np.uint32), one_splat()])
    assert len(unpack(words, [], (0, 1), [], INFO)) == 1


def test_coefficients_of_every_band_and_sign() -> None:
    rng = np.random.default_rng(5)
    bands, expected = [], []
    for degree, (bits, values) in enumerate([(7, 9), (8, 15), (6, 21)], 1):
        codes = rng.integers(-(1 << (bits - 1)), 1 << (bits - 1), values)
        whole = sum((int(code) & (1 << bits) - 1) << (bits * i) for i, code in enumerate(codes))
        words = words_of_band(degree)
        row = [whole >> (32 * word) & 0xFFFFFFFF for word in range(words)]
        bands.append(np.array([row], np.uint32))
        expected.append(codes * degree / ((1 << (bits - 1)) - 1))
    splats = unpack(one_splat(), bands, (0, 1), [1.0, 2.0, 3.0], INFO)
    assert splats.shN.shape == (1, 15, 3)
    assert splats.shN.ravel() == pytest.approx(np.concatenate(expected), abs=1e-6)
