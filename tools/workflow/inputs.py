"""Inputs of commands: a scene or a part of one, and the cameras to score and to measure in."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatWarning, DataError, LimitError
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.codec.workspace import IN_MEMORY, Zeros
from cogsplat.formats.cogs.between_levels import decode_between
from cogsplat.formats.cogs.open_file import open_source
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.formats.scenes.registry import is_cogs, read_scene, scene_bytes, scene_files
from cogsplat.formats.storage.byte_counts import ByteCount
from cogsplat.formats.storage.source import Source
from cogsplat.tools.terminal.limits import current_limits
from cogsplat.tools.terminal.partial import partial_accepted
from cogsplat.tools.terminal.standard_streams import fetch_if_url, unfetched_url
from cogsplat.tools.terminal.values import ChunkRange

if TYPE_CHECKING:
    from cogsplat.codec.views.planner import ViewPlan

EVAL_CAMERAS: Final = "eval_cameras.json"
"""File of test views beside a scene; splats are not scored in these views."""

EVAL_EVERY: Final = 8
"""Default of ``--eval-every`` in commands that evaluate."""

_FEWEST_TEST_VIEWS: Final = 4

# Three float32 images of this many pixels take 4.5 GiB.
_MAX_VIEW_PIXELS: Final = 1 << 27


@dataclass(frozen=True)
class Selection:
    """The part of a COGS file that options select; at most one of the first three fields is set.

    Parameters
    ----------
    chunks : ChunkRange or None
    least_splats : int or None
        Whole chunks from the first until there are so many splats.
    size : ByteCount or None
        What is complete in the first bytes of the file.
    sh_degree : int or None
    objects : tuple of int or None
        Chunks of these objects alone; `least_splats` counts theirs.
    refine : bool
        Whether refinements are read.
    compensate : bool
        Whether prefix compensation is applied.
    extras : bool
        Whether attributes are read that nothing draws.
    """

    chunks: ChunkRange | None = None
    least_splats: int | None = None
    size: ByteCount | None = None
    sh_degree: int | None = None
    objects: tuple[int, ...] | None = None
    refine: bool = True
    compensate: bool = False
    extras: bool = True
    level: float | None = None

    def __post_init__(self) -> None:
        given = {"--chunks": self.chunks, "--splats": self.least_splats, "--bytes": self.size}
        named = [option for option, value in given.items() if value is not None]
        if len(named) > 1:
            raise click.UsageError(f"{' and '.join(named)}: expected one of them")
        if self.compensate and self.objects is not None:
            raise click.UsageError("--compensate and --object: expected one of them")
        if self.compensate and self.chunks is not None and self.chunks.first:
            raise click.UsageError("--compensate with --chunks, expected chunks from 0 on")
        if self.level is not None and (self.is_cut or self.compensate):
            raise click.UsageError(
                "--level and a part of the file, or --compensate: expected one of them"
            )

    @property
    def is_cut(self) -> bool:
        """Whether splats may be left out."""
        cuts = (self.chunks, self.least_splats, self.size, self.objects)
        return any(x is not None for x in cuts)


@dataclass(frozen=True, eq=False)
class LoadedScene:
    """A scene that was read, with what its file states about it.

    Parameters
    ----------
    splats : Splats
    file_bytes : int
        Of the whole file.
    bytes_read : int
        Of the file's first bytes, those that were looked at.
    chunks : sequence of int
        Chunks decoded; none for foreign scenes.
    file_chunks, file_splats : int
        What the file holds.
    without_tails : tuple of int
        Chunks whose shN is zero because their tails lie beyond the bytes looked at.
    first_view : Camera or None
    lost_extras : tuple of str
        Extra attributes that the file lists and the part does not have for every chunk.
    unrefined : tuple of int
        Chunks whose values are coarse because their refinements lie beyond the bytes looked at.
    """

    splats: Splats
    file_bytes: int
    bytes_read: int
    chunks: Sequence[int]
    file_chunks: int
    file_splats: int
    without_tails: tuple[int, ...]
    first_view: Camera | None
    lost_extras: tuple[str, ...] = ()
    unrefined: tuple[int, ...] = ()


def is_cogs_input(path: Path) -> bool:
    """Whether an input is a COGS file; one by its URL is fetched unless its name says so.

    Raises
    ------
    CogsplatError
        It cannot be read.
    """
    url = unfetched_url(path)
    return (url is not None and path.suffix.lower() == ".cogs") or is_cogs(fetch_if_url(path))


def input_source(path: Path) -> Source:
    """Return what reads ranges of an input, on disk or by its URL.

    Raises
    ------
    CogsplatError
        It cannot be read.
    """
    url = unfetched_url(path)
    return open_source(path if url is None else url)


def read_any(
    path: Path,
    part: Selection | None = None,
    *,
    threads: int = 0,
    zeros: Zeros = IN_MEMORY.zeros,
    progress: Progress = silent,
) -> LoadedScene:
    """Read a scene of any format, COGS included; a PLY into arrays that `zeros` makes.

    Raises
    ------
    click.UsageError
        A part of a foreign scene, which has no chunks.
    CogsplatError
        The file cannot be read.
    """
    part = part or Selection()
    if is_cogs_input(path):
        return decode_part(path, part, threads=threads, progress=progress)
    if part.is_cut or part.compensate:
        raise click.UsageError(
            f"{path}: is no COGS file, expected one with --chunks, --splats, --bytes, --object "
            "or --compensate"
        )
    splats = read_scene(path, limits=current_limits(), zeros=zeros)
    size = scene_bytes(path)
    rows = len(splats)
    if part.sh_degree is not None:
        splats = splats.with_sh_degree(part.sh_degree)
    return LoadedScene(splats, size, size, range(0), 0, rows, (), None)


Decode = Callable[[CogsFile, Sequence[int]], Splats]
"""Decodes chunks of a file; what it returns may have no rows where these went elsewhere."""


def decode_part(
    path: Path, part: Selection, *, threads: int = 0, progress: Progress = silent
) -> LoadedScene:
    """Decode a COGS file or a part of it.

    Raises
    ------
    click.UsageError
        A range of chunks, or an object, that the file does not have.
    CogsplatError
        The file cannot be read or breaks SPEC.
    """

    def whole(file: CogsFile, chunks: Sequence[int]) -> Splats:
        if part.level is not None:
            try:
                return decode_between(
                    file,
                    part.level,
                    sh_degree=part.sh_degree,
                    refine=part.refine,
                    extras=part.extras,
                    threads=threads,
                    progress=progress,
                )
            except ValueError as error:
                raise click.UsageError(f"--{error}") from error
        return file.decode(
            chunks,
            sh_degree=part.sh_degree,
            refine=part.refine,
            extras=part.extras,
            compensate=part.compensate,
            threads=threads,
            progress=progress,
        )

    return decode_part_with(whole, path, part)


def decode_part_with(decode: Decode, path: Path, part: Selection) -> LoadedScene:
    """Have a COGS file or a part of it decoded, and say what its file states.

    Raises
    ------
    click.UsageError, CogsplatError
        As `decode_part`.
    """
    source = input_source(path)
    size_bytes = None if part.size is None else part.size.of(source.size)
    with cogsplat.open(
        source, partial=partial_accepted(), size_bytes=size_bytes, limits=current_limits()
    ) as file:
        try:
            chunks = file.select(
                chunks=None if part.chunks is None else (part.chunks.first, part.chunks.last),
                objects=part.objects,
                splats=part.least_splats,
            )
        except ValueError as error:
            # Its message begins with the name of the condition, which is the option's.
            raise click.UsageError(f"--{error}") from error
        splats = decode(file, chunks)
        if not file.complete_chunks() and file.source_bytes < file.file_length:
            warnings.warn(
                f"{path}: no chunk is complete in the first {file.source_bytes} bytes",
                CogsplatWarning,
                stacklevel=2,
            )
        missing = [chunk for chunk in chunks if not file.has_tail(chunk, splats.sh_degree)]
        return LoadedScene(
            splats=splats,
            file_bytes=file.file_length,
            bytes_read=file.source_bytes,
            chunks=chunks,
            file_chunks=file.num_chunks,
            file_splats=file.root.splats,
            without_tails=tuple(missing) if splats.sh_degree else (),
            first_view=file.root.first_view,
            lost_extras=tuple(
                kind.name
                for kind in file.root.attributes
                if part.extras and kind.name not in splats.extras
            ),
            unrefined=tuple(chunk for chunk in chunks if not file.has_refinement(chunk)),
        )


def input_files(scene: Path, *others: Path | None) -> Iterator[Path]:
    """Yield the files that a command reads, which its outputs may not be.

    Parameters
    ----------
    scene : Path
        The files that it names beside it are yielded as well.
    others : Path or None
        Files, and folders of which all files are yielded: cameras, photos, masks.
    """
    yield scene
    if scene.is_dir():
        yield from (inner for inner in scene.rglob("*") if inner.is_file())
    elif not is_cogs(scene):
        yield from scene_files(scene)
    for path in others:
        if path is not None and path.is_dir():
            yield from (inner for inner in path.rglob("*") if inner.is_file())
        elif path is not None:
            yield path


def drop_invalid_splats(splats: Splats, where: Path) -> Splats:
    """Return the rows whose values are finite, with a warning where some are not.

    Raises
    ------
    DataError
        ``no-valid-rows``: it leaves none.
    """
    bad = splats.invalid_rows()
    count = int(bad.sum())
    if not count:
        return splats
    if count == len(splats):
        raise DataError(
            "no-valid-rows", f"{where}: none of {count} splats can be drawn, expected some"
        )
    warnings.warn(
        f"{where}: {count:,} of {len(splats):,} splats hold NaN, infinite values or a zero "
        "quaternion and are left out",
        CogsplatWarning,
        stacklevel=2,
    )
    return splats.take(~bad)


def load_cameras(path: Path) -> list[Camera]:
    """Read cameras, and refuse those too large to render.

    Raises
    ------
    LimitError
        ``view-size``.
    CogsplatError
        They cannot be read.
    """
    cameras = cogsplat.read_cameras(path, limits=current_limits())
    for camera in cameras:
        if camera.width * camera.height > _MAX_VIEW_PIXELS:
            raise LimitError(
                "view-size",
                f"{path}: camera {camera.name!r} has {camera.width}x{camera.height} pixels, "
                f"expected at most {_MAX_VIEW_PIXELS} in all",
            )
    return cameras


def scoring_cameras(path: Path | None, every: int) -> list[Camera] | None:
    """Return the cameras to score on, without those held out; None where none are given."""
    if path is None:
        return None
    train, held = hold_out(load_cameras(path), every)
    if not train:
        raise click.UsageError(
            f"--eval-every {every} holds out all {len(held)} cameras of {path}, "
            "expected some to score on"
        )
    return train


def target_cameras(cameras: Sequence[Camera], every: int) -> list[Camera]:
    """Return the cameras that a target PSNR is measured in, near the test views but not of them.

    Parameters
    ----------
    cameras : sequence of Camera
        All that were given, in file order.
    every : int
        Cameras held out; the target is measured in their neighbours in the file, not in them.
        Where none are held out, it is measured in every eighth, the default of `compare`.

    Returns
    -------
    list of Camera
        All that are not held out where these would be too few.
    """
    if every:
        allowed, _ = hold_out(cameras, every)
        last = len(cameras) - 1
        beside = {row + side for row in range(0, len(cameras), every) for side in (-1, 1)}
        found = [cameras[row] for row in sorted(beside) if 0 <= row <= last and row % every]
    else:
        allowed = list(cameras)
        _, found = hold_out(cameras, EVAL_EVERY)
    return found if len(found) >= _FEWEST_TEST_VIEWS else allowed


def plan_views(splats: Splats, *, threads: int = 0, progress: Progress = silent) -> ViewPlan:
    """Plan views, and others to test in, of a scene that came without cameras.

    Raises
    ------
    DataError
        ``empty-scene``.
    """
    from cogsplat.codec.views.planner import ViewPlanConfig, plan

    return plan(splats, ViewPlanConfig(threads=threads), progress=progress)


def plan_cameras(splats: Splats, *, threads: int = 0, progress: Progress = silent) -> list[Camera]:
    """Plan the views of a scene that came without cameras; see `plan_views`."""
    found = plan_views(splats, threads=threads, progress=progress)
    return found.views + found.covering_views


def evaluation_cameras(
    reference: Path,
    splats: Splats,
    path: Path | None,
    every: int,
    *,
    planned: Sequence[Camera] | None = None,
    threads: int = 0,
    progress: Progress = silent,
) -> tuple[Sequence[Camera], str]:
    """Return the test views, and a phrase that says where they come from.

    Parameters
    ----------
    reference : Path
        The scene's file; ``eval_cameras.json`` beside it is used, all of it, where no cameras are
        given.
    splats : Splats
        The scene, for virtual views where there are no cameras at all.
    path : Path or None
        Cameras given.
    every : int
        Of cameras given and of virtual views, those with ``index % every == 0``; 0 for all.
    planned : sequence of Camera, optional
        The virtual views, where they are there already.
    threads, progress
        As in `plan_cameras`.
    """
    beside = reference.parent / EVAL_CAMERAS
    if path is not None:
        cameras: Sequence[Camera] = load_cameras(path)
        what = f"cameras of {path}"
    elif beside.is_file():
        return load_cameras(beside), f"cameras of {beside}"
    else:
        what = "virtual views"
        cameras = planned or plan_cameras(splats, threads=threads, progress=progress)
    return (hold_out(cameras, every)[1] if every else cameras), what
