"""Rate-distortion benchmark: bytes, seconds and PSNR of COGS profiles and foreign formats."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatError
from cogsplat.codec.metrics import PSNR_CAP_DB
from cogsplat.codec.progress import Progress, StageCost, silent
from cogsplat.codec.scoring import view_quality
from cogsplat.codec.splats import Splats
from cogsplat.formats.scenes.registry import FORMATS, Format, read_scene
from cogsplat.tools.evaluation.measuring_costs import comparison_costs
from cogsplat.tools.evaluation.photos import Photos
from cogsplat.tools.terminal.standard_streams import set_display_name

if TYPE_CHECKING:
    from cogsplat.codec.encode.config import EncodeConfig
    from cogsplat.codec.encode.encoded import EncodeReport
    from cogsplat.codec.scoring.contribution import Scores

BASELINE: Final = "c3dgs-style npz"
"""Name of the comparison with Niedermayr et al. (`baseline_npz`)."""

FOREIGN: Final = (*(format_.name for format_ in FORMATS if format_.write), BASELINE)
"""Names of the formats that COGS is compared with."""

TUNED: Final = {"transform": "transform, tuned", "vq": "vq, tuned"}
"""Names of the methods that tune the scene before it is stored, by profile."""

# Default nominal qualities of each profile, dB. `vq` is for comparison.
QUALITIES: Final = {
    "transform": (30.0, 34.0, 38.0, 42.0, 46.0, 50.0),
    "vq": (26.0, 34.0, 42.0),
}

# Default target PSNRs of tuned files, dB: each takes minutes.
_TUNED_QUALITIES: Final = (34.0, 37.0, 40.0)

# Cost of tuning a file in encodes of it, as measured on a captured room.
_ENCODES_PER_TUNING: Final = 15.0

_FIRST_PREFIX: Final = 32 << 10

# Number of prefixes assumed in cost estimates: 32 KiB to 512 KiB.
_PREFIXES: Final = 5

# Number of timed reads; the fastest counts, because the first read loads code.
_READS: Final = 2


@dataclass(frozen=True, eq=False)
class BenchInput:
    """Input of a benchmark: a scene, its scores, and the views to measure in.

    Parameters
    ----------
    splats : Splats
        Valid rows, at least one.
    scores : Scores
        Scores from the training views.
    score_s : float
        Scoring time, s; counted in the encoding time of COGS and of the baseline.
    cameras : sequence of Camera
        Test views.
    scored_on : sequence of Camera
        Training views, given or planned.
    tuned_in : sequence of Camera or None
        Cameras that tuned files train in; None plans views for it.
    photos : Photos or None
        Photos of the test views.
    background : tuple of float
        RGB behind the splats.
    threads : int
    """

    splats: Splats
    scores: Scores
    score_s: float
    cameras: Sequence[Camera]
    scored_on: Sequence[Camera]
    tuned_in: Sequence[Camera] | None
    photos: Photos | None
    background: tuple[float, float, float]
    threads: int


def _label(method: str, quality_db: float | None) -> str:
    """Return the name of a method and its nominal quality, if any."""
    return method if quality_db is None else f"{method} {quality_db:g}"


@dataclass(frozen=True)
class _Measured:
    """Method that a figure was measured for.

    Parameters
    ----------
    method : str
        Profile or foreign format.
    quality_db : float or None
        Nominal quality; None if the method has none.
    """

    method: str
    quality_db: float | None

    @property
    def label(self) -> str:
        """Method and nominal quality."""
        return _label(self.method, self.quality_db)

    def report(self) -> dict[str, object]:
        """Return the figures for CSV and JSON output."""
        figures = asdict(self)
        renamed = {"file_bytes": "bytes", "prefix_bytes": "bytes"}
        return {renamed.get(name, name): figure for name, figure in figures.items()}


@dataclass(frozen=True)
class Row(_Measured):
    """Size, time and quality of the scene written by one method.

    Parameters
    ----------
    method, quality_db
        Profile or foreign format, and its nominal quality if any.
    refused : str
        Reason code if the format cannot store the scene; all figures are 0 then.
    file_bytes : int
    bytes_per_splat : float
        File bytes per splat of the source, including pruned splats.
    held_out_db, worst_db, roam_db : float
        PSNR against renders of the source, at most 100 dB: mean over the held-out views, worst
        view, and mean over the roam views.
    held_out_ssim, worst_ssim, roam_ssim : float
        SSIM in the same views.
    photos_db, photo_loss_db : float or None
        PSNR against photos of the held-out views, and its distance below the source's PSNR.
    encode_s, decode_s : float
        Time from arrays to a file, with scoring, and from the file to arrays, s.
    """

    refused: str = ""
    file_bytes: int = 0
    bytes_per_splat: float = 0.0
    held_out_db: float = 0.0
    held_out_ssim: float = 0.0
    worst_db: float = 0.0
    worst_ssim: float = 0.0
    roam_db: float = 0.0
    roam_ssim: float = 0.0
    photos_db: float | None = None
    photo_loss_db: float | None = None
    encode_s: float = 0.0
    decode_s: float = 0.0

    @property
    def is_cogs(self) -> bool:
        """Whether the method is a profile of COGS."""
        return self.method not in FOREIGN

    @property
    def is_identical(self) -> bool:
        """Whether the held-out views equal renders of the source."""
        return self.held_out_db >= PSNR_CAP_DB


@dataclass(frozen=True)
class BenchPrefix(_Measured):
    """Size and PSNR of one prefix of a file.

    Parameters
    ----------
    method, quality_db
        Profile or foreign format, and its nominal quality if any.
    prefix_bytes : int
    splats : int
        Splats in the prefix.
    held_out_db : float
        Mean PSNR over the test views, dB.
    """

    prefix_bytes: int
    splats: int
    held_out_db: float


@dataclass(frozen=True)
class StageTime(_Measured):
    """Duration of one stage of an encode, without scoring.

    Parameters
    ----------
    method, quality_db
        Profile or foreign format, and its nominal quality if any.
    stage : str
        Name of the stage in `EncodeReport`.
    wall_s, cpu_s : float
        Wall-clock time, and processor time of all threads.
    """

    stage: str
    wall_s: float
    cpu_s: float


@dataclass(frozen=True)
class Bench:
    """Results of a benchmark on one scene.

    Parameters
    ----------
    rows : tuple of Row
    prefixes : tuple of BenchPrefix
        Prefixes of one file per profile, the file of the middle quality.
    stages : tuple of StageTime
        Stages of the encodes of these files, in order.
    """

    rows: tuple[Row, ...]
    prefixes: tuple[BenchPrefix, ...]
    stages: tuple[StageTime, ...] = ()


@dataclass(frozen=True, eq=False)
class _Method:
    """A method of writing a scene: profile or format, nominal quality, writer and reader.

    The nominal quality of a tuned file is its target PSNR. `scored` tells whether scoring counts in
    the encoding time, `prefixes` whether prefixes of the file are measured.
    """

    name: str
    quality_db: float | None
    extension: str
    write: Callable[[Path], EncodeReport | None]
    read: Callable[[Path], Splats]
    scored: bool
    prefixes: bool = False


def stage_cost(
    splats: int,
    scored_on: Sequence[Camera],
    cameras: Sequence[Camera],
    *,
    profiles: Sequence[str],
    qualities: Sequence[float] | None,
    formats: Sequence[str],
    tuned: bool,
) -> StageCost:
    """Estimate the cost of `run` in the unit of `codec.encode.stage_costs`.

    Parameters
    ----------
    splats : int
        Splats of the scene.
    scored_on : sequence of Camera
        Training views, at least one.
    cameras : sequence of Camera
        Test views, at least one.
    profiles : sequence of str
        Profiles of `EncodeConfig.profile`.
    qualities : sequence of float or None
        Nominal qualities, dB; None for `QUALITIES`.
    formats : sequence of str
        Formats in `FOREIGN`.
    tuned : bool
        Whether the profiles in `TUNED` are tuned as well.
    """
    from cogsplat.codec.encode.config import EncodeConfig
    from cogsplat.codec.encode.request import EncodeRequest
    from cogsplat.codec.encode.stage_costs import stage_costs

    compared = comparison_costs(splats, cameras, close=False)
    files: list[tuple[StageCost, ...]] = []
    for profile in profiles:
        request = EncodeRequest(config=EncodeConfig(profile=profile), cameras=scored_on)
        encode = stage_costs(splats, request, scored=True)
        found = _nominal_qualities(profile, qualities)
        tune = StageCost("tune", _ENCODES_PER_TUNING * sum(part.cost for part in encode))
        trained = _target_qualities(qualities) if tuned and profile in TUNED else ()
        for write, count in ((encode, len(found)), ([tune], len(trained))):
            for index in range(count):
                has_prefixes = _measures_prefixes(profile, index, count)
                prefixes = _PREFIXES * compared[0].cost if has_prefixes else 0.0
                files.append((*write, *compared, StageCost("prefixes", prefixes)))
    files += [tuple(compared)] * len(formats)
    return StageCost("files", 0.0, parts=tuple(files))


def run(
    given: BenchInput,
    folder: Path,
    *,
    profiles: Sequence[str],
    qualities: Sequence[float] | None,
    formats: Sequence[str],
    tuned: bool = False,
    progress: Progress = silent,
) -> Bench:
    """Write a scene by every method, read the file and compare it with the source.

    Parameters
    ----------
    given : BenchInput
    folder : Path
        Folder for the files, which are kept.
    profiles : sequence of str
        Profiles of `EncodeConfig.profile`.
    qualities : sequence of float or None
        Nominal qualities of each profile in `QUALITIES`, dB; None for the values there.
    formats : sequence of str
        Formats in `FOREIGN`.
    tuned : bool
        Whether the profiles in `TUNED` are tuned as well, to the nominal qualities as target PSNRs.
    progress : Progress
        Called with ``files``, and for each file with the stages of encoding or ``tune``, ``test``,
        ``roam`` and ``prefixes``.

    Returns
    -------
    Bench
        Rows of the profiles, of tuned files, then of the formats. The row of a format that cannot
        store the scene has a reason code.

    Raises
    ------
    DataError
        Errors of `view_quality.compare`.
    """
    methods = [
        *_cogs_methods(given, profiles, qualities, progress),
        *(_tuned_methods(given, profiles, qualities, progress) if tuned else ()),
        *_foreign_methods(given, formats),
    ]
    rows: list[Row] = []
    prefixes: list[BenchPrefix] = []
    stages: list[StageTime] = []
    progress("files", 0, len(methods))
    for number, method in enumerate(methods, start=1):
        path = folder / f"{number}{method.extension}"
        row, report = _measure(given, method, path, progress)
        rows.append(row)
        if method.prefixes and not row.refused:
            prefixes += _prefixes(given, method, path, progress)
        if method.prefixes and report is not None:
            stages += _stages(method, report)
        progress("files", number, len(methods))
    return Bench(tuple(rows), tuple(prefixes), tuple(stages))


def _nominal_qualities(profile: str, qualities: Sequence[float] | None) -> Sequence[float | None]:
    """Return the nominal qualities of a profile to measure, dB; one None if it has none."""
    return sorted(qualities or QUALITIES[profile]) if profile in QUALITIES else [None]


def _target_qualities(qualities: Sequence[float] | None) -> Sequence[float]:
    """Return the target PSNRs of tuned files, dB."""
    return sorted(qualities or _TUNED_QUALITIES)


def _measures_prefixes(profile: str, index: int, count: int) -> bool:
    """Tell whether prefixes are measured: for the middle nominal quality of a profile."""
    return index == count // 2 and profile in QUALITIES


def _cogs_methods(
    given: BenchInput,
    profiles: Sequence[str],
    qualities: Sequence[float] | None,
    progress: Progress,
) -> list[_Method]:
    """Return a method for each profile and quality of COGS."""
    from cogsplat.codec.encode.config import EncodeConfig

    methods: list[_Method] = []
    for profile in profiles:
        found = _nominal_qualities(profile, qualities)
        for index, quality_db in enumerate(found):
            config = EncodeConfig(profile=profile, threads=given.threads)
            if quality_db is not None:
                config = EncodeConfig(profile=profile, quality_db=quality_db, threads=given.threads)
            methods.append(
                _Method(
                    profile,
                    quality_db,
                    ".cogs",
                    _encoder(given, config, progress),
                    lambda path: cogsplat.decode(path, threads=given.threads),
                    scored=True,
                    prefixes=_measures_prefixes(profile, index, len(found)),
                )
            )
    return methods


def _encoder(
    given: BenchInput, config: EncodeConfig, progress: Progress
) -> Callable[[Path], EncodeReport]:
    """Return a function that encodes the scene to its argument, a path."""
    from cogsplat.codec.encode.request import EncodeRequest

    def write(path: Path) -> EncodeReport:
        return cogsplat.encode(
            given.splats,
            path,
            config=config,
            request=EncodeRequest(cameras=given.scored_on, scores=given.scores),
            force=True,
            progress=progress,
        )

    return write


def _tuned_methods(
    given: BenchInput,
    profiles: Sequence[str],
    qualities: Sequence[float] | None,
    progress: Progress,
) -> list[_Method]:
    """Return a method for each profile that is tuned, and each target PSNR."""
    targets = _target_qualities(qualities)
    return [
        _Method(
            TUNED[profile],
            psnr_db,
            ".cogs",
            _tuner(given, profile, psnr_db, progress),
            lambda path: cogsplat.decode(path, threads=given.threads),
            scored=False,
            prefixes=_measures_prefixes(profile, index, len(targets)),
        )
        for profile in profiles
        if profile in TUNED
        for index, psnr_db in enumerate(targets)
    ]


def _tuner(
    given: BenchInput, profile: str, psnr_db: float, progress: Progress
) -> Callable[[Path], None]:
    """Return a function that tunes the scene and writes it to its argument, a path."""
    from cogsplat.codec.encode.config import Target
    from cogsplat.codec.fit import tuning
    from cogsplat.codec.fit.train_config import TrainConfig
    from cogsplat.codec.fit.tune_config import TuneConfig, TuneRequest
    from cogsplat.codec.fit.tuning_views import choose_tuning_views
    from cogsplat.formats.cogs import scene_writer

    def write(path: Path) -> None:
        progress("tune", 0, 1)
        request = TuneRequest(
            choose_tuning_views(given.splats, given.tuned_in, threads=given.threads),
            Target(psnr_db=psnr_db),
            TuneConfig(profile=profile, train=TrainConfig(threads=given.threads)),
            background=given.background,
        )
        size_of = partial(scene_writer.size_bytes, writer="benchmark")
        made = tuning.tune(given.splats, request, size_of=size_of)
        scene_writer.save(made.encoded, path, writer="benchmark", force=True)
        progress("tune", 1, 1)

    return write


def _foreign_methods(given: BenchInput, names: Sequence[str]) -> list[_Method]:
    """Return the method that writes and reads each of the named foreign formats."""
    from . import c3dgs_npz

    methods: list[_Method] = []
    for name in names:
        if name == BASELINE:

            def write_npz(path: Path) -> None:
                c3dgs_npz.write(given.splats, given.scores, path, threads=given.threads)

            def read_npz(path: Path) -> Splats:
                return c3dgs_npz.read(path, given.splats.info)

            methods.append(_Method(name, None, ".npz", write_npz, read_npz, scored=True))
            continue
        format_ = next(f for f in FORMATS if f.name == name)
        write = _writer(given, format_)
        methods.append(_Method(name, None, format_.extensions[0], write, read_scene, scored=False))
    return methods


def _writer(given: BenchInput, format_: Format) -> Callable[[Path], None]:
    """Return a function that writes the scene in a foreign format to its argument, a path."""
    write_scene = format_.write
    if write_scene is None:
        raise ValueError(f"format {format_.name!r} is not written, expected one of {FOREIGN}")

    def write(path: Path) -> None:
        write_scene(given.splats, path, force=True)

    return write


def _stages(method: _Method, report: EncodeReport) -> list[StageTime]:
    """Return the stage times of an encode."""
    return [
        StageTime(
            method.name,
            method.quality_db,
            stage,
            round(wall_s, 3),
            round(report.cpu_seconds[stage], 3),
        )
        for stage, wall_s in report.seconds.items()
    ]


def _measure(
    given: BenchInput, method: _Method, path: Path, progress: Progress
) -> tuple[Row, EncodeReport | None]:
    """Write, read and measure a scene by one method; for COGS, also return the encoder's report."""
    set_display_name(path, _label(method.name, method.quality_db))
    start = time.perf_counter()
    try:
        report = method.write(path)
    except CogsplatError as error:
        return Row(method.name, method.quality_db, refused=error.code), None
    encode_s = time.perf_counter() - start + (given.score_s if method.scored else 0.0)
    decode_s = float("inf")
    for _ in range(_READS):
        start = time.perf_counter()
        decoded = method.read(path)
        decode_s = min(decode_s, time.perf_counter() - start)
    found = view_quality.compare(
        given.splats,
        decoded,
        given.cameras,
        background=given.background,
        close=False,
        threads=given.threads,
        progress=progress,
    )
    photos_db = loss_db = None
    if given.photos is not None:
        photos_db = given.photos.psnr_db(decoded, given.background, threads=given.threads)
        loss_db = given.photos.source_db - photos_db
    size = path.stat().st_size
    row = Row(
        method=method.name,
        quality_db=method.quality_db,
        file_bytes=size,
        bytes_per_splat=size / len(given.splats),
        held_out_db=view_quality.mean_psnr_db(found.test),
        held_out_ssim=view_quality.mean_ssim(found.test),
        worst_db=found.worst.psnr_db,
        worst_ssim=found.worst.ssim,
        roam_db=view_quality.mean_psnr_db(found.roaming),
        roam_ssim=view_quality.mean_ssim(found.roaming),
        photos_db=photos_db,
        photo_loss_db=loss_db,
        encode_s=encode_s,
        decode_s=decode_s,
    )
    return row, report


def prefix_sizes(file_bytes: int) -> list[int]:
    """Return 32 KiB, its doublings below the file size, and the file size."""
    doublings = max(int(np.ceil(np.log2(max(file_bytes, 1) / _FIRST_PREFIX))), 0)
    return [*(_FIRST_PREFIX << k for k in range(doublings)), file_bytes]


def _prefixes(
    given: BenchInput, method: _Method, path: Path, progress: Progress
) -> list[BenchPrefix]:
    """Decode prefixes of a file and measure their PSNR in the held-out views."""
    prefixes: list[BenchPrefix] = []
    sizes = prefix_sizes(path.stat().st_size)
    progress("prefixes", 0, len(sizes))
    for size in sizes:
        decoded = cogsplat.decode(path, size_bytes=size, threads=given.threads)
        found = view_quality.view_qualities(
            given.splats,
            decoded,
            given.cameras,
            background=given.background,
            threads=given.threads,
        )
        held_out_db = view_quality.mean_psnr_db(found)
        prefixes.append(
            BenchPrefix(method.name, method.quality_db, size, len(decoded), held_out_db)
        )
        progress("prefixes", len(prefixes), len(sizes))
    return prefixes
