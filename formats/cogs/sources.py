"""What a COGS scene is read from: a file, a folder of objects, bytes, or another source."""

from __future__ import annotations

import os
from pathlib import Path

from cogsplat.formats.storage.source import FileSource, Readable, Source, as_source

from .folder_source import FolderSource, names_folder


def cogs_source(given: Readable) -> Source:
    """Return what reads byte ranges of a COGS scene.

    Parameters
    ----------
    given : path, bytes, binary file object or Source
        A path may be that of a file, of a folder that has a ``manifest.cogsm``, or of a manifest.

    Raises
    ------
    StorageError
        It cannot be opened.
    FormatError, TruncatedError, UnsupportedError
        The manifest of a folder breaks SPEC 3.4, or its root SPEC 4 and 5.
    TypeError
        It is none of these.

    Examples
    --------
    >>> cogs_source(b"scene").size
    5
    """
    if isinstance(given, str | os.PathLike):
        path = Path(given)
        return FolderSource(path) if names_folder(path) else FileSource(path)
    return as_source(given)
