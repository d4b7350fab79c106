"""Cloud-Optimized Gaussian Splats: encode, decode, read and write splat scenes.

`read` and `write` move scenes between files of any format and arrays, `encode` and `decode`
between scenes and COGS files, `open` gives a COGS file chunk by chunk, `unpack` and `pack` make a
folder of a file and a file of a folder. What is written comes before the path that it is written
to.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from importlib import import_module
from importlib.metadata import PackageNotFoundError, entry_points, version
from pathlib import Path
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
from .codec.executor import Executor
from .codec.progress import OverallProgress, Progress, TimedProgress, silent
from .codec.splats import SceneInfo, Splats
from .formats.cogs.between_levels import decode_between
from .formats.cogs.folder_writer import Unpacked
from .formats.cogs.open_file import open_place, with_place
from .formats.cogs.packing import pack, unpack
from .formats.cogs.reader import CogsFile
from .formats.network.network_options import NetworkOptions
from .formats.storage.limits import Limits
from .formats.storage.source import Readable

if TYPE_CHECKING:
    from .codec.encode.config import EncodeConfig as EncodeConfig
    from .codec.encode.encoded import EncodedScene
    from .codec.encode.encoded import EncodeReport as EncodeReport
    from .codec.encode.preview_chunks import PreviewMaker
    from .codec.encode.rate_control import Target as Target
    from .codec.scoring.contribution import ScoreConfig, Scores
    from .codec.workspace import Workspace

__all__ = [
    "Camera",
    "Cancelled",
    "CogsFile",
    "CogsplatError",
    "DataError",
    "EncodeConfig",
    "EncodeReport",
    "FormatError",
    "LimitError",
    "Limits",
    "NetworkOptions",
    "SceneInfo",
    "Splats",
    "StorageError",
    "Target",
    "TruncatedError",
    "Unpacked",
    "UnsupportedError",
    "decode",
    "encode",
    "open",
    "pack",
    "read",
    "read_cameras",
    "unpack",
    "write",
]

try:
    __version__ = version("cogsplat")
except PackageNotFoundError:  # a bare checkout on the path, never installed
    __version__ = "0+unknown"

# What only encoding needs is imported when it is asked for: decoding takes the core alone.
_LATE = {
    "EncodeConfig": ".codec.encode.config",
    "EncodeReport": ".codec.encode.encoded",
    "Target": ".codec.encode.rate_control",
}


def __getattr__(name: str) -> object:
    if name in _LATE:
        return getattr(import_module(_LATE[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


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
        A local file or folder (SPEC 3.4), a file on a web server as the text of its URL
        (``https://`` with the extra ``http``, ``s3://``, ``gs://`` or ``az://`` with ``cloud``), a
        file in memory, an open file that can seek, or
        anything with `name`, `size`, `read(offset, length)` and `close`.
    partial : bool
        Accept a file that is still being received, or a folder that lacks segments.
    size_bytes : int, optional
        Take the file as if its transfer had stopped after so many bytes.
    limits : Limits, optional
        What may be allocated for it.
    network : NetworkOptions, optional
        How a URL is read: headers, retries, waiting.

    Returns
    -------
    CogsFile
        A context manager: `CogsFile.root` and `CogsFile.chunks` are its tables,
        `CogsFile.select` chooses chunks, `CogsFile.decode` decodes them, `CogsFile.stream` gives
        them as their bytes come. As the last value of a
        notebook's cell it is shown as a viewer, with the extra ``notebook``.

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
    return open_place(path, partial=partial, size_bytes=size_bytes, limits=limits, network=network)


def _show_in_notebooks() -> None:
    """Have the notebook that runs this, if any, show open files."""
    # Outside notebooks nothing has imported IPython, and nothing is imported here.
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if shell is not None:
        shell.display_formatter.mimebundle_formatter.for_type(CogsFile, _bundle)


def _bundle(file: CogsFile) -> object:
    """Return what a notebook shows of an open file: a MIME bundle, or None.

    It comes from an entry point, since the viewer stands above this module, which cannot import it.
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
        As in `open`.
    chunks : tuple of (int or None, int or None), optional
        Half-open range of chunks; None leaves an end open.
    splats : int, optional
        Whole chunks from the first until there are at least so many splats.
    size_bytes : int, optional
        Only what is complete in the first so many bytes of the file.
    objects : sequence of int, optional
        The chunks of these objects alone, by label; `splats` counts theirs.
    sh_degree : int, optional
        Highest SH degree to decode, 0 to 3.
    refine : bool
        Whether to read the refinements that are there; otherwise the heads' coarse values.
    compensate : bool
        Whether to change the splats of the first chunks so that they look most like the whole
        scene (SPEC 8.5): larger and more opaque. Otherwise rows are as stored.
    level : float, optional
        Level of a scene that has some, 0 the coarsest (SPEC 5.11); 1.5 is half-way from level 1
        to level 2. By default the finest.
    limits : Limits, optional
    network : NetworkOptions, optional
        How a URL is read. A file that changes while it is read is read once more.
    threads : int
        0 uses as many as pay.
    progress : Progress

    Returns
    -------
    Splats
        Float32, C order, in stored order.

    Raises
    ------
    CogsplatError
        The file cannot be read, is short, or breaks SPEC.
    ValueError
        More than one of `chunks`, `splats` and `size_bytes`, a range outside the file, an object
        that it does not have, a negative number, `compensate` with chunks that are not the first,
        a level that it does not have, or one beside any of these.

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

    # Of a file on a network all is asked for before its root says where what is.
    parts = (chunks, splats, size_bytes, objects, sh_degree, level)
    return with_place(
        whole,
        path,
        size_bytes=size_bytes,
        limits=limits,
        network=network,
        whole=refine and all(part is None for part in parts),
    )


def encode(
    scene: Splats | _Path,
    path: _Path,
    *,
    cameras: Sequence[Camera] | _Path | None = None,
    scores: Scores | None = None,
    config: EncodeConfig | None = None,
    score_config: ScoreConfig | None = None,
    quality: float | None = None,
    target_psnr: float | None = None,
    target_size: int | str | None = None,
    target: Target | None = None,
    preset: str = "balanced",
    preview: float | None = None,
    stored_cameras: Sequence[Camera] = (),
    test_views: Sequence[Camera] | None = None,
    memory: int | str | None = None,
    workspace: Workspace | None = None,
    force: bool = False,
    executor: Executor | None = None,
    progress: Progress = silent,
    whole: Callable[[float], None] | None = None,
) -> EncodeReport:
    """Encode a scene into a COGS file.

    Parameters
    ----------
    scene : Splats or path
        A path is read in whatever format it has.
    path : path
        The file to write; it appears once it is complete.
    cameras : sequence of Camera or path, optional
        Views to score in: cameras, or what `read_cameras` reads. Without them views are planned
        around the splats.
    scores : Scores, optional
        Of an earlier `score` in these cameras; then no views are scored.
    config : EncodeConfig, optional
    score_config : ScoreConfig, optional
        In place of the preset's.
    quality : float, optional
        Nominal PSNR, dB, in place of `EncodeConfig.quality_db`.
    target_psnr : float, optional
        Search for the nominal quality that gives this PSNR, dB, in the test views.
    target_size : int or str, optional
        Search for the best quality in a file of at most so many bytes; as text such as
        ``"500KiB"``, ``"12MB"`` or ``"20%"`` of the file, or of the arrays, that is encoded.
    target : Target, optional
        Either of these as one value.
    preset : str
        One of `codec.encode.presets.PRESETS`: how many views are looked at, and how much work goes
        into the order by marginal gain and into compensation.
    preview : float, optional
        Share of the file, such as 0.02, spent on preview splats: few trained splats at the front
        that show the whole scene until more of it has loaded (`codec.fit.preview_training`).
    stored_cameras : sequence of Camera
        Stored in the file for its readers; nothing else depends on them.
    test_views : sequence of Camera, optional
        Views that a target is measured and quality is predicted in. By default some of the
        cameras, spread evenly, or test views planned with the others.
    memory : int or str, optional
        Most memory that the process may take, in bytes or as text such as ``"8GiB"``. Where the
        arrays would take more, they are kept in files beside the output, which are mapped into
        memory piece by piece: for a `scene` that is the path of a PLY, and any profile but ``vq``.
        The bytes do not depend on it.
    workspace : Workspace, optional
        Where arrays are kept, in place of what follows from `memory`.
    force : bool
        Replace an existing file.
    executor : Executor, optional
        What runs the work of single views and chunks, such as `codec.executor.LocalThreads` or
        `tools.cluster.dask_executor.DaskExecutor`; threads of this process where it is not given.
    progress : Progress
        Called with a stage, the steps of it that are done, and all its steps. Raising `Cancelled`
        from it stops the work and leaves no file.
    whole : callable, optional
        Called after every such report with the share of the whole work that is done, 0 to 1, which
        never falls. It may raise as well.

    Returns
    -------
    EncodeReport
        `EncodeReport.size_bytes` are the bytes written; `EncodeReport.seconds` and
        `EncodeReport.cpu_seconds` the time of every stage, by the clock and of processors.

    Raises
    ------
    CogsplatError
        The scene or the cameras cannot be used, the target is out of reach, or the file cannot be
        written.
    ValueError
        An unknown preset; more than one of quality, PSNR and size; a target for the profile
        `near-lossless`; a PSNR as target with no views
        to measure it in; `scores` without cameras for an order that renders; a preview that
        nothing is compensated with, or with cells, objects or `memory`.

    Examples
    --------
    >>> import cogsplat
    >>> report = cogsplat.encode("scene.ply", "new.cogs", cameras="cameras.json", preset="fast")
    >>> len(cogsplat.decode("new.cogs", size_bytes=report.size_bytes)) > 0
    True
    """
    from .codec.encode import pipeline
    from .codec.encode.config import EncodeConfig
    from .codec.encode.presets import PRESETS
    from .codec.encode.stage_costs import stage_costs
    from .formats.cogs import scene as cogs
    from .formats.cogs.cameras import check_cameras
    from .formats.scenes.memory_cap import working_memory
    from .formats.scenes.registry import is_cogs, read_scene
    from .formats.storage.atomic import check_output

    if preset not in PRESETS:
        raise ValueError(f"preset {preset!r}, expected one of {tuple(PRESETS)}")
    if sum(x is not None for x in (quality, target_psnr, target_size, target)) > 1:
        raise ValueError("more than one of quality, target_psnr, target_size and target")
    if not isinstance(scene, Splats | str | os.PathLike):
        raise TypeError(f"a {type(scene).__name__}, expected Splats or the path of a scene")
    chosen = PRESETS[preset]
    config = config or EncodeConfig()
    if quality is not None:
        config = replace(config, quality_db=quality)
    # Before minutes of work, not after.
    given = [x for x in (scene, cameras) if isinstance(x, str | os.PathLike)]
    check_output(path, force=force, inputs=given)
    if stored_cameras:
        check_cameras(stored_cameras)
    kept: AbstractContextManager[Workspace]
    if workspace is not None:
        kept = nullcontext(workspace)
    else:
        kept = working_memory(scene, config, _byte_count(memory), Path(path).absolute().parent)
    views = read_cameras(cameras) if isinstance(cameras, str | os.PathLike) else cameras
    writer = f"cogsplat {__version__}"
    first_view = config.ordering.first_view or (views[0] if views else None)

    def size_of(encoded: EncodedScene) -> int:
        return cogs.size_bytes(
            encoded, writer=writer, first_view=first_view, cameras=stored_cameras
        )

    aim = target or _target(target_psnr, target_size, scene)
    with kept as workspace:
        splats = scene
        if not isinstance(splats, Splats):
            splats = (
                decode(splats) if is_cogs(splats) else read_scene(splats, zeros=workspace.zeros)
            )
        if whole is not None:
            costs = stage_costs(
                len(splats),
                config,
                chosen,
                cameras=views,
                jitter=score_config is None or score_config.jitter,
                scored=scores is not None,
                target=aim,
                preview=preview is not None,
            )
            progress = OverallProgress(costs, progress, whole)
        encoded = pipeline.encode(
            splats,
            config,
            cameras=views,
            scores=scores,
            score_config=score_config,
            preset=chosen,
            target=aim,
            test_views=test_views or (),
            size_of=size_of,
            preview=_preview(preview, config.threads),
            workspace=workspace,
            executor=executor,
            progress=progress,
        )
        writing = TimedProgress()
        size_bytes = cogs.save(
            encoded,
            Path(path),
            writer=writer,
            first_view=first_view,
            cameras=stored_cameras,
            force=force,
        )
    writing("write", 1, 1)
    if whole is not None:
        whole(1.0)
    report = encoded.report
    return replace(
        report,
        size_bytes=size_bytes,
        seconds={**report.seconds, **writing.seconds},
        cpu_seconds={**report.cpu_seconds, **writing.cpu_seconds},
    )


def _preview(share: float | None, threads: int) -> PreviewMaker | None:
    """Return what makes a preview of a share of the file; None where none is asked for."""
    if share is None:
        return None
    from .codec.fit.preview_training import PreviewConfig, TrainedPreview

    return TrainedPreview(PreviewConfig(share=share, threads=threads))


def _byte_count(memory: int | str | None) -> int | None:
    """Return a memory cap in bytes."""
    from .formats.storage.byte_counts import parse_bytes

    return None if memory is None else parse_bytes(str(memory))


def _target(psnr_db: float | None, size: int | str | None, scene: Splats | _Path) -> Target | None:
    from .codec.encode.rate_control import Target
    from .formats.scenes.registry import scene_bytes
    from .formats.storage.byte_counts import parse_byte_count

    if isinstance(size, str):
        whole = scene.nbytes if isinstance(scene, Splats) else scene_bytes(scene)
        size = parse_byte_count(size).uncapped(whole)
    return None if psnr_db is None and size is None else Target(psnr_db, size)


def read(path: _Path, *, limits: Limits | None = None) -> Splats:
    """Read a scene in any format, COGS included.

    Parameters
    ----------
    path : path
    limits : Limits, optional
        What the file may cost in memory, and how many splats it may hold.

    Returns
    -------
    Splats
        Axes as the scene has them; natural-log scales, wxyz quaternions, logit opacities.

    Raises
    ------
    CogsplatError
        The file cannot be read, is of no known format, or costs more than `limits` allow.

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
        For PLY: centres as doubles in world coordinates, the scene's origin added.
    spz_precision : str, optional
        For SPZ: ``"fine"``, the default, stores the centres of small scenes in finer steps than
        other programs do; ``"usual"`` stores them in the same, for a smaller file.
    spz_version : int, optional
        For SPZ: 4, the default, or 3 or 2 for programs that read no newer ones.

    Raises
    ------
    ValueError
        `absolute` with another format than PLY, `spz_precision` or `spz_version` with another than
        SPZ.
    CogsplatError
        The extension names no format that can be written, or the file cannot be.

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
    """Read cameras from a ``cameras.json``, a ``transforms.json``, COLMAP's folder or a COGS file.

    Parameters
    ----------
    path : path
    limits : Limits, optional
        How many cameras there may be.

    Returns
    -------
    list of Camera
        In the order of the file.

    Raises
    ------
    CogsplatError
        They cannot be read, or are more than `limits` allow.

    Examples
    --------
    >>> import cogsplat
    >>> cameras = cogsplat.read_cameras("cameras.json")
    >>> cameras[0].width, cameras[0].height
    (64, 48)
    """
    from .formats.cameras.camera_files import read_cameras as read_camera_files

    return read_camera_files(path, limits=limits)
