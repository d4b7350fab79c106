"""Fetch a whole file from a network into a local one."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from cogsplat.codec.progress import Progress, silent
from cogsplat.formats.storage.atomic import atomic_write

from .open_url import open_url
from .options import MIB, NetworkOptions
from .range_reader import BEGINNING_BYTES

_PART_BYTES: Final = MIB


def download(
    url: str,
    path: Path,
    options: NetworkOptions | None = None,
    *,
    force: bool = False,
    progress: Progress = silent,
) -> int:
    """Fetch a file; `path` is there when all of it is.

    Parameters
    ----------
    url : str
        As `open_url` takes it.
    path : Path
    options : NetworkOptions, optional
    force : bool
        Replace an existing file.
    progress : Progress
        Called with ``("fetch", parts that are there, parts of the file)``: 64 KiB, then MiB.

    Returns
    -------
    int
        Bytes of the file.

    Raises
    ------
    StorageError
        As `open_url`, ``source-changed``, or the file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from cogsplat.formats.network.download import download
    >>> size = download("https://example.org/scene.cogs", Path("copy.cogs"))
    >>> size == Path("copy.cogs").stat().st_size
    True
    """
    with open_url(url, options) as source, atomic_write(path, force=force) as file:
        # The first request is under way: what comes after it is asked for beside it, once.
        starts = [0, *range(BEGINNING_BYTES, source.size, _PART_BYTES)]
        ends = [*starts[1:], source.size]
        ranges = [(start, end - start) for start, end in zip(starts, ends, strict=True)]
        with source.prefetch(ranges):
            for done, (offset, length) in enumerate(ranges, start=1):
                file.write(source.read(offset, length))
                progress("fetch", done, len(ranges))
        return source.size
