"""The switch between decoding in numpy and with compiled kernels.

Both give the same bits. numba is optional and slow to load: numpy decodes until the kernels are
there, which are loaded on a thread of their own once a process decodes more than a little.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .inputs import Inputs
from .kernel_loading import KernelLoader
from .records import Attribute, Kind, StoredStream

CompiledReader = Callable[[StoredStream, NDArray[np.float32], Inputs], bool]
"""Writes the values of a stream as the reader in numpy does; False where something is wrong."""

WORTH_LOADING: Final = 3_000_000
"""Splats from which loading numba and the kernels (0.5 s) pays within one decode (measured)."""

WORTH_LOADING_AGAIN: Final = 150_000
"""Splats of several decodes from which more of them are to be expected."""

KERNEL_MODULES: Final = tuple(
    f"{__package__}.kernels_{name}"
    for name in (
        "grid",
        "planes",
        "shn_transform",
        "sorted_means",
        "swing_twist",
        "chunk_layout",
        "chunk",
    )
)
"""Modules of the kernels that decoding calls, for `compiling.kernels_in`."""

ChunkReader = Callable[..., bool]
"""Writes the values of a chunk as `whole_chunk.read` does; False where anything is unusual."""

_readers: Mapping[tuple[Attribute, Kind], CompiledReader] = {}
_chunk_reader: ChunkReader | None = None

# Whether `use` has decided; until then kernels are used once they are loaded.
_decided = False

# Splats that this process has begun to decode.
_begun = 0


def ready() -> bool:
    """Tell whether compiled kernels are in use."""
    return bool(_readers)


def reader(attribute: Attribute, kind: Kind) -> CompiledReader | None:
    """Return the compiled reader of a stream kind; None where numpy is to read it."""
    return _readers.get((attribute, kind))


def chunk_reader() -> ChunkReader | None:
    """Return the compiled reader of whole chunks; None where numpy is to read them."""
    return _chunk_reader


def prepare(splats: int) -> None:
    """Begin to load the kernels where numba is loaded already, or where the work is worth it.

    Returns at once: what is read until they are there is read in numpy.

    Parameters
    ----------
    splats : int
        That are to be decoded.
    """
    global _begun
    before, _begun = _begun, _begun + splats
    if _decided or ready():
        return
    loaded = sys.modules.get("numba") is not None
    again = before > 0 and before + splats >= WORTH_LOADING_AGAIN
    if loaded or again or splats >= WORTH_LOADING:
        LOADER.start()


def use(wanted: bool) -> bool:
    """Use compiled kernels from here on, loaded now if they are not yet, or numpy alone.

    Returns
    -------
    bool
        Whether kernels are now in use: not without numba.
    """
    global _decided
    _decided = True
    _set(_load() if wanted else None)
    return ready()


def _loaded() -> None:
    """Use the kernels that have been loaded, unless `use` has decided."""
    if not _decided:
        _set(_load())


def _set(kernels: ModuleType | None) -> None:
    global _readers, _chunk_reader
    _readers = {} if kernels is None else kernels.READERS
    _chunk_reader = None if kernels is None else kernels.read_chunk


def _load() -> ModuleType | None:
    """Return the module of the readers; None where there can be none."""
    # The kernels read packed fields as machine words.
    if sys.byteorder != "little":
        return None
    try:
        return importlib.import_module(".kernels", __package__)
    except ImportError:
        # No numba, or one that does not fit this numpy: numpy decodes as well.
        return None


LOADER: Final = KernelLoader(KERNEL_MODULES, _loaded)
"""Loads the kernels behind the work of other threads."""
