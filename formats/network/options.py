"""How files are read over a network: requests, waiting, and what to do where they fail."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

KIB = 1 << 10
MIB = 1 << 20


@dataclass(frozen=True)
class NetworkOptions:
    """How a file is read over a network.

    Parameters
    ----------
    headers : mapping of str to str
        Sent with every request to the server that the URL names, such as an authorisation; servers
        that it redirects to do not get them.
    sign : callable, optional
        Returns the URL anew, where access to it expires: called once whenever a server answers 401
        or 403, and the request is made again with what it returns.
    retries : int
        Times that a request is made again without a new byte having come.
    pause_seconds : float
        Pause before the second attempt; each further pause is twice as long, up to
        `longest_pause_seconds`. Half of each pause is left to chance, so that many readers do not
        come back at once.
    longest_pause_seconds : float
    longest_wait_seconds : float
        Longest wait that a server may ask for by ``Retry-After``; one that asks for more has
        failed.
    connect_seconds : float
        Longest wait for a connection.
    idle_seconds : float
        Longest time without a byte.
    in_flight : int
        Requests that are under way at once (SPEC 8.8).
    gap_bytes : int
        A gap that costs less to fetch than a request of its own (SPEC 8.8).
    request_bytes : int
        Most bytes of a request that joins several ranges (SPEC 8.8).
    window_bytes : int
        Bytes that are fetched ahead of what was read; memory beside the decoded scene.
    options_of_store : mapping of str to str
        For ``s3://``, ``gs://`` and ``az://``: configuration of obstore's store, such as
        ``endpoint`` and ``region``. What is not there is taken from the environment.
    cache : path, optional
        Folder in which segments are kept by their hashes, for the next time and for every other
        scene that has them. Roots are fetched each time.
    cache_bytes : int
        What is kept there, nearly.
    random : callable
        Gives the share of a pause that is left to chance, 0 to 1.

    Examples
    --------
    >>> from cogsplat.formats.network.options import NetworkOptions
    >>> NetworkOptions(headers={"Authorization": "Bearer abc"}).retries
    4
    """

    headers: Mapping[str, str] = field(default_factory=dict)
    sign: Callable[[], str] | None = None
    retries: int = 4
    pause_seconds: float = 0.25
    longest_pause_seconds: float = 8.0
    longest_wait_seconds: float = 60.0
    connect_seconds: float = 10.0
    idle_seconds: float = 15.0
    in_flight: int = 6
    gap_bytes: int = 64 * KIB
    request_bytes: int = 4 * MIB
    window_bytes: int = 32 * MIB
    options_of_store: Mapping[str, str] = field(default_factory=dict)
    cache: str | os.PathLike[str] | None = None
    cache_bytes: int = 1 << 30
    random: Callable[[], float] | None = None

    def __post_init__(self) -> None:
        for name in ("retries", "gap_bytes", "pause_seconds"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} {getattr(self, name)}, expected 0 or more")
        for name in ("in_flight", "request_bytes", "window_bytes", "idle_seconds"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} {getattr(self, name)}, expected more than 0")
