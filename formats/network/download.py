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
        starts = [0, *range(BEGINNING_BYTES, source.size, _PART_BYTES)]
        ends = [*starts[1:], source.size]
        ranges = [(start, end - start) for start, end in zip(starts, ends, strict=True)]
        with source.prefetch(ranges):
            for done, (offset, length) in enumerate(ranges, start=1):
                file.write(source.read(offset, length))
                progress("fetch", done, len(ranges))
        return source.size
