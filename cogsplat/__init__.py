"""Cloud-Optimized Gaussian Splats: encode, decode, read and write splat scenes.

``read`` and ``write`` move scenes between files and arrays in any format, ``encode`` and ``decode``
between scenes and COGS files, ``open`` gives a COGS file chunk by chunk.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
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
from .codec.progress import Progress, silent
from .codec.splats import SceneInfo, Splats
from .formats.cogs.reader import CogsFile, open_cogs
from .formats.storage.limits import Limits
from .formats.storage.source import FileSource, PrefixSource, Source

if TYPE_CHECKING:
    from .codec.encode.config import EncodeConfig
    from .codec.encode.encoded import EncodedScene
    from .codec.encode.encoder import Prepared
    from .codec.encode.rate_control import Target
    from .codec.scoring.contribution import ScoreConfig, Scores
    from .codec.scoring.reference_views import ReferenceViews

__all__ = [
    "Camera",
    "Cancelled",
    "CogsFile",
    "CogsplatError",
    "DataError",
    "FormatError",
    "LimitError",
    "Limits",
    "SceneInfo",
    "Splats",
    "StorageError",
    "TruncatedError",
    "UnsupportedError",
    "decode",
    "encode",
    "open",
    "read",
    "read_cameras",
    "write",
]

try:
    __version__ = version("cogsplat")
except PackageNotFoundError:  # a bare checkout on the path, never installed
    __version__ = "0+unknown"

_Path = str | os.PathLike[str]


def open(path: _Path | Source, *, partial: bool = False, limits: Limits | None = None) -> CogsFile:
    """Open a COGS file without decoding it.

    Parameters
    ----------
    path : path or Source
        A local file, or anything that reads ranges.
    partial : bool
        Accept a file that is still being received.
    limits : Limits, optional
        What may be allocated for it.

    Returns
    -------
    CogsFile
        A context manager with ``root``, ``chunks`` and ``decode``.

    Raises
    ------
    CogsplatError
        The file cannot be read or breaks SPEC.
    """
    source = FileSource(Path(path)) if isinstance(path, str | os.PathLike) else path
    try:
        return open_cogs(source, partial=partial, limits=limits)
    except BaseException:
        source.close()
        raise


def decode(
    path: _Path | Source,
    *,
    chunks: tuple[int, int] | None = None,
    splats: int | None = None,
    size_bytes: int | None = None,
    objects: Sequence[int] | None = None,
    sh_degree: int | None = None,
    refine: bool = True,
    compensate: bool = False,
    limits: Limits | None = None,
    threads: int = 0,
    progress: Progress = silent,
) -> Splats:
    """Decode a COGS file, or a part of it.

    Parameters
    ----------
    path : path or Source
    chunks : tuple of int, optional
        Half-open range of chunks.
    splats : int, optional
        Whole chunks from the first until there are at least so many splats.
    size_bytes : int, optional
        Only what is complete in the first so many bytes of the file.
    objects : sequence of int, optional
        The chunks of these objects alone, by label; `splats` counts theirs.
    sh_degree : int, optional
        Highest SH degree wanted, 0 to 3.
    refine : bool
        Whether to read the refinements that are there; otherwise the heads' coarse values.
    compensate : bool
        Make up for what is missing, as the file says (SPEC 8.5): the first chunks only, whose
        splats become larger and more opaque. Otherwise, rows are as stored.
    limits : Limits, optional
    threads : int
        0 uses all cores.
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
        More than one of `chunks`, `splats` and `size_bytes`, a range outside the file, a
        negative number, or `compensate` with chunks that are not the first.
    """
    if sum(x is not None for x in (chunks, splats, size_bytes)) > 1:
        raise ValueError("more than one of chunks, splats and size_bytes")
    for name, value in (("splats", splats), ("size_bytes", size_bytes), ("threads", threads)):
        if value is not None and value < 0:
            raise ValueError(f"{name} {value}, expected 0 or more")
    source = FileSource(Path(path)) if isinstance(path, str | os.PathLike) else path
    if size_bytes is not None:
        source = PrefixSource(source, size_bytes)
    with open(source, partial=size_bytes is not None, limits=limits) as file:
        wanted: Sequence[int] | None = None
        if chunks is not None:
            first, last = chunks
            if not 0 <= first <= last <= file.num_chunks:
                raise ValueError(f"chunks {first}:{last}, expected a range in 0:{file.num_chunks}")
            wanted = range(first, last)
        if objects is not None:
            own = set(file.chunks_of_objects(objects))
            wanted = range(file.complete_chunks()) if wanted is None else wanted
            wanted = [chunk for chunk in wanted if chunk in own]
        if splats is not None:
            there = range(file.num_chunks) if wanted is None else wanted
            wanted = file.first_chunks(there, splats)
        return file.decode(
            wanted,
            sh_degree=sh_degree,
            refine=refine,
            compensate=compensate,
            threads=threads,
            progress=progress,
        )


def encode(
    scene: Splats | _Path,
    path: _Path,
    *,
    cameras: Sequence[Camera] | _Path | None = None,
    scores: Scores | None = None,
    config: EncodeConfig | None = None,
    score_config: ScoreConfig | None = None,
    target: Target | None = None,
    preset: str = "balanced",
    stored_cameras: Sequence[Camera] = (),
    measured_on: Sequence[Camera] | None = None,
    force: bool = False,
    progress: Progress = silent,
) -> int:
    """Encode a scene into a COGS file.

    Parameters
    ----------
    scene : Splats or path
        A path is read in whatever format it has.
    path : path
        The file to write, beside and renamed.
    cameras : sequence of Camera or path, optional
        Views to score on: cameras, a ``cameras.json`` or a COLMAP folder. Without them, views are
        planned from the splats.
    scores : Scores, optional
        Of an earlier `score`; then no views are rendered.
    config : EncodeConfig, optional
    score_config : ScoreConfig, optional
        In place of the preset's.
    target : Target, optional
        A PSNR or a size to hit; then `EncodeConfig.quality_db` does not count.
    preset : str
        One of `codec.preset.PRESETS`: how carefully the scene is looked at; where no `config` is
        given, also whether prefixes are ordered and compensated by what they show.
    stored_cameras : sequence of Camera
        Stored in the file, for whoever reads it; nothing else depends on them.
    measured_on : sequence of Camera, optional
        Views that a target is measured and quality predicted in. Where none are given, some of
        those scored, spread evenly; around a subject that stands free, a turntable's.
    force : bool
        Replace an existing file.
    progress : Progress
        Raising `Cancelled` from it stops the work and leaves no file.

    Returns
    -------
    int
        Bytes written.

    Raises
    ------
    CogsplatError
        The scene or the cameras cannot be used, the target is out of reach, or the file cannot be
        written.
    ValueError
        An unknown preset; a target for the profile `near-lossless`, or a PSNR with no views to
        measure it in.
    """
    from .codec.encode import config as encode_config
    from .codec.encode import encoder
    from .codec.encode.compensation_fit import FitConfig, blank, compensated
    from .codec.encode.prefix_quality import predicted
    from .codec.encode.presets import PRESETS
    from .codec.order.orders import split_name
    from .codec.order.prefix_inflation import effective_splats
    from .codec.scoring.contribution import score
    from .codec.scoring.reference_views import render_references
    from .formats.cogs import scene as cogs
    from .formats.storage.atomic import check_output

    if preset not in PRESETS:
        raise ValueError(f"preset {preset!r}, expected one of {tuple(PRESETS)}")

    # Before minutes of work, not after.
    check_output(path, force=force)
    splats = scene if isinstance(scene, Splats) else read(scene)
    splats.require_valid()
    chosen = PRESETS[preset]
    config = config or encode_config.EncodeConfig(order=chosen.order, compensate=chosen.compensate)
    views: Sequence[Camera] = []
    if cameras is not None:
        given = isinstance(cameras, str | os.PathLike)
        views = read_cameras(cameras) if given else cameras  # type: ignore[arg-type, assignment]
    first_view = config.ordering.first_view or (views[0] if views else None)
    settings = score_config or chosen.score_config(config.profile, threads=config.threads)
    if scores is None and len(splats):
        if cameras is None:
            views, test_views = _planned(splats, config, chosen.planned_views, progress)
            measured_on = measured_on or test_views
        else:
            views = chosen.views(views)
        # An empty list is refused, not taken for none given.
        if cameras is not None or views:
            scores = score(splats, views, settings, progress=progress)
    fits = config.compensate and config.profile != "near-lossless"
    fitted = fits and scores is not None and bool(views)
    references: ReferenceViews | None = None
    if len(splats) and views and (fitted or split_name(config.order)[0] == "gain"):
        references = render_references(
            splats, views, jittered=settings.jitter, threads=config.threads, progress=progress
        )
    prepared = encoder.prepare(
        splats,
        scores,
        config,
        views=views,
        jitter=settings.jitter,
        references=references,
        progress=progress,
    )
    writer = f"cogsplat {__version__}"
    fit = FitConfig(threads=config.threads)

    def size_of(scene: EncodedScene) -> int:
        return cogs.size_bytes(scene, writer=writer, first_view=first_view, cameras=stored_cameras)

    def room_of(trial: EncodedScene) -> int:
        if fitted and scores is not None:
            counts = [chunk.splats for chunk in trial.chunks]
            room = blank(counts, effective_splats(scores.contribution), fit)
            trial = replace(trial, compensation=room)
        if measured_on or views:
            foreseen = [replace(chunk, quality_db=1.0) for chunk in trial.chunks]
            trial = replace(trial, chunks=foreseen)
        return size_of(trial)

    def finished(encoded: EncodedScene) -> EncodedScene:
        if fitted and scores is not None and references is not None:
            encoded = compensated(encoded, references, scores.contribution, fit, progress=progress)
        if (measured_on or views) and len(encoded.chunks):
            encoded = predicted(
                encoded,
                splats,
                measured_on or views,
                most_views=chosen.prediction_views,
                threads=config.threads,
                progress=progress,
            )
        return encoded

    if target is None or not len(splats):
        encoded = finished(prepared.encode(config.quality_db, progress=progress))
    else:
        aim = target
        while True:
            trial = _at_target(prepared, aim, splats, measured_on or views, room_of, progress)
            encoded = finished(trial)
            over = 0 if target.size_bytes is None else size_of(encoded) - target.size_bytes
            if over <= 0 or aim.size_bytes is None:
                break
            # The order of segments, and with it where index pages end, follows from the fit.
            aim = replace(aim, size_bytes=aim.size_bytes - over)
    return cogs.save(
        Path(path),
        encoded,
        writer=writer,
        first_view=first_view,
        cameras=stored_cameras,
        force=force,
    )


def _planned(
    splats: Splats, config: EncodeConfig, count: int, progress: Progress
) -> tuple[list[Camera], list[Camera]]:
    """Return views of a scene that came without, to score and to measure in.

    There are none where an archive shows nothing.
    """
    from .codec.views.planner import ViewPlanConfig, plan

    try:
        wanted = ViewPlanConfig(views=count, threads=config.threads)
        found = plan(splats, wanted, progress=progress)
        return found.views, found.test_views
    except DataError as error:
        if error.code != "empty-scene" or config.profile != "near-lossless":
            raise
        return [], []


def _at_target(
    prepared: Prepared,
    target: Target,
    splats: Splats,
    views: Sequence[Camera],
    size_of: Callable[[EncodedScene], int],
    progress: Progress,
) -> EncodedScene:
    from .codec.encode.prefix_quality import PrefixEvaluator, decoded
    from .codec.encode.rate_control import TARGET_VIEWS, to_psnr, to_size
    from .codec.views.view_sets import evenly

    if prepared.config.profile == "near-lossless":
        raise ValueError("a target for the profile 'near-lossless', expected a profile for viewing")
    if target.size_bytes is not None:
        return to_size(prepared, target.size_bytes, size_of, progress=progress).encoded
    if not views:
        raise ValueError("a PSNR as target and no cameras, expected views to see it in")
    threads = prepared.config.threads
    evaluator = PrefixEvaluator(splats, evenly(views, TARGET_VIEWS), threads)
    return to_psnr(
        prepared,
        target.psnr_db or 0.0,
        lambda trial: evaluator.psnr_db(decoded(trial, threads=threads)),
        progress=progress,
    ).encoded


def read(path: _Path) -> Splats:
    """Read a scene in any format, COGS included.

    Raises
    ------
    CogsplatError
        The file cannot be read, or is of no known format.
    """
    from .formats.scenes.registry import is_cogs, read_scene

    return decode(path) if is_cogs(path) else read_scene(path)


def write(path: _Path, splats: Splats, *, force: bool = False) -> None:
    """Write a scene in the format that the extension of `path` names; `encode` writes COGS.

    Raises
    ------
    CogsplatError
        The extension names no format that can be written, or the file cannot be.
    """
    from .formats.scenes.registry import write_scene

    write_scene(path, splats, force=force)


def read_cameras(path: _Path) -> list[Camera]:
    """Read cameras from a ``cameras.json``, a ``transforms.json``, COLMAP's folder or a COGS file.

    Raises
    ------
    CogsplatError
        They cannot be read.
    """
    from .formats.cameras.files import read_cameras as read_camera_files

    return read_camera_files(path)
