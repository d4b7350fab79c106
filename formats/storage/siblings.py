"""Files that another file refers to by name, refused outside its own folder."""

from __future__ import annotations

import os
from pathlib import Path

from cogsplat.codec.errors import FormatError


def sibling(folder: Path, name: str, where: str, code: str) -> Path:
    """Return the path of a file that another file in `folder` refers to by name.

    Parameters
    ----------
    folder : Path
        Folder of the file that names it.
    name : str
        Relative, with forward slashes.
    where : str
        Place of the name, for messages.
    code : str
        Reason code of the refusal.

    Raises
    ------
    FormatError
        `code`: an absolute path, a URL, a way out of the folder by ``..`` or by a link, or
        characters that no file name has.
    """
    steps = name.split("/")
    legal = name.isprintable() and "\\" not in name and ":" not in name
    if legal and "" not in steps and ".." not in steps:
        path = folder / name
        # What links lead to counts, not what they are called.
        if Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
            return path
    shown = name if len(name) <= 80 else name[:77] + "..."
    raise FormatError(code, f"{where}: names {shown!r}, expected a file inside its own folder")
