"""Simulated network link with limited bandwidth, latency and failures, for a server."""

from __future__ import annotations

import asyncio
import random
import time
from dataclasses import dataclass
from typing import Final

# Transfer time of a block: short relative to measured times, long relative to a task switch.
_BLOCK_SECONDS: Final = 0.006
# Each response in flight holds one block in memory, and one more to send. Large blocks take less
# processor time per byte, so that a few responses may have them.
_LARGEST_BLOCK: Final = 1 << 16
_CROWD_BLOCK: Final = 1 << 15

MAX_LARGE_BLOCKS: Final = 64
"""Number of responses in flight up to which a block may be 64 KiB; beyond, it is 32 KiB at most."""


@dataclass(frozen=True)
class LinkQuality:
    """Parameters of a simulated link.

    Parameters
    ----------
    bits_per_second : float or None
        Bandwidth, shared by all responses; None for no limit.
    latency_seconds : float
        Time from a request to the first byte of its response.
    loss : float
        Fraction of responses whose connection breaks, 0 to 1.
    fail_rate : float
        Fraction of requests that get status 503, 0 to 1.
    seed : int
        Seed of the random failures.
    """

    bits_per_second: float | None = None
    latency_seconds: float = 0.0
    loss: float = 0.0
    fail_rate: float = 0.0
    seed: int = 0


class ShapedLink:
    """A simulated link that delays the responses of a server in one event loop.

    Parameters
    ----------
    quality : LinkQuality
        Bandwidth, latency and failure rates.
    """

    def __init__(self, quality: LinkQuality) -> None:
        self._quality = quality
        self._random = random.Random(quality.seed)
        self._free_at = 0.0

    async def begin(self) -> bool:
        """Wait for the latency of a request; return whether the request fails."""
        if self._quality.latency_seconds:
            await asyncio.sleep(self._quality.latency_seconds)
        return self._random.random() < self._quality.fail_rate

    def breaks_at(self, size_bytes: int) -> int | None:
        """Draw the number of bytes after which a response breaks; None if it does not break."""
        if self._random.random() >= self._quality.loss:
            return None
        return self._random.randrange(max(1, size_bytes))

    @property
    def is_unlimited(self) -> bool:
        """Whether bytes pass without a wait."""
        return self._quality.bits_per_second is None

    async def wait(self, size_bytes: int) -> None:
        """Wait until bytes have passed the link, behind earlier bytes of all responses."""
        rate = self._quality.bits_per_second
        if rate is None:
            return
        now = time.monotonic()
        self._free_at = max(self._free_at, now) + 8 * size_bytes / rate
        await asyncio.sleep(self._free_at - now)

    def block_bytes(self, responses: int) -> int:
        """Return the size of a block to send at once, bytes.

        Parameters
        ----------
        responses : int
            Responses in flight, the one that the block belongs to included.
        """
        largest = _LARGEST_BLOCK if responses <= MAX_LARGE_BLOCKS else _CROWD_BLOCK
        rate = self._quality.bits_per_second
        if rate is None:
            return largest
        return max(1, min(largest, int(rate * _BLOCK_SECONDS / 8)))
