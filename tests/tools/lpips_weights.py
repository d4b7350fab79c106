"""Made-up weights for LPIPS, laid out as the published ones."""

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[np.float32]]

# Numbers of the convolutions inside torchvision's networks, and the slices LPIPS cuts them into.
ALEX = {0: 1, 3: 2, 6: 3, 8: 4, 10: 5}
VGG = {0: 1, 2: 1, 5: 2, 7: 2, 10: 3, 12: 3, 14: 3, 17: 4, 19: 4, 21: 4, 24: 5, 26: 5, 28: 5}


def weights(numbers: dict[int, int], kernels: list[int], width: int, seed: int) -> Arrays:
    rng = np.random.default_rng(seed)
    arrays: Arrays = {"scaling_layer.shift": np.zeros((1, 3, 1, 1), np.float32)}
    channels = 3
    for (number, slice_), side in zip(numbers.items(), kernels, strict=True):
        out = width + slice_
        name = f"net.slice{slice_}.{number}"
        scale = 1.0 / np.sqrt(channels * side * side)
        kernel = rng.normal(0, scale, (out, channels, side, side))
        arrays[f"{name}.weight"] = kernel.astype(np.float32)
        arrays[f"{name}.bias"] = rng.normal(0, 0.1, out).astype(np.float32)
        channels = out
    for layer in range(5):
        column = rng.random((1, width + layer + 1, 1, 1)).astype(np.float32)
        arrays[f"lin{layer}.model.1.weight"] = column
        arrays[f"lins.{layer}.model.1.weight"] = column
    return arrays


def alex(width: int = 5) -> Arrays:
    return weights(ALEX, [11, 5, 3, 3, 3], width, 1)


def vgg(width: int = 5) -> Arrays:
    return weights(VGG, [3] * 13, width, 2)
