"""Choice between the two decoders of a chunk: numpy, or the compiled chunk reader.

Both give the same bits. numba is optional and takes 0.5 s to load. A background thread therefore
loads the kernels once a process has decoded enough splats; until then numpy decodes.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from typing import Final

from .chunk_arrays import ChunkArrays, CodebookRows
from .kernel_loader import KernelLoader

ChunkReader = Callable[
    [memoryview, memoryview | None, memoryview | None, CodebookRows, ChunkArrays], bool
]
"""Compiled chunk reader, `kernels_chunk.read`; it returns False if numpy must decode the chunk."""

MIN_SPLATS: Final = 3_000_000
"""Minimum number of splats in one decode for which loading the kernels (0.5 s) saves time."""

MIN_SPLATS_REPEATED: Final = 150_000
"""Minimum number of splats in several decodes of one process for which the kernels are loaded.

It is lower than `MIN_SPLATS` because a process that decodes repeatedly is likely to decode more."""

KERNEL_MODULES: Final = tuple(f"{__package__}.kernels_{name}" for name in ("chunk_layout", "chunk"))
"""Modules of all kernels that decoding calls, for `compiling.kernels_in`."""

_chunk_reader: ChunkReader | None = None

# Whether `use_compiled` was called; until then kernels are used as soon as they are loaded.
_decided = False

# Splats of all decodes that this process has begun.
_splats_begun = 0


def is_compiled() -> bool:
    """Tell whether the compiled chunk reader is in use."""
    return _chunk_reader is not None


def chunk_reader() -> ChunkReader | None:
    """Return the compiled chunk reader; None while numpy decodes."""
    return _chunk_reader


def load_if_worthwhile(splats: int) -> None:
    """Start loading the kernels if this decode, or all decodes so far, are large enough.

    Loading also starts if another module has imported numba. Returns at once: numpy decodes until
    loading ends.

    Parameters
    ----------
    splats : int
        Splats of the decode that begins; added to the process's total.
    """
    global _splats_begun
    before, _splats_begun = _splats_begun, _splats_begun + splats
    if _decided or is_compiled():
        return
    loaded = sys.modules.get("numba") is not None
    repeated = before > 0 and before + splats >= MIN_SPLATS_REPEATED
    if loaded or repeated or splats >= MIN_SPLATS:
        LOADER.start()


def use_compiled(wanted: bool) -> bool:
    """Select the compiled chunk reader or numpy for all later decodes of the process.

    Parameters
    ----------
    wanted : bool
        Whether to use the compiled reader; it is loaded now if necessary.

    Returns
    -------
    bool
        Whether the compiled reader is now in use; False if numba is missing.
    """
    global _decided, _chunk_reader
    _decided = True
    _chunk_reader = _load() if wanted else None
    return is_compiled()


def _switch_to_compiled() -> None:
    """Switch to the compiled chunk reader; `LOADER` calls this once the kernels are loaded.

    An earlier call of `use_compiled` takes precedence.
    """
    global _chunk_reader
    if not _decided:
        _chunk_reader = _load()


def _load() -> ChunkReader | None:
    """Import the compiled chunk reader; None without numba or on a big-endian machine."""
    # The kernels read packed fields as machine words.
    if sys.byteorder != "little":
        return None
    try:
        reader: ChunkReader = importlib.import_module(".kernels_chunk", __package__).read
    except ImportError:
        # No numba, or one that does not fit this numpy.
        return None
    return reader


LOADER: Final = KernelLoader(KERNEL_MODULES, _switch_to_compiled)
"""Loads the kernels in the background."""
