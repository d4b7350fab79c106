"""Quality of prefixes of ordered splats, COGS files and foreign files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.errors import printable
from cogsplat.codec.order.orders import OrderInputs, order_rows
from cogsplat.formats.storage.atomic import storage_errors
from cogsplat.formats.storage.byte_counts import ByteCount
from cogsplat.formats.storage.scratch_folder import scratch_folder
from cogsplat.tools.lab.evaluation.progs_protocol import (
    BYTES,
    SPLATS,
    PrefixPoint,
    by_bytes,
    by_codec,
    by_splats,
)
from cogsplat.tools.lab.evaluation.strips import STRIP_SHARES, Strip
from cogsplat.tools.lab.evaluation.tables import (
    DIFFERENCES,
    STRIPS,
    EvaluationInput,
)
from cogsplat.tools.terminal.output import display_name
from cogsplat.tools.terminal.progress_bars import Stages

from .octree_sweep import Curve


@dataclass
class Results:
    """Figures and pictures of prefixes, in the order of measuring.

    Parameters
    ----------
    points : list of PrefixPoint
        Figures of every prefix.
    strips : dict of str to list of Strip
        Film strips, by `SPLATS` and `BYTES`.
    """

    points: list[PrefixPoint] = field(default_factory=list)
    strips: dict[str, list[Strip]] = field(default_factory=lambda: {SPLATS: [], BYTES: []})

    def strip_files(self, by: str) -> tuple[str, ...]:
        """Return the file names of the film strips by `SPLATS` or `BYTES`."""
        return (STRIPS[by], DIFFERENCES[by]) if self.strips[by] else ()


def measure_orders(
    given: EvaluationInput,
    measured: Sequence[Curve],
    unordered: OrderInputs,
    shares: Sequence[float],
    results: Results,
    stages: Stages,
) -> dict[str, NDArray[np.int64]]:
    """Order the splats for each curve, and measure prefixes; return the rows by label."""
    ordered: dict[str, NDArray[np.int64]] = {}
    stages("orders", 0, len(measured))
    for curve in measured:
        rows = order_rows(curve.order, unordered, curve.config)
        if shares:
            results.points += by_splats(
                given.evaluator, curve.label, given.splats, rows, shares, progress=stages
            )
            results.strips[SPLATS].append(
                Strip.of_order(curve.label, given.splats, rows, STRIP_SHARES)
            )
        ordered[curve.label] = rows
        stages("orders", len(ordered), len(measured))
    return ordered


@dataclass
class FileMeasuring:
    """Measures prefixes of COGS files by bytes.

    Parameters
    ----------
    given : EvaluationInput
        Scene and evaluator.
    lengths : sequence of ByteCount or None
        Lengths of the prefixes; None for 32 KiB, doubled to the end.
    results : Results
        Receives the figures and a film strip of each file.
    compensate : bool
        Whether prefix compensation is applied.
    threads : int
        Number of threads; 0 for every core this process may use.
    stages : Stages
        Receives the progress.
    """

    given: EvaluationInput
    lengths: Sequence[ByteCount] | None
    results: Results
    compensate: bool
    threads: int
    stages: Stages

    def measure_files(self, paths: Sequence[Path]) -> None:
        """Measure prefixes of existing files."""
        self.stages("files", 0, len(paths))
        for number, path in enumerate(paths, start=1):
            self._measure(printable(display_name(path)), path)
            self.stages("files", number, len(paths))

    def measure_encodes(
        self, measured: Sequence[Curve], quality: float, target_psnr: float | None
    ) -> None:
        """Encode the scene in the order of each curve, and measure prefixes of the files.

        Parameters
        ----------
        measured : sequence of Curve
            Orders to encode in.
        quality : float
            Nominal PSNR, dB.
        target_psnr : float or None
            PSNR to reach instead of `quality`, dB.
        """
        self.stages("files", 0, len(measured))
        with scratch_folder() as folder:
            for number, curve in enumerate(measured, start=1):
                path = folder / f"{number}.cogs"
                _encode(self.given, curve, path, quality, target_psnr, self.threads, self.stages)
                self._measure(curve.label, path)
                self.stages("files", number, len(measured))

    def _measure(self, name: str, path: Path) -> None:
        """Measure prefixes of a file."""
        size = _size_of(path)
        found = by_bytes(
            self.given.evaluator,
            name,
            path,
            None if self.lengths is None else [one.of(size) for one in self.lengths],
            compensate=self.compensate,
            threads=self.threads,
            progress=self.stages,
        )
        self.results.points += found
        strip = Strip.of_file(name, path, found, compensate=self.compensate, threads=self.threads)
        self.results.strips[BYTES].append(strip)


def measure_codecs(
    given: EvaluationInput,
    codecs: Sequence[str],
    ordered: Mapping[str, NDArray[np.int64]],
    shares: Sequence[float],
    results: Results,
    stages: Stages,
) -> None:
    """Measure prefixes of every order, written in every format of `codecs`."""
    pairs = [(codec, label) for codec in codecs for label in ordered]
    with scratch_folder() as folder:
        for number, (codec, label) in enumerate(pairs):
            stages("codecs", number, len(pairs))
            results.points += by_codec(
                given.evaluator,
                label,
                given.splats,
                ordered[label],
                codec,
                shares,
                path=folder / codec,
                progress=stages,
            )
    stages("codecs", len(pairs), len(pairs))


def _size_of(path: Path) -> int:
    """Return the size of a file, bytes."""
    with storage_errors(path):
        return path.stat().st_size


def _encode(
    given: EvaluationInput,
    curve: Curve,
    path: Path,
    quality: float,
    target_psnr: float | None,
    threads: int,
    stages: Stages,
) -> None:
    """Encode the scene in the order of a curve."""
    from cogsplat.codec.encode.config import EncodeConfig, Target
    from cogsplat.codec.encode.request import EncodeRequest

    cogsplat.encode(
        given.splats.without_extras() if not curve.config.by_object else given.splats,
        path,
        request=EncodeRequest(
            cameras=given.scored_on,
            scores=given.scores,
            config=EncodeConfig(
                order=curve.order, ordering=curve.config, quality_db=quality, threads=threads
            ),
            target=None if target_psnr is None else Target(psnr_db=target_psnr),
        ),
        progress=stages,
    )
