"""LPIPS, the perceptual distance of Zhang et al. 2018, in numpy, with user-provided weights."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import DataError
from cogsplat.formats.storage.torch_file import read_state_dict

F32 = NDArray[np.float32]

# From the paper's code (BSD licence): inputs from -1 to 1, normalised per channel as for ImageNet.
_SHIFT: Final = np.array([-0.030, -0.088, -0.188], np.float32)
_SCALE: Final = np.array([0.458, 0.448, 0.450], np.float32)
_TINY: Final = np.float32(1e-10)


@dataclass(frozen=True)
class _Net:
    """Architecture of a convolutional network up to its last feature layer.

    Parameters
    ----------
    name : str
        ``alex`` or ``vgg``.
    blocks : tuple of int
        Number of convolutions before each of the five feature layers.
    kernels : tuple of int
        Side of each convolution's kernel, px.
    stride : int
        Stride of the first convolution.
    pool : int
        Side of the pooling window, whose stride is 2.
    pooled : tuple of bool
        Whether each block begins with pooling.
    smallest_side : int
        Smallest image side for which the last layer is not empty, px.
    """

    name: str
    blocks: tuple[int, ...]
    kernels: tuple[int, ...]
    stride: int
    pool: int
    pooled: tuple[bool, ...]
    smallest_side: int


# Sources: Krizhevsky 2014 ("one weird trick"), Simonyan and Zisserman 2015 (configuration D).
_ALEX: Final = _Net(
    "alex", (1, 1, 1, 1, 1), (11, 5, 3, 3, 3), 4, 3, (False, True, True, False, False), 35
)
_VGG: Final = _Net("vgg", (2, 2, 3, 3, 3), (3,) * 13, 1, 2, (False, True, True, True, True), 16)

_CONVOLUTION: Final = re.compile(r"(?:net\.slice\d+|features)\.(\d+)\.(weight|bias)")
_LINEAR: Final = re.compile(r"(?:lin|lins\.)(\d)\.model\.1\.weight")


@dataclass(frozen=True, eq=False)
class Lpips:
    """A feature network with the learnt channel weights of LPIPS.

    Parameters
    ----------
    name : str
        ``alex`` or ``vgg``.
    smallest_side : int
        Smallest image side that the network accepts, px.
    """

    name: str
    smallest_side: int
    _net: _Net
    _kernels: tuple[F32, ...]
    _biases: tuple[F32, ...]
    _linear: tuple[F32, ...]

    def features(self, picture: NDArray[np.floating]) -> list[F32]:
        """Return the feature layers of an image, each normalised over its channels.

        Parameters
        ----------
        picture : (H, W, 3) float
            Display colours, clipped to [0, 1]; each side at least `smallest_side` px.

        Returns
        -------
        list of (C, h, w) float32
            Five feature layers.
        """
        if min(picture.shape[:2]) < self.smallest_side:
            raise ValueError(
                f"image of shape {picture.shape}, expected sides of at least "
                f"{self.smallest_side} px"
            )
        values = np.clip(np.asarray(picture, np.float32), 0.0, 1.0) * np.float32(2) - np.float32(1)
        layer: F32 = np.ascontiguousarray(((values - _SHIFT) / _SCALE).transpose(2, 0, 1))
        found: list[F32] = []
        number = 0
        for block, pooled in zip(self._net.blocks, self._net.pooled, strict=True):
            if pooled:
                layer = _pool(layer, self._net.pool)
            for _ in range(block):
                stride = self._net.stride if number == 0 else 1
                # Kernels of 3 and 5 keep the size; AlexNet's first convolution pads by 2 px.
                padding = 2 if number == 0 and stride > 1 else self._kernels[number].shape[2] // 2
                layer = _convolve(
                    layer, self._kernels[number], self._biases[number], stride, padding
                )
                np.maximum(layer, np.float32(0), out=layer)
                number += 1
            length = np.sqrt(np.square(layer).sum(axis=0, keepdims=True, dtype=np.float32))
            found.append(layer / (length + _TINY))
        return found

    def distance(self, first: list[F32], second: list[F32]) -> float:
        """Return the LPIPS distance of two images from their `features`; 0 if identical."""
        total = 0.0
        for a, b, weights in zip(first, second, self._linear, strict=True):
            squares = np.square(a - b)
            total += float(np.tensordot(weights, squares, axes=1).mean(dtype=np.float64))
        return total


def read_lpips(path: Path) -> Lpips:
    """Read the weights of LPIPS and its network: the state dict of the paper's code.

    Parameters
    ----------
    path : Path
        File of ``torch.save(lpips.LPIPS(net="alex").state_dict(), path)``, or of ``"vgg"``; or an
        ``.npz`` with the same arrays.

    Raises
    ------
    StorageError
        The file cannot be read.
    DataError
        ``torch-file``: another format, or no arrays; ``lpips-weights``: arrays are missing or of a
        wrong shape.
    """
    arrays = read_state_dict(path)
    layers: dict[int, dict[str, F32]] = {}
    linear: dict[int, F32] = {}
    for name, array in arrays.items():
        if match := _CONVOLUTION.fullmatch(name):
            layers.setdefault(int(match[1]), {})[match[2]] = array
        elif match := _LINEAR.fullmatch(name):
            linear[int(match[1])] = array
    pairs = [layers[number] for number in sorted(layers)]
    first = pairs[0].get("weight") if pairs else None
    net = _ALEX if first is not None and first.shape[-1] == _ALEX.kernels[0] else _VGG
    _check_shapes(path, net, pairs, linear, arrays)
    return Lpips(
        name=net.name,
        smallest_side=net.smallest_side,
        _net=net,
        _kernels=tuple(pair["weight"] for pair in pairs),
        _biases=tuple(pair["bias"] for pair in pairs),
        _linear=tuple(linear[layer].reshape(-1) for layer in range(len(net.blocks))),
    )


def _check_shapes(
    path: Path,
    net: _Net,
    pairs: list[dict[str, F32]],
    linear: Mapping[int, F32],
    arrays: Mapping[str, F32],
) -> None:
    """Raise ``lpips-weights`` unless all layers exist and have the network's shapes."""
    channels, ends = 3, np.cumsum(net.blocks).tolist()
    problem = ""
    if len(pairs) != len(net.kernels) or any(len(pair) != 2 for pair in pairs):
        problem = f"{len(pairs)} convolutions"
    elif sorted(linear) != list(range(len(net.blocks))):
        problem = f"linear layers {sorted(linear)}"
    else:
        for number, (pair, side) in enumerate(zip(pairs, net.kernels, strict=True)):
            out = len(pair["bias"]) if pair["bias"].ndim == 1 else 0
            if out == 0 or pair["weight"].shape != (out, channels, side, side):
                problem = f"convolution {number} of shape {pair['weight'].shape}"
                break
            channels = out
            if number + 1 in ends:
                layer = ends.index(number + 1)
                if linear[layer].shape != (1, out, 1, 1):
                    problem = f"linear layer {layer} of shape {linear[layer].shape}"
                    break
    if problem:
        raise DataError(
            "lpips-weights",
            f"{path}: {problem} in {len(arrays)} arrays, expected the whole state dict of "
            "LPIPS with AlexNet or VGG-16",
        )


def _convolve(layer: F32, kernel: F32, bias: F32, stride: int, padding: int) -> F32:
    """Return the convolution of a padded layer, (O, h, w): one matrix product per kernel pixel."""
    side = kernel.shape[2]
    padded = np.pad(layer, ((0, 0), (padding, padding), (padding, padding)))
    height = (padded.shape[1] - side) // stride + 1
    width = (padded.shape[2] - side) // stride + 1
    out = np.empty((len(kernel), height * width), np.float32)
    out[:] = bias[:, None]
    for y in range(side):
        for x in range(side):
            patch = padded[
                :,
                y : y + stride * (height - 1) + 1 : stride,
                x : x + stride * (width - 1) + 1 : stride,
            ]
            out += kernel[:, :, y, x] @ patch.reshape(len(layer), -1)
    return out.reshape(len(kernel), height, width)


def _pool(layer: F32, side: int) -> F32:
    """Return a layer max-pooled with a stride of 2, without padding."""
    height = (layer.shape[1] - side) // 2 + 1
    width = (layer.shape[2] - side) // 2 + 1
    out = np.full((len(layer), height, width), -np.inf, np.float32)
    for y in range(side):
        for x in range(side):
            np.maximum(
                out, layer[:, y : y + 2 * height - 1 : 2, x : x + 2 * width - 1 : 2], out=out
            )
    return out
