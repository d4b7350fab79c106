"""Options for reading files over a network: timeouts, retries, request sizes and caching."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from cogsplat.codec.finite_fields import require_finite

KIB = 1 << 10
MIB = 1 << 20

_NOT_NEGATIVE = (
    "retries", "gap_bytes", "pause_seconds", "longest_pause_seconds", "longest_wait_seconds",
    "cache_bytes",
)  # fmt: skip
_POSITIVE = (
    "in_flight", "request_bytes", "window_bytes", "unstated_bytes", "idle_seconds",
    "connect_seconds",
)  # fmt: skip


@dataclass(frozen=True)
class NetworkOptions:
    """Timeouts, retries, request sizes and cache for reading files over a network.

    Parameters
    ----------
    headers : mapping of str to str
        HTTP headers sent to the URL's own server, such as ``Authorization``. Servers behind
        redirects do not get them.
    sign : callable, optional
        Function that returns a newly signed URL. Called once per response with status 401 or 403;
        the request is then repeated with the new URL.
    retries : int
        Maximum number of retries of a request without progress in between: 16 KiB of new bytes.
    pause_seconds : float
        Pause before the first retry, seconds; it doubles with each further one. Half of each pause
        is random, so that many clients do not retry at once.
    longest_pause_seconds : float
        Maximum pause before a retry, seconds.
    longest_wait_seconds : float
        Maximum ``Retry-After``, seconds; a request that is to wait longer fails.
    connect_seconds : float
        Timeout of a connection, seconds.
    idle_seconds : float
        Timeout without progress, seconds: without 16 KiB of new bytes or the end of a response.
    in_flight : int
        Maximum number of concurrent requests (SPEC 8.8).
    gap_bytes : int
        Largest gap between two ranges that one request joins, bytes (SPEC 8.8).
    request_bytes : int
        Maximum size of a request that joins several ranges, bytes (SPEC 8.8).
    window_bytes : int
        Maximum size of prefetched ranges that are not read yet, bytes of memory.
    unstated_bytes : int
        Maximum length of a file of unstated length, bytes: the server sends no length, and the
        format of the file, unlike COGS, has none.
    allow_private : bool
        Whether to connect to private addresses: loopback, link-local, private networks, metadata
        services of clouds. Set it to False in servers that open the URLs of their users. Every
        address is then checked after it is resolved, redirects included; proxies of the
        environment are not used, and object stores are refused.
    options_of_store : mapping of str to str
        Configuration of obstore for ``s3://``, ``gs://`` and ``az://``, such as ``endpoint`` and
        ``region``. Missing keys come from the environment.
    cache : path, optional
        Folder for a disk cache of segments, by hash, shared by all scenes. The cache uses its
        subfolder ``cogsplat-segments`` alone. Roots are not cached.
    cache_bytes : int
        Approximate size limit of the disk cache, bytes.
    random : callable, optional
        Source of random numbers from 0 to 1 for pauses; `random.random` by default.

    Examples
    --------
    >>> from cogsplat.formats.network.network_options import NetworkOptions
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
    unstated_bytes: int = 1 << 30
    allow_private: bool = True
    options_of_store: Mapping[str, str] = field(default_factory=dict)
    cache: str | os.PathLike[str] | None = None
    cache_bytes: int = 1 << 30
    random: Callable[[], float] | None = None

    def __post_init__(self) -> None:
        require_finite(self)
        for name in _NOT_NEGATIVE:
            # NaN is not in the range either.
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} {getattr(self, name)}, expected 0 or more")
        for name in _POSITIVE:
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} {getattr(self, name)}, expected more than 0")
        for name, value in self.headers.items():
            if not (name + value).isprintable():
                raise ValueError(f"header {name!r} {value!r}, expected printable characters")
