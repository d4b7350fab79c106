"""Cloud-Optimized Gaussian Splats: encode, decode, read and write splat scenes.

`read` and `write` convert between arrays and files of any format, `encode` and `decode` between
scenes and COGS files. `open` reads a COGS file chunk by chunk; `unpack` and `pack` convert between
a file and a folder. `tune` and `layers` train a scene before they encode it; `render`, `score` and
`compare` draw and measure scenes. Inputs come before outputs among the arguments.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import PackageNotFoundError, entry_points, version
from typing import TYPE_CHECKING

from .codec.cameras import Camera
from .codec.errors import (
    Cancelled,
    CogsplatError,
    DataError,
    FormatError,
    LimitError,
    StorageError,
    TruncatedError,
    UnsupportedError,
)
from .codec.progress import OverallProgress, Progress, silent
from .codec.splats import SceneInfo, Splats
from .formats.cogs.between_levels import decode_between
from .formats.cogs.describing import describe
from .formats.cogs.description import (
    Annotation,
    CameraPath,
    Description,
    Georeference,
    PathStop,
    Picture,
)
from .formats.cogs.description_json import read_description
from .formats.cogs.folder_writer import Unpacked
from .formats.cogs.joining import Joined, join
from .formats.cogs.open_file import open_scene, with_open_scene
from .formats.cogs.packing import pack, unpack
from .formats.cogs.reader import CogsFile
from .formats.network.network_options import NetworkOptions
from .formats.storage.limits import Limits
from .formats.storage.source import Readable

if TYPE_CHECKING:
    from . import encoder_api
    from .codec.encode.config import EncodeConfig as EncodeConfig
    from .codec.encode.config import Target as Target
    from .codec.encode.encoded import EncodeReport as EncodeReport
    from .codec.encode.request import EncodeRequest as EncodeRequest
    from .codec.fit.train_config import LevelsConfig as LevelsConfig
    from .codec.fit.tune_config import TuneConfig as TuneConfig
    from .codec.scoring.score_config import ScoreConfig as ScoreConfig

    compare, encode, layers = encoder_api.compare, encoder_api.encode, encoder_api.layers
    render, score, tune = encoder_api.render, encoder_api.score, encoder_api.tune

__all__ = [
    "Annotation",
    "Camera",
    "CameraPath",
    "Cancelled",
    "CogsFile",
    "CogsplatError",
    "DataError",
    "Description",
    "EncodeConfig",
    "EncodeReport",
    "EncodeRequest",
    "FormatError",
    "Georeference",
    "Joined",
    "LevelsConfig",
    "LimitError",
    "Limits",
    "NetworkOptions",
    "OverallProgress",
    "PathStop",
    "Picture",
    "SceneInfo",
    "ScoreConfig",
    "Splats",
    "StorageError",
    "Target",
    "TruncatedError",
    "TuneConfig",
    "Unpacked",
    "UnsupportedError",
    "compare",
    "decode",
    "describe",
    "encode",
    "join",
    "layers",
    "open",
    "pack",
    "read",
    "read_cameras",
    "read_description",
    "render",
    "score",
    "tune",
    "unpack",
    "write",
]

try:
    __version__ = version("cogsplat")
except PackageNotFoundError:  # a bare checkout on the path, never installed
    __version__ = "0+unknown"

# Names that need the extra ``encode`` are imported on first use: decoding needs the core alone.
_LATE = {
    "EncodeConfig": ".codec.encode.config",
    "EncodeReport": ".codec.encode.encoded",
    "EncodeRequest": ".codec.encode.request",
    "LevelsConfig": ".codec.fit.train_config",
    "ScoreConfig": ".codec.scoring.score_config",
    "Target": ".codec.encode.config",
    "TuneConfig": ".codec.fit.tune_config",
    **dict.fromkeys(("compare", "encode", "layers", "render", "score", "tune"), ".encoder_api"),
}


def __getattr__(name: str) -> object:
    if name in _LATE:
        return getattr(import_module(_LATE[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)


_Path = str | os.PathLike[str]


def open(
    path: Readable,
    *,
    partial: bool = False,
    size_bytes: int | None = None,
    limits: Limits | None = None,
    network: NetworkOptions | None = None,
) -> CogsFile:
    """Open a COGS file without decoding it.

    Parameters
    ----------
    path : path, URL, bytes, binary file object or Source
        A local file or folder (SPEC 3.4); a URL (``https://`` with the extra ``http``; ``s3://``,
        ``gs://`` or ``az://`` with the extra ``cloud``); the bytes of a file; a seekable binary
        file object; or an object with `name`, `size`, `read(offset, length)` and `close`.
    partial : bool
        Accept a file that is still being received, or a folder that lacks segments.
    size_bytes : int, optional
        Length to which the file is cut, bytes; simulates an interrupted transfer.
    limits : Limits, optional
        Limits on memory and on the numbers of splats and cameras.
    network : NetworkOptions, optional
        Settings for URLs: headers, retries, timeouts.

    Returns
    -------
    CogsFile
        A context manager: `CogsFile.root` and `CogsFile.chunks` are its tables,
        `CogsFile.select` chooses chunks, `CogsFile.decode` decodes them, `CogsFile.stream` yields
        them as their bytes arrive. A notebook displays it as a viewer, with the extra ``notebook``.

    Raises
    ------
    CogsplatError
        The file cannot be read or breaks SPEC.
    ValueError
        A negative size.

    Examples
    --------
    >>> import cogsplat
    >>> with cogsplat.open("scene.cogs") as file:
    ...     preview = file.decode(file.select(splats=100), sh_degree=0)
    >>> len(preview) >= 100
    True
    """
    _show_in_notebooks()
    return open_scene(path, partial=partial, size_bytes=size_bytes, limits=limits, network=network)


def _show_in_notebooks() -> None:
    """Register the viewer of open files with the running notebook, if there is one."""
    # Outside notebooks nothing has imported IPython, and nothing is imported here.
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if shell is not None:
        shell.display_formatter.mimebundle_formatter.for_type(CogsFile, _bundle)


def _bundle(file: CogsFile) -> object:
    """Return the MIME bundle that a notebook shows for an open file, or None.

    The entry point ``cogsplat.display`` names the function that makes the bundle: this module must
    not import the tools.
    """
    for entry in entry_points(group="cogsplat.display"):
        return entry.load()(file)
    return None


def decode(
    path: Readable,
    *,
    chunks: tuple[int | None, int | None] | None = None,
    splats: int | None = None,
    size_bytes: int | None = None,
    objects: Sequence[int] | None = None,
    sh_degree: int | None = None,
    refine: bool = True,
    compensate: bool = False,
    level: float | None = None,
    limits: Limits | None = None,
    network: NetworkOptions | None = None,
    threads: int = 0,
    progress: Progress = silent,
) -> Splats:
    """Decode a COGS file, or a part of it.

    Parameters
    ----------
    path : path, URL, bytes, binary file object or Source
        File, folder or URL, as in `open`.
    chunks : tuple of (int or None, int or None), optional
        Half-open range of chunks; None leaves an end open.
    splats : int, optional
        Minimum number of splats: whole chunks are decoded from the first on until it is reached.
    size_bytes : int, optional
        Length, bytes, of the part of the file to decode; incomplete segments are ignored.
    objects : sequence of int, optional
        Labels of the objects whose chunks to decode; `splats` then counts in these chunks only.
    sh_degree : int, optional
        Highest SH degree to decode, 0 to 3.
    refine : bool
        Whether to apply refinements where the file has them; False decodes the coarse values of
        the heads alone.
    compensate : bool
        Whether to enlarge the splats of a prefix and make them more opaque, so that it looks like
        the whole scene (SPEC 8.5). False leaves the splats as stored.
    level : float, optional
        Level of detail, 0 the coarsest (SPEC 5.11); 1.5 is half-way from level 1 to level 2. None
        for the finest.
    limits : Limits, optional
        Limits on memory and number of splats.
    network : NetworkOptions, optional
        Settings for URLs. A file that changes during reading is read once more.
    threads : int
        Number of threads; 0 for an automatic choice.
    progress : Progress
        Callback, called with ``("decode", chunks done, chunks)``.

    Returns
    -------
    Splats
        Float32, C order, in stored order.

    Raises
    ------
    CogsplatError
        The file cannot be read, is short, or breaks SPEC.
    ValueError
        More than one of `chunks`, `splats` and `size_bytes`; a negative number; a range, object or
        level that the file does not have; `compensate` with chunks that are not a prefix; or
        `level` together with `compensate` or a part of the file.

    Examples
    --------
    >>> import cogsplat
    >>> whole = cogsplat.decode("scene.cogs")
    >>> first = cogsplat.decode("scene.cogs", chunks=(0, 1))
    >>> 0 < len(first) <= len(whole)
    True
    """
    if sum(x is not None for x in (chunks, splats, size_bytes)) > 1:
        raise ValueError("more than one of chunks, splats and size_bytes")
    if threads < 0:
        raise ValueError(f"threads {threads}, expected 0 or more")
    if level is not None and (
        compensate or any(x is not None for x in (chunks, splats, size_bytes, objects))
    ):
        raise ValueError("level with a part of the file or with compensate")

    def whole(file: CogsFile) -> Splats:
        if level is not None:
            return decode_between(
                file,
                level,
                sh_degree=sh_degree,
                refine=refine,
                threads=threads,
                progress=progress,
            )
        return file.decode(
            file.select(chunks=chunks, objects=objects, splats=splats),
            sh_degree=sh_degree,
            refine=refine,
            compensate=compensate,
            threads=threads,
            progress=progress,
        )

    # A remote file that is decoded whole is requested at once, before its root has been read.
    parts = (chunks, splats, size_bytes, objects, sh_degree, level)
    return with_open_scene(
        whole,
        path,
        size_bytes=size_bytes,
        limits=limits,
        network=network,
        whole=refine and all(part is None for part in parts),
    )


def read(path: _Path, *, limits: Limits | None = None) -> Splats:
    """Read a scene in any format, COGS included.

    Parameters
    ----------
    path : path
    limits : Limits, optional
        Limits on memory and number of splats.

    Returns
    -------
    Splats
        Axes as the scene has them; natural-log scales, wxyz quaternions, logit opacities.

    Raises
    ------
    CogsplatError
        The file cannot be read, has an unknown format, or exceeds `limits`.

    Examples
    --------
    >>> import cogsplat
    >>> cogsplat.read("scene.ply").means.shape[1]
    3
    """
    from .formats.scenes.registry import is_cogs, read_scene

    return decode(path, limits=limits) if is_cogs(path) else read_scene(path, limits=limits)


def write(
    splats: Splats,
    path: _Path,
    *,
    force: bool = False,
    format_name: str | None = None,
    absolute: bool = False,
    spz_precision: str | None = None,
    spz_version: int | None = None,
) -> None:
    """Write a scene in the format that the extension of `path` names; `encode` writes COGS.

    Parameters
    ----------
    splats : Splats
    path : path
    force : bool
        Replace an existing file.
    format_name : str, optional
        One of `formats.scenes.registry.WRITABLE`, such as ``"ply"``: write this format whatever
        the extension.
    absolute : bool
        For PLY: write means as float64 in world coordinates, with the scene's origin added.
    spz_precision : str, optional
        For SPZ: quantiser step of the means. ``"usual"`` is the step of other programs, for a
        smaller file; ``"fine"``, the default, is a finer step for small scenes.
    spz_version : int, optional
        For SPZ: format version 4, the default, or 3 or 2 for older programs.

    Raises
    ------
    ValueError
        `absolute` with a format other than PLY; `spz_precision` or `spz_version` with a format
        other than SPZ.
    CogsplatError
        The extension names no writable format, or the file cannot be written.

    Examples
    --------
    >>> import cogsplat
    >>> scene = cogsplat.read("scene.ply")
    >>> cogsplat.write(scene, "copy.ply")
    >>> len(cogsplat.read("copy.ply")) == len(scene)
    True
    """
    from .formats.scenes.registry import write_scene

    write_scene(
        splats,
        path,
        force=force,
        format_name=format_name,
        absolute=absolute,
        spz_precision=spz_precision,
        spz_version=spz_version,
    )


def read_cameras(path: _Path, *, limits: Limits | None = None) -> list[Camera]:
    """Read cameras from a ``cameras.json``, a ``transforms.json``, a COLMAP folder or a COGS file.

    Parameters
    ----------
    path : path
    limits : Limits, optional
        Limit on the number of cameras.

    Returns
    -------
    list of Camera
        In the order of the file.

    Raises
    ------
    CogsplatError
        The cameras cannot be read, or exceed `limits`.

    Examples
    --------
    >>> import cogsplat
    >>> cameras = cogsplat.read_cameras("cameras.json")
    >>> cameras[0].width, cameras[0].height
    (64, 48)
    """
    from .formats.cameras.camera_files import read_cameras as read_camera_files

    return read_camera_files(path, limits=limits)
