"""Files that another file refers to by name, restricted to its own folder."""

from __future__ import annotations

import os
from pathlib import Path

from cogsplat.codec.errors import FormatError


def sibling(folder: Path, name: str, where: str, code: str) -> Path:
    """Return the path of a file in `folder` that another file there refers to by name.

    Parameters
    ----------
    folder : Path
        Folder of the referring file.
    name : str
        Relative path with forward slashes.
    where : str
        Place of the reference, for messages.
    code : str
        Reason code of the refusal.

    Raises
    ------
    FormatError
        `code`: an absolute path, a URL, a path that leaves the folder by ``..`` or a link, or
        characters that file names cannot have.
    """
    steps = name.split("/")
    legal = name.isprintable() and "\\" not in name and ":" not in name
    if legal and "" not in steps and ".." not in steps:
        path = folder / name
        # Links are resolved first: their targets must be in the folder.
        if Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
            return path
    shown = name if len(name) <= 80 else name[:77] + "..."
    raise FormatError(code, f"{where}: names {shown!r}, expected a file inside its own folder")
