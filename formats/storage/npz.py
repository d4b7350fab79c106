"""Arrays of a file of ``numpy.savez``, read without trusting its headers."""

from __future__ import annotations

import math
import zipfile
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_SUFFIX: Final = ".npy"

# numpy pads a header to a multiple of 64 bytes; those of plain arrays take 128.
_MAX_HEADER_BYTES: Final = 4096


def array_names(archive: zipfile.ZipFile) -> list[str]:
    """Return the names of the arrays of a file of ``numpy.savez``, in the order of the file."""
    return [name.removesuffix(_SUFFIX) for name in archive.namelist()]


def read_array(archive: zipfile.ZipFile, name: str, max_bytes: int | None = None) -> NDArray[Any]:
    """Return an array of a file of ``numpy.savez``.

    Its bytes are read once their number, as stored in the file, is that of its type and shape.
    `numpy.load` allocates what a header claims, and inflates compressed entries of any size.

    Parameters
    ----------
    archive : ZipFile
        Open file (`zip_directory.open_zip`).
    name : str
        Name of the array.
    max_bytes : int, optional
        Limit on the bytes of the array.

    Raises
    ------
    BadZipFile
        The array is compressed, larger than `max_bytes`, or its length is not that of its header.
    ValueError
        The header is none of numpy, or has objects.
    KeyError
        The file has no such array.
    """
    found = name if name in archive.NameToInfo else f"{name}{_SUFFIX}"
    entry = archive.getinfo(found)
    if entry.compress_type != zipfile.ZIP_STORED or entry.file_size != entry.compress_size:
        raise zipfile.BadZipFile(f"{name[:60]}: compressed, expected it as numpy.savez stores it")
    with archive.open(entry) as file:
        version = np.lib.format.read_magic(file)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }
        if version not in read_header:
            raise ValueError(f"{name[:60]}: header of version {version}, expected 1.0 or 2.0")
        shape, by_columns, dtype = read_header[version](file, max_header_size=_MAX_HEADER_BYTES)
        stored = entry.file_size - file.tell()
        size = math.prod(shape) * dtype.itemsize
        if dtype.hasobject or stored != size or (max_bytes is not None and size > max_bytes):
            raise zipfile.BadZipFile(
                f"{name[:60]}: {stored} bytes, expected {str(dtype)[:60]} of shape "
                f"{str(shape)[:60]}{'' if max_bytes is None else f' and at most {max_bytes}'}"
            )
        data = file.read()
    return np.frombuffer(data, dtype).reshape(shape, order="F" if by_columns else "C")
