"""Estimate the memory of an encode, in memory and with mapped files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from cogsplat.codec.errors import LimitError
from cogsplat.codec.order.orders import split_name
from cogsplat.codec.scoring.contribution import MAX_VIEW_PARALLEL_SPLATS
from cogsplat.codec.splats import sh_coefficients
from cogsplat.codec.threads import thread_count

from .config import EncodeConfig

# Bytes of the program with its libraries, of compilation in a first run and of chunks in progress;
# measured with scenes of 5,000 splats.
_BASE: Final = 400_000_000

# Bytes of a splat without SH above DC, float32.
_ROW: Final = 56

# Bytes of a splat's scores, sensitivities and mean SH bases among them.
_SCORES: Final = 328

# Bytes per splat of a view in progress: footprint, colour, sums, sensitivities. A view takes more
# if each core has its own; then two finished views may wait with their sums and sensitivities.
_VIEW: Final = 260
_VIEW_OF_EACH_CORE: Final = 320
_WAITING: Final = 2 * 132

# Bytes per splat that are never mapped: row numbers, energies, masks and payloads.
_KEPT: Final = 60

# Bytes per splat of the order by marginal gain and the compensation fit: with a view on each
# core, and with mapped files, where one view is rendered at a time.
_GAIN: Final = 400
_GAIN_OUT_OF_CORE: Final = 110

# Bytes per splat, and at least, that may be allocated between two evictions of mapped arrays: numpy
# holds the interpreter's lock while it copies the footprints of a view, 32 bytes each.
_BURST: Final = 64
_LEAST_BURST: Final = 128 << 20

LEAST_RESIDENT: Final = 64 << 20
"""Least resident bytes of mapped arrays; with fewer, pages are evicted too often."""


@dataclass(frozen=True)
class MemoryNeed:
    """Upper bounds of the resident memory of an encode, bytes.

    Parameters
    ----------
    in_memory : int
        Bound with all arrays in memory.
    out_of_core : int or None
        Bound with scene, scores and decoded splats in mapped files; None for the profile ``vq``,
        which trains codebooks on the whole scene.
    scene : int
        Share of both bounds that is the scene itself.
    """

    in_memory: int
    out_of_core: int | None
    scene: int

    def resident_bytes(self, cap: int) -> int | None:
        """Return the resident-memory limit of mapped arrays, bytes; None if nothing is mapped.

        Parameters
        ----------
        cap : int
            Memory limit of the process, bytes.

        Raises
        ------
        LimitError
            ``memory-cap``: the limit is too low; the message says the lowest that suffices.
        """
        if cap >= self.in_memory:
            return None
        if self.out_of_core is None:
            raise LimitError(
                "memory-cap",
                f"a memory cap of {_gb(cap)}, expected at least {_gb(self.in_memory)}: the profile "
                "vq does not work out of core",
            )
        if cap < self.out_of_core:
            raise LimitError(
                "memory-cap",
                f"a memory cap of {_gb(cap)}, expected at least {_gb(self.out_of_core)}; without "
                f"mapped files this encode takes {_gb(self.in_memory)}",
            )
        return cap - self.out_of_core + LEAST_RESIDENT


def memory_need(
    splats: int, sh_degree: int, config: EncodeConfig, *, extra_bytes: int = 0, held_bytes: int = 0
) -> MemoryNeed:
    """Estimate the memory of an encode.

    Parameters
    ----------
    splats : int
        Number of splats.
    sh_degree : int
        SH degree, 0 to 3.
    config : EncodeConfig
        Configuration of the encode.
    extra_bytes : int
        Bytes of the extra attributes of one splat.
    held_bytes : int
        Bytes of the scene that are never mapped: the whole scene unless it was read into mapped
        arrays.
    """
    row = _ROW + 12 * (sh_coefficients(sh_degree) - 1)
    scene = splats * (row + extra_bytes)
    whole = scene + splats * (row + _SCORES + _KEPT)
    views, threads = _VIEW, thread_count(config.threads)
    if threads > 1 and splats <= MAX_VIEW_PARALLEL_SPLATS:
        views = threads * _VIEW_OF_EACH_CORE + _WAITING
    in_memory = _BASE + whole + splats * views
    renders = split_name(config.order)[0] == "gain" or config.compensate
    if renders:
        in_memory += splats * _GAIN
    if config.profile == "vq":
        return MemoryNeed(in_memory + splats * row, None, scene)
    least = _BASE + LEAST_RESIDENT + splats * (_VIEW + _KEPT) + held_bytes
    if renders:
        in_memory += splats * row
        least += splats * _GAIN_OUT_OF_CORE
    return MemoryNeed(in_memory, min(least, in_memory), scene)


def burst_bytes(splats: int) -> int:
    """Return the bytes by which the memory of an out-of-core encode may grow between evictions.

    Parameters
    ----------
    splats : int
        Number of splats of the scene.
    """
    return _LEAST_BURST + _BURST * splats


def _gb(size: int) -> str:
    """Format bytes as gigabytes."""
    return f"{size / 1e9:.2f} GB"
