"""Counts of the requests and bytes of a source on a network."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Traffic:
    """Requests and bytes of a source so far.

    Parameters
    ----------
    requests : int
        Number of requests, retries included.
    received_bytes : int
        Bytes of all response bodies, including bytes that were never read.
    failures : int
        Number of requests that failed with a transient error.
    busy_seconds : float
        Time with at least one request in flight, seconds.
    """

    requests: int = 0
    received_bytes: int = 0
    failures: int = 0
    busy_seconds: float = 0.0

    @property
    def bytes_per_second(self) -> float:
        """Throughput, latency included: received bytes per busy second."""
        return self.received_bytes / self.busy_seconds if self.busy_seconds else 0.0
