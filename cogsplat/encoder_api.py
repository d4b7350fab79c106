"""Facade functions that need the extra ``encode``: encode, tune, layers, compare, render, score."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .codec.cameras import Camera
from .codec.encode.config import EncodeConfig, Target
from .codec.encode.request import EncodeRequest
from .codec.errors import DataError
from .codec.geometry.rotations import normalise_extremes
from .codec.progress import OverallProgress, Progress, TimedProgress, silent
from .codec.splats import Splats
from .codec.workspace import IN_MEMORY, Workspace
from .formats.cameras.camera_files import read_cameras
from .formats.cogs.camera_segment import check_cameras
from .formats.cogs.description import Description
from .formats.cogs.metadata import FileMetadata
from .formats.cogs.open_file import open_scene
from .formats.scenes.input_files import input_files
from .formats.scenes.memory_cap import working_memory
from .formats.scenes.registry import is_cogs, read_scene, scene_bytes
from .formats.storage.atomic import check_output
from .formats.storage.byte_counts import parse_byte_count

if TYPE_CHECKING:
    from .codec.encode.encoded import EncodedScene, EncodeReport
    from .codec.encode.preview_chunks import PreviewMaker
    from .codec.fit.train_config import LevelsConfig
    from .codec.fit.tune_config import TuneConfig
    from .codec.scoring.contribution import Scores
    from .codec.scoring.score_config import ScoreConfig
    from .codec.scoring.view_quality import Comparison

_Path = str | os.PathLike[str]


def encode(
    scene: Splats | _Path,
    path: _Path,
    *,
    cameras: Sequence[Camera] | _Path | None = None,
    quality: float | None = None,
    target: Target | int | str | None = None,
    preset: str | None = None,
    config: EncodeConfig | None = None,
    request: EncodeRequest | None = None,
    description: Description | None = None,
    force: bool = False,
    progress: Progress = silent,
) -> EncodeReport:
    """Encode a scene into a COGS file.

    Parameters
    ----------
    scene : Splats or path
        Scene in memory, or a file of any known format.
    path : path
        Output file; it appears once it is complete.
    cameras : sequence of Camera or path, optional
        Views to score in, or a file for `read_cameras`. Without them views are planned around the
        splats.
    quality : float, optional
        Nominal PSNR, dB; it replaces `EncodeConfig.quality_db`.
    target : Target, int or str, optional
        File size to fill, as bytes or as text such as ``"500KiB"``, ``"12MB"`` or ``"20%"`` of the
        scene's bytes; or mean PSNR in the test views, such as ``"38dB"``.
    preset : str, optional
        ``fast``, ``balanced`` (the default) or ``best``: numbers of views, effort of ordering and
        of compensation.
    config : EncodeConfig, optional
        Contents of the file: profile, order, chunks, preview splats, threads and more.
    request : EncodeRequest, optional
        Inputs that are needed rarely: scores, test views, stored cameras, memory limit, executor.
        The other arguments replace its fields.
    description : Description, optional
        Description of the scene, with the files of its pictures. None for that of `scene`, where
        it is a COGS file.
    force : bool
        Replace an existing file.
    progress : Progress
        Called with a stage, its number of finished steps and its total number of steps. An
        `OverallProgress` receives the expected costs of the stages first. Raising `Cancelled` stops
        the work without a file.

    Returns
    -------
    EncodeReport
        Size of the file, time of every stage, views, and predicted quality.

    Raises
    ------
    CogsplatError
        The scene or the cameras cannot be used, the target is out of reach, or the file cannot be
        written.
    ValueError
        Arguments that contradict each other: see `EncodeRequest` and `EncodeConfig`.

    Examples
    --------
    >>> import cogsplat
    >>> report = cogsplat.encode("scene.ply", "new.cogs", cameras="cameras.json", preset="fast")
    >>> len(cogsplat.decode("new.cogs", size_bytes=report.size_bytes)) > 0
    True
    """
    from .codec.encode import pipeline
    from .codec.encode.capture_of_request import with_capture_of
    from .codec.encode.look_of_request import find_look_of
    from .codec.encode.stage_costs import stage_costs

    _require_output(path, force, scene, cameras)
    if quality is not None and target is not None:
        raise ValueError("more than one of quality and target, expected one of them")
    request = request or EncodeRequest()
    config = config or request.config
    request = replace(
        request,
        cameras=request.cameras if cameras is None else _views(cameras),
        target=request.target if target is None else _target(target, scene),
        preset=preset or request.preset,
        config=config if quality is None else replace(config, quality_db=quality),
    )
    if request.stored_cameras:
        check_cameras(request.stored_cameras)
    memory: AbstractContextManager[Workspace] = nullcontext(request.workspace)
    if request.memory_bytes is not None:
        folder = Path(path).absolute().parent
        memory = working_memory(scene, request.config, request.memory_bytes, folder)
    with memory as workspace:
        request = replace(request, workspace=workspace)
        splats = _splats(scene, workspace)
        if isinstance(progress, OverallProgress):
            progress.plan(stage_costs(len(splats), request))
        look, request = find_look_of(splats, _with_stored_look(request, scene))
        splats = with_capture_of(splats, request, look)
        described = _description_of(scene) if description is None else description
        metadata = FileMetadata(look, request.stored_cameras, described)
        encoded = pipeline.encode(
            splats,
            request,
            size_of=metadata.file_bytes,
            preview=_preview_maker(request.config),
            progress=progress,
        )
        writing = TimedProgress()
        size_bytes = metadata.save(encoded, Path(path), force=force)
    writing("write", 1, 1)
    if isinstance(progress, OverallProgress):
        progress.finish()
    report = encoded.report
    return replace(
        report,
        size_bytes=size_bytes,
        seconds={**report.seconds, **writing.seconds},
        cpu_seconds={**report.cpu_seconds, **writing.cpu_seconds},
    )


def tune(
    scene: Splats | _Path,
    path: _Path,
    *,
    cameras: Sequence[Camera] | _Path | None = None,
    target: Target | int | str = "40dB",
    shown_at: int | None = None,
    config: TuneConfig | None = None,
    force: bool = False,
    progress: Progress = silent,
) -> EncodeReport:
    """Prune and train a scene for a target size or PSNR, and encode it into a COGS file.

    Parameters
    ----------
    scene, path, force, progress
        Scene, output file and progress, as in `encode`.
    cameras : sequence of Camera or path, optional
        Views to train in, or a file for `read_cameras`. Without them views are planned.
    target : Target, int or str
        File size or PSNR, as in `encode`; the PSNR is against renders of the source.
    shown_at : int, optional
        Width, px, of the pictures that the file is made for; by default that of the cameras.
    config : TuneConfig, optional
        Steps of training, preset and profile.

    Returns
    -------
    EncodeReport
        Size of the file, and PSNR against renders of the source in the test views.

    Raises
    ------
    CogsplatError
        As in `encode`.

    Examples
    --------
    >>> import cogsplat
    >>> config = cogsplat.TuneConfig(
    ...     keep=0.5, round_steps=1, recovery_steps=1, quantised_steps=1
    ... )
    >>> report = cogsplat.tune(
    ...     "scene.ply", "tuned.cogs", cameras="cameras.json", target="60%", config=config
    ... )
    >>> len(cogsplat.decode("tuned.cogs")) < len(cogsplat.read("scene.ply"))
    True
    """
    from .codec.fit import tuning
    from .codec.fit.tune_config import TuneConfig, TuneRequest
    from .codec.fit.tuning_views import choose_tuning_views
    from .codec.views.first_look_search import find_first_look

    _require_output(path, force, scene, cameras)
    config = config or TuneConfig()
    given = None if cameras is None else _views(cameras)
    splats = _splats(scene).without_extras()
    views = choose_tuning_views(
        splats, given, shown_at=shown_at, threads=config.train.threads, progress=progress
    )
    request = TuneRequest(views, _target(target, scene), config)
    look = find_first_look(splats, given, threads=config.train.threads)
    metadata = FileMetadata(look, description=_description_of(scene))
    tuned = tuning.tune(splats, request, size_of=metadata.file_bytes, progress=progress)
    return _save(tuned.encoded, metadata, path, force)


def layers(
    scene: Splats | _Path,
    path: _Path,
    *,
    cameras: Sequence[Camera] | _Path | None = None,
    quality: float | None = None,
    config: LevelsConfig | None = None,
    force: bool = False,
    progress: Progress = silent,
) -> EncodeReport:
    """Train levels of detail of a scene, for several picture sizes, and write one COGS file.

    Parameters
    ----------
    scene, path, cameras, force, progress
        Scene, output file, training views and progress, as in `tune`.
    quality : float, optional
        Nominal PSNR, dB; it replaces `LevelsConfig.quality_db`.
    config : LevelsConfig, optional
        Scales, sizes and training steps of the levels.

    Returns
    -------
    EncodeReport
        Size of the file.

    Raises
    ------
    CogsplatError
        As in `encode`.

    Examples
    --------
    >>> import cogsplat
    >>> config = cogsplat.LevelsConfig(scales=(2, 1), shares=(0.5, 1.0), steps=1)
    >>> report = cogsplat.layers("scene.ply", "levels.cogs", cameras="cameras.json", config=config)
    >>> len(cogsplat.decode("levels.cogs", level=0)) < len(cogsplat.decode("levels.cogs"))
    True
    """
    from .codec.fit.level_encoding import make_levels
    from .codec.fit.train_config import LevelsConfig, LevelsRequest
    from .codec.views.first_look_search import find_first_look
    from .codec.views.planner import ViewPlanConfig, plan

    _require_output(path, force, scene, cameras)
    config = config or LevelsConfig()
    if quality is not None:
        config = replace(config, quality_db=quality)
    splats = _splats(scene).without_extras()
    if cameras is None:
        planned = plan(splats, ViewPlanConfig(threads=config.threads), progress=progress)
        views: Sequence[Camera] = planned.views + planned.covering_views
    else:
        views = _views(cameras)
    request = LevelsRequest(views, config, planned=cameras is None)
    encoded = make_levels(splats, request, progress=progress)
    given = None if cameras is None else views
    look = find_first_look(splats, given, threads=config.threads)
    return _save(encoded, FileMetadata(look, description=_description_of(scene)), path, force)


def compare(
    reference: Splats | _Path,
    other: Splats | _Path,
    cameras: Sequence[Camera] | _Path | None = None,
    *,
    threads: int = 0,
    progress: Progress = silent,
) -> Comparison:
    """Measure PSNR and SSIM between renders of two scenes.

    Parameters
    ----------
    reference, other : Splats or path
        Scenes in memory, or files of any known format.
    cameras : sequence of Camera or path, optional
        Test views, or a file for `read_cameras`. Without them, the test views that `encode` plans
        for `reference`. Some are measured close up as well. Two views off the capture path are
        measured for each: one moved back, one rotated.
    threads : int
        Number of threads, 0 for all cores.
    progress : Progress
        Called with the stages ``plan views``, ``test``, ``close`` and ``roam``.

    Examples
    --------
    >>> import cogsplat
    >>> found = cogsplat.compare("scene.ply", "scene.cogs", "cameras.json")
    >>> 20 < found.worst.psnr_db < 100
    True
    """
    from .codec.scoring import view_quality

    splats = _splats(reference)
    views: Sequence[Camera]
    if cameras is None:
        from .codec.views.planner import ViewPlanConfig, plan

        views = plan(splats, ViewPlanConfig(threads=threads), progress=progress).test_views
    else:
        views = _views(cameras)
    return view_quality.compare(splats, _splats(other), views, threads=threads, progress=progress)


def render(
    scene: Splats | _Path,
    camera: Camera | None = None,
    *,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    threads: int = 0,
) -> NDArray[np.float32]:
    """Render a scene and return the picture, (height, width, 3), RGB, unclamped.

    Parameters
    ----------
    scene : Splats or path
        Scene in memory, or a file of any known format.
    camera : Camera, optional
        View to render; by default the first view of the file, or one chosen by what it shows.
    background : tuple of float
        RGB behind the splats, each 0 to 1.
    threads : int
        Number of threads, 0 for all cores.

    Examples
    --------
    >>> import cogsplat
    >>> cogsplat.render("scene.cogs", cogsplat.read_cameras("cameras.json")[0]).shape
    (48, 64, 3)

    Raises
    ------
    DataError
        ``empty-scene``: no camera is given, and no splat can be drawn.
    """
    from .codec.render.rasteriser import RenderConfig
    from .codec.render.rasteriser import render as rasterise

    splats = _splats(scene)
    camera = camera or _first_view(scene, splats, threads)
    config = RenderConfig(background=background, threads=threads)
    return rasterise(splats, camera, config)


def score(
    scene: Splats | _Path,
    cameras: Sequence[Camera] | _Path,
    *,
    config: ScoreConfig | None = None,
    progress: Progress = silent,
) -> Scores:
    """Measure the contribution of each splat to the pictures of some views.

    Parameters
    ----------
    scene : Splats or path
        Scene in memory, or a file of any known format.
    cameras : sequence of Camera or path
        Views to score in, or a file for `read_cameras`.
    config : ScoreConfig, optional
        Selection of blending weights, jittered copies of the views, device.
    progress : Progress
        Called with the stage ``score``.

    Examples
    --------
    >>> import cogsplat
    >>> scores = cogsplat.score("scene.ply", "cameras.json")
    >>> scores.contribution.shape == (len(cogsplat.read("scene.ply")),)
    True
    """
    from .codec.scoring.contribution import score as score_in
    from .codec.scoring.score_config import ScoreConfig

    config = config or ScoreConfig()
    return score_in(_splats(scene), _views(cameras), config, progress=progress)


def _first_view(scene: Splats | _Path, splats: Splats, threads: int) -> Camera:
    """Return the stored first view of a file, else the best view that the search finds."""
    from .codec.views.first_look_search import find_first_look

    if not isinstance(scene, Splats) and is_cogs(scene):
        with open_scene(scene) as file:
            if file.root.first_view is not None:
                return file.root.first_view
    found = find_first_look(splats, threads=threads).view
    if found is None:
        raise DataError("empty-scene", "no splat that can be drawn, expected a camera")
    return found


def _require_scene(scene: object) -> None:
    """Raise TypeError unless a scene is `Splats` or a path."""
    if not isinstance(scene, Splats | str | os.PathLike):
        raise TypeError(f"a {type(scene).__name__}, expected Splats or the path of a scene")


def _require_output(path: _Path, force: bool, *inputs: object) -> None:
    """Refuse an output that exists without `force`, is an input, or cannot be written."""
    _require_scene(inputs[0])
    paths = [Path(given) for given in inputs if isinstance(given, str | os.PathLike)]
    check_output(path, force=force, inputs=chain.from_iterable(map(input_files, paths)))


def _splats(scene: Splats | _Path, workspace: Workspace | None = None) -> Splats:
    """Return a scene, read from its file where a path is given; `workspace` stores its arrays.

    Extreme quaternions are normalised, as `read_scene` does.
    """
    if isinstance(scene, Splats):
        return normalise_extremes(scene)
    if is_cogs(scene):
        with open_scene(scene) as file:
            return file.decode()
    return read_scene(scene, zeros=(workspace or IN_MEMORY).zeros)


def _with_stored_look(request: EncodeRequest, scene: Splats | _Path) -> EncodeRequest:
    """Return a request with what it lacks of the stored look, if the scene is a COGS file."""
    if isinstance(scene, Splats) or not is_cogs(scene):
        return request
    with open_scene(scene) as file:
        return request.with_stored_look(file.root.up, file.root.first_view)


def _description_of(scene: Splats | _Path) -> Description | None:
    """Return the description of a COGS file; None for a scene in memory or of another format."""
    if isinstance(scene, Splats) or not is_cogs(scene):
        return None
    with open_scene(scene) as file:
        return file.description(pictures=True)


def _views(cameras: Sequence[Camera] | _Path) -> Sequence[Camera]:
    """Return cameras, read from their file where a path is given."""
    return read_cameras(cameras) if isinstance(cameras, str | os.PathLike) else cameras


def _save(encoded: EncodedScene, metadata: FileMetadata, path: _Path, force: bool) -> EncodeReport:
    """Write a trained scene into a file; return the report with the size of the file."""
    return replace(encoded.report, size_bytes=metadata.save(encoded, Path(path), force=force))


def _preview_maker(config: EncodeConfig) -> PreviewMaker | None:
    """Return the trainer of preview splats, where a configuration has a preview."""
    if config.preview is None:
        return None
    from .codec.fit.preview_training import PreviewConfig, TrainedPreview

    return TrainedPreview(PreviewConfig(share=config.preview, threads=config.threads))


def _target(target: Target | int | str, scene: Splats | _Path) -> Target:
    """Return a target given as bytes, or as text of bytes, a share or a PSNR."""
    if isinstance(target, Target):
        return target
    if isinstance(target, int):
        return Target(size_bytes=target)
    number = target.strip().lower().removesuffix("db")
    if number != target.strip().lower():
        return Target(psnr_db=float(number))
    source_bytes = scene.nbytes if isinstance(scene, Splats) else scene_bytes(scene)
    return Target(size_bytes=parse_byte_count(target).uncapped(source_bytes))
