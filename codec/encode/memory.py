"""What memory an encode takes, and whether it fits below a cap in memory or out of core."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from cogsplat.codec.errors import LimitError
from cogsplat.codec.order.orders import split_name
from cogsplat.codec.scoring.contribution import MAX_VIEW_PARALLEL_SPLATS
from cogsplat.codec.splats import sh_coefficients
from cogsplat.codec.threads import thread_count

from .config import EncodeConfig

# Bytes of the program with its libraries, of what compiling takes on top in a first run, and of
# chunks under way: measured with scenes of 5,000 splats.
_BASE: Final = 400_000_000

# Bytes of one splat without its SH above DC, float32.
_ROW: Final = 56

# Bytes of a splat's scores, sensitivities and mean SH bases among them.
_SCORES: Final = 328

# Most bytes that the one view under way takes for each splat that it shows, if that is all of them:
# footprint, colour, sums, sensitivities. A view takes more where each core has one of its own, and
# two more may wait to be added, of which the sums and sensitivities are left.
_VIEW: Final = 260
_VIEW_OF_EACH_CORE: Final = 320
_WAITING: Final = 2 * 132

# Rows, energies and marks that stay in memory whatever is mapped, and the payloads.
_KEPT: Final = 60

# What the order by gain and the fit of compensation take for each splat beside the scene: with a
# view on each core, and out of core, where they draw one view at a time, after those are scored.
_GAIN: Final = 400
_GAIN_OUT_OF_CORE: Final = 110

LEAST_RESIDENT: Final = 64 << 20
"""Bytes of mapped arrays that must have room in memory: with fewer, pages come and go too often."""


@dataclass(frozen=True)
class MemoryNeed:
    """What an encode takes at most, bytes of resident memory.

    Parameters
    ----------
    in_memory : int
        With all arrays in memory.
    out_of_core : int or None
        With the scene, its scores and what is decoded of it in mapped files; None for the profile
        ``vq``, which trains codebooks on the whole scene at once.
    scene : int
        Of both, the scene itself.
    """

    in_memory: int
    out_of_core: int | None
    scene: int

    def resident_bytes(self, cap: int) -> int | None:
        """Return how many bytes of mapped arrays may be resident; None where none need be mapped.

        Parameters
        ----------
        cap : int
            Most memory, bytes.

        Raises
        ------
        LimitError
            ``memory-cap``: it is not enough; the message says what is.
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
    """Return what encoding a scene takes.

    Parameters
    ----------
    splats : int
        Rows of the scene.
    sh_degree : int
        0 to 3.
    config : EncodeConfig
    extra_bytes : int
        Bytes of the extra attributes of one splat.
    held_bytes : int
        Bytes of the scene that are in memory whatever is mapped: all of it where it was not read
        into mapped arrays.
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


def _gb(size: int) -> str:
    return f"{size / 1e9:.2f} GB"
