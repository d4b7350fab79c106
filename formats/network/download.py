"""Download a whole file from a web server or an object store."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from cogsplat.codec.progress import Progress, silent
from cogsplat.formats.storage.atomic import atomic_write

from .network_options import MIB, NetworkOptions
from .open_url import open_url
from .range_fetcher import BEGINNING_BYTES

_PART_BYTES: Final = MIB
_PARTS_PREFETCHED: Final = 256


def download(
    url: str,
    path: Path,
    options: NetworkOptions | None = None,
    *,
    force: bool = False,
    progress: Progress = silent,
) -> int:
    """Download a file; `path` appears once the file is complete.

    Parameters
    ----------
    url : str
        Address with one of the schemes of `open_url`.
    path : Path
        Local file to write.
    options : NetworkOptions, optional
        Timeouts, retries and limits of requests.
    force : bool
        Whether to replace an existing file.
    progress : Progress
        Callback, called with ``("fetch", parts received, parts of the file)``. The first part has
        64 KiB, each further one 1 MiB.

    Returns
    -------
    int
        Length of the file, bytes.

    Raises
    ------
    StorageError
        The errors of `open_url`; ``source-changed``; the errors of `atomic_write`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from cogsplat.formats.network.download import download
    >>> size = download("https://example.org/scene.cogs", Path("copy.cogs"))
    >>> size == Path("copy.cogs").stat().st_size
    True
    """
    with open_url(url, options) as source, atomic_write(path, force=force) as file:
        # The first part is the range of the source's first request, already in flight.
        first = min(BEGINNING_BYTES, source.size)
        count = 1 + -(-(source.size - first) // _PART_BYTES)
        # By groups, because a server may state any length.
        for group in range(0, count, _PARTS_PREFETCHED):
            ranges = []
            for part in range(group, min(count, group + _PARTS_PREFETCHED)):
                start = first + (part - 1) * _PART_BYTES if part else 0
                end = min(source.size, first + part * _PART_BYTES)
                ranges.append((start, end - start))
            with source.prefetch(ranges):
                for done, (offset, length) in enumerate(ranges, start=group + 1):
                    file.write(source.read(offset, length))
                    progress("fetch", done, count)
        return source.size
