"""Inputs of commands: a scene or a part of it, cameras to score in, cameras to measure in."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
import numpy as np
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatWarning, DataError, LimitError
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import hold_out, left_out_every
from cogsplat.codec.workspace import IN_MEMORY, Zeros
from cogsplat.formats.cogs.between_levels import decode_between
from cogsplat.formats.cogs.open_file import open_source
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.formats.scenes.registry import is_cogs, read_scene, scene_bytes
from cogsplat.formats.storage.atomic import is_file
from cogsplat.formats.storage.byte_counts import ByteCount
from cogsplat.formats.storage.source import Source
from cogsplat.tools.terminal.limits_option import current_limits
from cogsplat.tools.terminal.partial import partial_accepted
from cogsplat.tools.terminal.standard_streams import fetch_if_url, unfetched_url
from cogsplat.tools.terminal.values import ChunkRange

if TYPE_CHECKING:
    from cogsplat.codec.views.planner import ViewPlan

EVAL_CAMERAS: Final = "eval_cameras.json"
"""Name of the file of test views in the folder of a scene; splats are not scored in them."""

# Three float32 images of this many pixels take 4.5 GiB.
_MAX_VIEW_PIXELS: Final = 1 << 27


@dataclass(frozen=True)
class Selection:
    """Part of a COGS file to read; at most one of `chunks`, `least_splats` and `size` is set.

    Parameters
    ----------
    chunks : ChunkRange or None
        Range of chunks.
    least_splats : int or None
        Minimum number of splats: the first chunks that hold this number are read. With `objects`,
        only splats of these objects count.
    size : ByteCount or None
        Length of the file's prefix, whose complete chunks are read.
    sh_degree : int or None
        Highest SH degree.
    objects : tuple of int or None
        Labels of the objects whose chunks are read.
    refine : bool
        Whether refinements are read.
    compensate : bool
        Whether prefix compensation is applied.
    extras : bool
        Whether attributes without effect on the picture are read.
    level : float or None
        Level of a scene with levels; a fraction lies between two levels.
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
        """Whether the selection may leave out splats."""
        cuts = (self.chunks, self.least_splats, self.size, self.objects)
        return any(x is not None for x in cuts)


@dataclass(frozen=True, eq=False)
class LoadedScene:
    """A scene that was read, with facts about its file.

    Parameters
    ----------
    splats : Splats
    file_bytes : int
        Bytes of the whole file.
    bytes_read : int
        Bytes of the file's prefix that was read.
    chunks : sequence of int
        Numbers of the decoded chunks; empty for formats other than COGS.
    file_chunks, file_splats : int
        Chunks and splats of the whole file.
    without_tails : tuple of int
        Numbers of the chunks whose shN is zero because their tails were not read.
    first_view : Camera or None
        View to show first, as stored in the file.
    up : (3,) float64 or None
        Unit vector against gravity, as stored in the file.
    lost_extras : tuple of str
        Extra attributes of the file that some of the decoded chunks lack.
    unrefined : tuple of int
        Numbers of the chunks whose values are coarse because their refinements were not read.
    """

    splats: Splats
    file_bytes: int
    bytes_read: int
    chunks: Sequence[int]
    file_chunks: int
    file_splats: int
    without_tails: tuple[int, ...]
    first_view: Camera | None
    up: NDArray[np.float64] | None = None
    lost_extras: tuple[str, ...] = ()
    unrefined: tuple[int, ...] = ()


def is_cogs_input(path: Path) -> bool:
    """Whether an input is a COGS file. A URL is fetched unless it ends in ``.cogs``.

    Raises
    ------
    CogsplatError
        The input cannot be read.
    """
    url = unfetched_url(path)
    return (url is not None and path.suffix.lower() == ".cogs") or is_cogs(fetch_if_url(path))


def input_source(path: Path) -> Source:
    """Return a source of byte ranges of an input, from disk or from its URL.

    Raises
    ------
    CogsplatError
        The input cannot be read.
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
    """Read a scene of any format, COGS included; `zeros` allocates the arrays of a PLY.

    Raises
    ------
    click.UsageError
        `part` selects chunks of a scene that has none.
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
"""Function that decodes chunks of a file; its result is empty if it writes the splats itself."""


def decode_part(
    path: Path, part: Selection, *, threads: int = 0, progress: Progress = silent
) -> LoadedScene:
    """Decode a COGS file or a part of it.

    Raises
    ------
    click.UsageError
        The file lacks the selected chunks or objects.
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
    """Decode a COGS file or a part of it with a function, and return facts about the file.

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
            # The message begins with the name of the parameter, which is the name of the option.
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
            up=file.root.up,
            lost_extras=tuple(
                kind.name
                for kind in file.root.attributes
                if part.extras and kind.name not in splats.extras
            ),
            unrefined=tuple(chunk for chunk in chunks if not file.has_refinement(chunk)),
        )


def drop_invalid_splats(splats: Splats, where: Path) -> Splats:
    """Return the splats that can be drawn; warn if any were dropped.

    Splats with NaN, infinite values or a zero quaternion are dropped.

    Parameters
    ----------
    splats : Splats
    where : Path
        Path of the scene, for messages.

    Raises
    ------
    DataError
        ``no-valid-rows``: no splat is left.
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
    """Read cameras; refuse a camera whose picture is too large to render.

    Raises
    ------
    LimitError
        ``view-size``: a camera has too many pixels.
    CogsplatError
        The cameras cannot be read.
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
    """Return the cameras to score in, without held-out cameras; None without a file of cameras."""
    if path is None:
        return None
    train, held = hold_out(load_cameras(path), every)
    if not train:
        raise click.UsageError(
            f"--eval-every {every} holds out all {len(held)} cameras of {path}, "
            "expected some to score on"
        )
    return train


def plan_views(splats: Splats, *, threads: int = 0, progress: Progress = silent) -> ViewPlan:
    """Plan the views to score in and the test views of a scene without cameras.

    Raises
    ------
    DataError
        ``empty-scene``.
    """
    from cogsplat.codec.views.planner import ViewPlanConfig, plan

    return plan(splats, ViewPlanConfig(threads=threads), progress=progress)


def plan_cameras(splats: Splats, *, threads: int = 0, progress: Progress = silent) -> list[Camera]:
    """Return the planned scoring cameras of a scene without cameras, covering views included."""
    found = plan_views(splats, threads=threads, progress=progress)
    return found.views + found.covering_views


def evaluation_cameras(
    reference: Path,
    splats: Splats,
    path: Path | None,
    every: int | None,
    *,
    planned: Sequence[Camera] | None = None,
    threads: int = 0,
    progress: Progress = silent,
) -> tuple[Sequence[Camera], str]:
    """Return the test views and their description for output.

    The first existing source is used: the cameras of `path`, all of ``eval_cameras.json``, the
    views of `planned`, or test views planned for `splats` as in an encode without cameras.

    Parameters
    ----------
    reference : Path
        File of the scene, next to which ``eval_cameras.json`` may be.
    splats : Splats
        Scene, for planning test views.
    path : Path or None
        File of cameras.
    every : int or None
        Every n-th camera of `path` or `planned` is a test view; 0 takes all of these cameras. None
        takes those that `view_sets.leave_out` leaves out.
    planned : sequence of Camera, optional
        Planned scoring views.
    threads : int
        Number of threads that plan views; 0 for all cores.
    progress : Progress
        Receives the stages of planning.
    """
    beside = reference.parent / EVAL_CAMERAS
    if path is not None:
        cameras: Sequence[Camera] = load_cameras(path)
        what = f"cameras of {path}"
    elif is_file(beside):
        return load_cameras(beside), f"cameras of {beside}"
    elif planned is None:
        tests = plan_views(splats, threads=threads, progress=progress).test_views
        return tests, "views planned around the scene"
    else:
        cameras, what = planned, "planned views"
    if every is None:
        every = left_out_every(len(cameras))
    return (hold_out(cameras, every)[1] if every else cameras), what
