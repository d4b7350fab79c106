"""State dicts of PyTorch, read without it: a zip of a pickle and of raw storages.

Only dictionaries and tensors are built: a pickle that names anything else is refused.
"""

from __future__ import annotations

import collections
import math
import pickle
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import DataError
from cogsplat.formats.storage.atomic import open_for_read, storage_errors

F32 = NDArray[np.float32]

_CODE: Final = "lpips-weights"
# VGG-16 whole, its classifier included, is 528 MiB.
_MOST_BYTES: Final = 1 << 30

_DTYPES: Final[Mapping[str, str]] = {
    "FloatStorage": "<f4",
    "DoubleStorage": "<f8",
    "HalfStorage": "<f2",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
}


def read_state_dict(path: Path) -> dict[str, F32]:
    """Read named arrays from what ``torch.save`` or ``numpy.savez`` wrote.

    Parameters
    ----------
    path : Path

    Returns
    -------
    dict of str to float32 array

    Raises
    ------
    StorageError
        It cannot be read.
    DataError
        ``lpips-weights``: it is neither, or holds something else than named arrays.
    """
    with storage_errors(path), open_for_read(path) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                if sum(entry.file_size for entry in archive.infolist()) > _MOST_BYTES:
                    raise _bad(path, f"more than {_MOST_BYTES} bytes")
                pickles = [name for name in archive.namelist() if name.endswith("/data.pkl")]
                if pickles:
                    return _from_torch(archive, pickles[0], path)
            file.seek(0)
            with np.load(file, allow_pickle=False) as arrays:
                return {name: arrays[name].astype(np.float32) for name in arrays.files}
        except DataError:
            raise
        except (
            zipfile.BadZipFile,
            pickle.UnpicklingError,
            zlib.error,
            # What a damaged pickle or header ends in.
            EOFError,
            KeyError,
            IndexError,
            TypeError,
            ValueError,
            AttributeError,
            NotImplementedError,
            RuntimeError,
        ) as error:
            raise _bad(path, f"{type(error).__name__}: {error}") from error


def _from_torch(archive: zipfile.ZipFile, pickled: str, path: Path) -> dict[str, F32]:
    folder = pickled[: -len("data.pkl")]
    with archive.open(pickled) as stream:
        found = _Tensors(stream, lambda key: archive.read(f"{folder}data/{key}")).load()
    if not isinstance(found, dict):
        raise _bad(path, f"a {type(found).__name__}")
    arrays: dict[str, F32] = {}
    for name, value in found.items():
        # State dicts carry their modules' versions beside the arrays.
        if isinstance(value, np.ndarray):
            arrays[str(name)] = value.astype(np.float32)
    return arrays


class _Tensors(pickle.Unpickler):
    """Unpickler that builds dictionaries of arrays and refuses every other class or function."""

    def __init__(self, stream: object, read: Callable[[str], bytes]) -> None:
        super().__init__(stream)  # type: ignore[arg-type]
        self._read = read

    def find_class(self, module: str, name: str) -> object:
        """Return what builds the class of this name, or refuse it."""
        if (module, name) == ("collections", "OrderedDict"):
            return collections.OrderedDict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _tensor
        if (module, name) == ("torch._utils", "_rebuild_parameter"):
            return _parameter
        if module == "torch" and name in _DTYPES:
            return _DTYPES[name]
        raise pickle.UnpicklingError(f"{module}.{name}, expected tensors and dictionaries")

    def persistent_load(self, key: object) -> NDArray[np.generic]:
        """Return a storage."""
        if not isinstance(key, tuple) or len(key) != 5 or key[0] != "storage":
            raise pickle.UnpicklingError(f"{str(key)[:80]}, expected a storage")
        _, dtype, name, _, count = key
        values = np.frombuffer(self._read(str(name)), np.dtype(dtype))
        if len(values) != count:
            raise pickle.UnpicklingError(f"storage of {len(values)} values, expected {count}")
        return values


def _tensor(
    storage: NDArray[np.generic],
    offset: int,
    shape: tuple[int, ...],
    stride: tuple[int, ...],
    *_: object,
) -> NDArray[np.generic]:
    """Return a tensor as a view of its storage."""
    count = math.prod(shape)
    steps = [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    # Saved weights are contiguous; an axis of length 1 may have any stride.
    plain = all(size == 1 or a == b for size, a, b in zip(shape, stride, steps, strict=True))
    if not plain or not 0 <= offset <= offset + count <= len(storage):
        raise pickle.UnpicklingError(f"tensor of shape {shape} with strides {stride}")
    return storage[offset : offset + count].reshape(shape)


def _parameter(tensor: NDArray[np.generic], *_: object) -> NDArray[np.generic]:
    """Return a parameter's tensor."""
    return tensor


def _bad(path: Path, found: str) -> DataError:
    return DataError(
        _CODE, f"{path}: {found[:200]}, expected arrays that torch.save wrote, or .npz"
    )
