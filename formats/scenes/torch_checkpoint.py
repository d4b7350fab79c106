"""Checkpoints of gsplat (``.pt``) and nerfstudio (``.ckpt``), read without PyTorch."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from cogsplat.codec.errors import DataError, FormatError
from cogsplat.codec.splats import Splats
from cogsplat.formats.storage.atomic import StrPath
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.torch_file import CODE, TorchTensor, open_torch

# Keys of the dictionary that holds the tensors: gsplat's trainer, nerfstudio.
_NESTED = ("splats", "pipeline")

# Last parts of the names of a scene's tensors: gsplat's, then nerfstudio's.
_ARRAY_NAMES = frozenset(
    ("means", "scales", "quats", "opacities", "sh0", "shN", "features_dc", "features_rest")
)

# Keys that a message lists, and characters of each.
_MAX_KEYS = 12
_MAX_KEY = 40


def is_torch_checkpoint(head: bytes) -> bool:
    """Return whether a file that begins with `head` is a ZIP file of ``torch.save``.

    The first entry of such a file is the pickle ``NAME/data.pkl``.
    """
    name = head[30 : 30 + int.from_bytes(head[26:28], "little")]
    return head.startswith(b"PK\3\4") and name.endswith(b"/data.pkl")


def read_torch_checkpoint(path: StrPath, *, limits: Limits | None = None) -> Splats:
    """Read the scene of a training checkpoint.

    Parameters
    ----------
    path : path
        Checkpoint of gsplat (``{"splats": {"means": …}}``) or nerfstudio
        (``{"pipeline": {"_model.gauss_params.means": …}}``), or a flat dictionary of the tensors.
    limits : Limits, optional
        Limits on splats and decoded bytes.

    Returns
    -------
    Splats
        Scene in the axes of the training. The optimiser's state and other values are not read.

    Raises
    ------
    FormatError
        ``torch-file``: the file was not written by ``torch.save``, or holds values other than
        dictionaries of tensors; ``bad-shape``, ``missing-array``: the tensors are not a scene.
    LimitError
        The scene exceeds `limits`.
    """
    where = os.fspath(path)
    try:
        with open_torch(path) as state:
            tensors = _tensors(state)
            _require_limits(tensors, path, limits or Limits())
            return Splats.from_gsplat({name: t.array() for name, t in tensors.items()})
    except DataError as error:
        message = error.message if where in error.message else f"{where}: {error.message}"
        raise FormatError(error.code, message) from error


def _tensors(state: Mapping[object, object]) -> dict[str, TorchTensor]:
    """Return the scene's tensors by name, from the top dictionary or a known nested one."""
    levels = [state, *(state[name] for name in _NESTED if name in state)]
    for level in levels:
        if not isinstance(level, Mapping):
            continue
        found = {
            str(name): tensor for name, tensor in level.items() if isinstance(tensor, TorchTensor)
        }
        if any(name == "means" or name.endswith(".means") for name in found):
            arrays = {
                name: tensor
                for name, tensor in found.items()
                if name.rpartition(".")[2] in _ARRAY_NAMES
            }
            # Tensors may share a storage: 4000 of them in a small file would fill the memory.
            if len({name.rpartition(".")[2] for name in arrays}) < len(arrays):
                raise DataError(CODE, f"{len(arrays)} tensors of a scene, expected each name once")
            return arrays
    keys = [str(key)[:_MAX_KEY] for key in list(state)[:_MAX_KEYS]]
    raise DataError(CODE, f"keys {sorted(keys)}, expected the tensors of splats")


def _require_limits(tensors: Mapping[str, TorchTensor], path: StrPath, limits: Limits) -> None:
    """Check the size of a scene against limits, from the shapes of its tensors."""
    rows = max((t.shape[0] for t in tensors.values() if t.shape), default=0)
    rest = [t.shape for name, t in tensors.items() if name.endswith(("shN", "features_rest"))]
    coefficients = rest[0][1] if rest and len(rest[0]) == 3 else 0
    degree = next((d for d in range(3) if (d + 1) ** 2 - 1 >= coefficients), 3)
    limits.require_scene(
        rows,
        sh_degree=degree,
        source_bytes=Path(path).stat().st_size,
        where=os.fspath(path),
    )
