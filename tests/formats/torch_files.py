"""Files as ``torch.save`` lays them out, written by hand: no PyTorch is needed."""

import pickle
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


class Storage:
    """Pickles as a reference to one of torch's storages."""

    def __init__(self, key: str, count: int, dtype: str = "FloatStorage") -> None:
        self.key, self.count, self.dtype = key, count, dtype


class Named:
    """Pickles as a name of a module that need not be there."""

    def __init__(self, module: str, name: str) -> None:
        self.module, self.name = module, name


class Tensor:
    """Pickles as torch's tensors do."""

    def __init__(self, *arguments: object, rebuild: str = "_rebuild_tensor_v2") -> None:
        self.arguments, self.rebuild = arguments, rebuild


def saved(path: Path, state: object, storages: dict[str, bytes]) -> None:
    """Write a file as ``torch.save`` lays it out, by hand: protocol 2 opcodes."""
    out = bytearray(b"\x80\x02")

    def put(value: object) -> None:
        if isinstance(value, dict):
            out.extend(b"}")
            for key, item in value.items():
                put(key)
                put(item)
                out.extend(b"s")
        elif isinstance(value, tuple):
            out.extend(b"(")
            for item in value:
                put(item)
            out.extend(b"t")
        elif isinstance(value, Named):
            out.extend(f"c{value.module}\n{value.name}\n".encode())
        elif isinstance(value, Storage):
            named = Named("torch", value.dtype)
            put(("storage", named, value.key, "cpu", value.count))
            out.extend(b"Q")
        elif isinstance(value, Tensor):
            put(Named("torch._utils", value.rebuild))
            put(value.arguments)
            out.extend(b"R")
        else:
            body = pickle.dumps(value, protocol=2)[2:-1]
            out.extend(body)

    put(state)
    out.extend(b".")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("weights/data.pkl", bytes(out))
        for key, data in storages.items():
            archive.writestr(f"weights/data/{key}", data)


def tensor(key: str, array: NDArray[np.float32], dtype: str = "FloatStorage") -> Tensor:
    strides = tuple(size // array.itemsize for size in array.strides)
    return Tensor(Storage(key, array.size, dtype), 0, array.shape, strides, False, {})
