"""Whether decoding goes through compiled kernels: numba is optional, and slow to load."""

from __future__ import annotations

import importlib
import sys
from typing import Final

WORTH_LOADING: Final = 3_000_000
"""Splats from which loading numba and the kernels (0.4 s) pays within one decode (measured)."""

_in_use = False


def ready() -> bool:
    """Tell whether the kernels of `decode_kernels` are to be used; they give numpy's bits."""
    return _in_use


def prepare(splats: int) -> None:
    """Load the kernels if numba is loaded already, or is there and the work is worth it.

    Parameters
    ----------
    splats : int
        That are to be decoded.
    """
    if _in_use or (sys.modules.get("numba") is None and splats < WORTH_LOADING):
        return
    # The kernels read packed fields as machine words.
    if sys.byteorder == "little":
        use(_load())


def use(wanted: bool) -> None:
    """Use the kernels from here on, or numpy alone."""
    global _in_use
    _in_use = wanted


def _load() -> bool:
    try:
        importlib.import_module(".kernels", __package__)
    except ImportError:
        # No numba, or one that does not fit this numpy: numpy decodes as well.
        return False
    return True
