"""The switch between decoding in numpy and with compiled kernels.

Both give the same bits. numba is optional and slow to load, so that kernels are used where it is
loaded already, or where there is enough to decode.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .inputs import Inputs
from .records import Attribute, Kind, StoredStream

CompiledReader = Callable[[StoredStream, NDArray[np.float32], Inputs], bool]
"""Writes the values of a stream as the reader in numpy does; False where something is wrong."""

WORTH_LOADING: Final = 3_000_000
"""Splats from which loading numba and the kernels (0.4 s) pays within one decode (measured)."""

KERNEL_MODULES: Final = tuple(
    f"{__package__}.kernels_{name}"
    for name in ("grid", "planes", "shn_transform", "sorted_means", "swing_twist")
)
"""Modules of the kernels that decoding calls, for `compiling.declared_in`."""

_readers: Mapping[tuple[Attribute, Kind], CompiledReader] = {}


def ready() -> bool:
    """Tell whether compiled kernels are in use."""
    return bool(_readers)


def reader(attribute: Attribute, kind: Kind) -> CompiledReader | None:
    """Return the compiled reader of a stream kind; None where numpy is to read it."""
    return _readers.get((attribute, kind))


def prepare(splats: int) -> None:
    """Load the kernels if numba is loaded already, or is there and the work is worth it.

    Parameters
    ----------
    splats : int
        That are to be decoded.
    """
    if ready() or (sys.modules.get("numba") is None and splats < WORTH_LOADING):
        return
    # The kernels read packed fields as machine words.
    if sys.byteorder == "little":
        use(True)


def use(wanted: bool) -> bool:
    """Use compiled kernels from here on, or numpy alone.

    Returns
    -------
    bool
        Whether kernels are now in use: not without numba.
    """
    global _readers
    _readers = _load() if wanted else {}
    return ready()


def _load() -> Mapping[tuple[Attribute, Kind], CompiledReader]:
    try:
        kernels = importlib.import_module(".kernels", __package__)
    except ImportError:
        # No numba, or one that does not fit this numpy: numpy decodes as well.
        return {}
    found: Mapping[tuple[Attribute, Kind], CompiledReader] = kernels.READERS
    return found
