"""CUDA device of PyTorch and gsplat, and the errors if there is none or its memory is full."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any, Final

from cogsplat.codec.errors import LimitError, MissingExtraError

DEVICES: Final = ("cpu", "cuda")
"""Devices that draw views: ``cpu`` by compiled kernels, ``cuda`` by gsplat."""


def require_device(device: str) -> None:
    """Raise ValueError unless a device name is in `DEVICES`."""
    if device not in DEVICES:
        raise ValueError(f"device {device!r}, expected one of {DEVICES}")


def cuda_device() -> Any:
    """Return PyTorch's CUDA device.

    Raises
    ------
    MissingExtraError
        ``needs-extra``: PyTorch or gsplat is missing. ``no-cuda-device``: PyTorch finds no device,
        or gsplat has no kernels for it; gsplat compiles them on first use with CUDA's compiler.
    """
    try:
        import gsplat  # noqa: F401
        import torch
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            "needs-extra",
            f"the device cuda takes {error.name}, which is not installed; it needs the extra: "
            "pip install 'cogsplat[train]'",
        ) from error
    if not torch.cuda.is_available():
        raise MissingExtraError(
            "no-cuda-device",
            f"PyTorch {torch.__version__} finds no CUDA device, expected one, or the device cpu",
        )
    # gsplat's messages during compilation must not mix with a command's output.
    with redirect_stdout(sys.stderr):
        from gsplat.cuda import _backend
    if _backend._C is None:
        raise MissingExtraError(
            "no-cuda-device",
            "gsplat finds no CUDA toolkit (nvcc) to compile its kernels with, expected one, or the "
            "device cpu",
        )
    return torch.device("cuda")


@contextmanager
def within_device_memory() -> Iterator[None]:
    """Raise `LimitError` (``device-memory``) if the device runs out of memory within the block."""
    import torch

    try:
        yield
    except torch.OutOfMemoryError as error:
        raise LimitError(
            "device-memory", f"out of memory on the CUDA device, expected the device cpu: {error}"
        ) from error
