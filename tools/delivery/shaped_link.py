"""A link as slow and as bad as asked for, which all answers of a server share."""

from __future__ import annotations

import asyncio
import random
import time
from dataclasses import dataclass
from typing import Final

# A block takes this long on the link: short beside what is measured, long beside a task's turn.
_BLOCK_SECONDS: Final = 0.006
_LARGEST_BLOCK: Final = 1 << 16


@dataclass(frozen=True)
class LinkQuality:
    """How slow and how bad a link is.

    Parameters
    ----------
    bits_per_second : float or None
        Of all answers together; None for as fast as the machine is.
    latency_seconds : float
        From a request to the first byte of its answer.
    loss : float
        Share of the answers whose connection breaks in the middle, 0 to 1.
    fail_rate : float
        Share of the requests that are answered with status 503, 0 to 1.
    seed : int
        Of what is left to chance.
    """

    bits_per_second: float | None = None
    latency_seconds: float = 0.0
    loss: float = 0.0
    fail_rate: float = 0.0
    seed: int = 0


class ShapedLink:
    """Holds answers back so that together they take what a link of some quality has.

    Used in one event loop.

    Parameters
    ----------
    quality : LinkQuality
    """

    def __init__(self, quality: LinkQuality) -> None:
        self._quality = quality
        self._random = random.Random(quality.seed)
        self._free_at = 0.0

    async def begin(self) -> bool:
        """Wait as long as a request travels; return whether it fails."""
        if self._quality.latency_seconds:
            await asyncio.sleep(self._quality.latency_seconds)
        return self._random.random() < self._quality.fail_rate

    def breaks_at(self, size_bytes: int) -> int | None:
        """Return after how many bytes the answer's connection breaks, None where it does not."""
        if self._random.random() >= self._quality.loss:
            return None
        return self._random.randrange(max(1, size_bytes))

    async def wait(self, size_bytes: int) -> None:
        """Wait until bytes have passed; those that came before, of any answer, go first."""
        rate = self._quality.bits_per_second
        if rate is None:
            return
        now = time.monotonic()
        self._free_at = max(self._free_at, now) + 8 * size_bytes / rate
        await asyncio.sleep(self._free_at - now)

    @property
    def block_bytes(self) -> int:
        """Bytes to send at a time."""
        rate = self._quality.bits_per_second
        if rate is None:
            return _LARGEST_BLOCK
        return max(1, min(_LARGEST_BLOCK, int(rate * _BLOCK_SECONDS / 8)))
