"""What reading over a network has cost so far."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Traffic:
    """What was asked for and what came, up to now.

    Parameters
    ----------
    requests : int
        Requests that were made, those made again counted.
    received_bytes : int
        Bytes of bodies that came, those that nobody wanted counted.
    failures : int
        Requests that failed in a way that passes.
    busy_seconds : float
        Time in which at least one request was under way.
    """

    requests: int = 0
    received_bytes: int = 0
    failures: int = 0
    busy_seconds: float = 0.0

    @property
    def bytes_per_second(self) -> float:
        """Bandwidth, latency included: bytes for a second in which something was under way."""
        return self.received_bytes / self.busy_seconds if self.busy_seconds else 0.0
