"""LPIPS in numpy against a direct one, and its weights from files that may be hostile."""

from pathlib import Path

import numpy as np
import pytest
from lpips_weights import ALEX, VGG, Arrays, alex, vgg
from numpy.typing import NDArray
from scipy.signal import correlate

from cogsplat.codec.errors import DataError
from cogsplat.tools.evaluation.lpips import read_lpips


def direct(arrays: Arrays, is_alex: bool, a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Compute LPIPS as the paper defines it, in float64, by scipy's correlation."""
    numbers = ALEX if is_alex else VGG

    def layers(picture: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        shift, scale = np.array([-0.030, -0.088, -0.188]), np.array([0.458, 0.448, 0.450])
        x = ((2 * picture - 1 - shift) / scale).transpose(2, 0, 1)
        found, before = [], 1
        for number, slice_ in numbers.items():
            if slice_ != before:
                found.append(x)
                before = slice_
                if not is_alex or slice_ in (2, 3):
                    side = 3 if is_alex else 2
                    shape = ((x.shape[1] - side) // 2 + 1, (x.shape[2] - side) // 2 + 1)
                    x = np.array(
                        [
                            [
                                [
                                    plane[2 * i : 2 * i + side, 2 * j : 2 * j + side].max()
                                    for j in range(shape[1])
                                ]
                                for i in range(shape[0])
                            ]
                            for plane in x
                        ]
                    )
            kernel = arrays[f"net.slice{slice_}.{number}.weight"].astype(np.float64)
            bias = arrays[f"net.slice{slice_}.{number}.bias"]
            around = {11: 2, 5: 2, 3: 1}[kernel.shape[2]]
            x = np.pad(x, ((0, 0), (around, around), (around, around)))
            stride = 4 if kernel.shape[2] == 11 else 1
            x = np.array(
                [
                    correlate(x, one, mode="valid")[0, ::stride, ::stride] + offset
                    for one, offset in zip(kernel, bias, strict=True)
                ]
            )
            x = np.maximum(x, 0)
        return [*found, x]

    total = 0.0
    for layer, (p, q) in enumerate(zip(layers(a), layers(b), strict=True)):
        p = p / (np.sqrt((p**2).sum(axis=0)) + 1e-10)
        q = q / (np.sqrt((q**2).sum(axis=0)) + 1e-10)
        column = arrays[f"lin{layer}.model.1.weight"].ravel()
        total += float((column[:, None, None] * (p - q) ** 2).sum(axis=0).mean())
    return total


@pytest.mark.parametrize("name", ["alex", "vgg"])
def test_distance_is_the_papers(tmp_path: Path, name: str) -> None:
    arrays = alex() if name == "alex" else vgg()
    np.savez(tmp_path / "weights.npz", **arrays)
    lpips = read_lpips(tmp_path / "weights.npz")
    assert lpips.name == name
    rng = np.random.default_rng(3)
    a, b = rng.random((47, 61, 3)), rng.random((47, 61, 3))
    b = 0.7 * a + 0.3 * b
    first, second = lpips.features(a), lpips.features(b)
    expected = direct(arrays, name == "alex", a, b)
    assert lpips.distance(first, second) == pytest.approx(expected, rel=1e-4)
    assert lpips.distance(first, first) == 0.0
    smallest = lpips.smallest_side
    assert all(layer.size for layer in lpips.features(np.zeros((smallest, smallest, 3))))
    with pytest.raises(ValueError, match="px"):
        lpips.features(np.zeros((smallest - 1, 80, 3)))


def test_weights_of_something_else_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "weights.npz"
    np.savez(path)
    with pytest.raises(DataError) as caught:
        read_lpips(path)
    assert caught.value.code == "torch-file"
    for wrong in (
        {"a": np.zeros(3, np.float32)},
        {name: a for name, a in alex().items() if "lin" not in name},
        {name: a for name, a in vgg().items() if "28" not in name},
        {**alex(), "net.slice2.3.weight": np.zeros((7, 9, 5, 5), np.float32)},
        {**alex(), "lins.2.model.1.weight": np.zeros((1, 99, 1, 1), np.float32)},
        {**alex(), "net.slice2.3.bias": np.zeros((2, 2), np.float32)},
    ):
        np.savez(path, **wrong)
        with pytest.raises(DataError) as caught:
            read_lpips(path)
        assert caught.value.code == "lpips-weights"
