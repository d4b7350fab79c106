"""Result of the encoder: payloads, tables, decoded splats and a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.rate import segment_order
from cogsplat.codec.rate.segment_order import (
    ChunkSegments,
    OrderedKind,
    OrderedSegment,
    SegmentGain,
)
from cogsplat.codec.segments.codebooks import EncodedCodebook
from cogsplat.codec.segments.payloads import Payloads
from cogsplat.codec.segments.prefix_compensation import Compensation
from cogsplat.codec.segments.view_shares import ViewTable
from cogsplat.codec.splats import Splats


@dataclass(frozen=True, eq=False)
class EncodedChunk:
    """Payloads of a chunk and its row of the chunk table.

    Parameters
    ----------
    splats : int
        Number of splats.
    payloads : Payloads
        Head, refinement and tail.
    box : (6,) float64
        Bounding box of the decoded splats with their extent, scene units.
    contribution : float
        Summed contribution of the splats.
    attributes : bytes or None
        Payload of extra attributes; None for a scene without.
    quality_db : float
        Predicted PSNR of the prefix that ends with this chunk, dB; 0 without a prediction.
    object : int
        Label of the chunk's object; 0 in scenes without objects.
    tail_drop : float
        Squared picture error that the tail removes.
    until : int
        Prefixes of this number of chunks or more do not draw the chunk; 0 if all prefixes draw it
        (SPEC 5.10).
    opacities : tuple of bytes
        Opacity payloads of the levels after the chunk's first (SPEC 5.11).
    cell : int
        Number of the chunk's cell (SPEC 5.4); 0 in scenes without cells.
    """

    splats: int
    payloads: Payloads
    box: NDArray[np.float64]
    contribution: float
    attributes: bytes | None = None
    quality_db: float = 0.0
    object: int = 0
    tail_drop: float = 0.0
    until: int = 0
    opacities: tuple[bytes, ...] = ()
    cell: int = 0

    @property
    def parts(self) -> ChunkSegments:
        """Sizes of the segments and the squared picture error that each removes."""
        head, refinement, tail = self.payloads.head, self.payloads.refinement, self.payloads.tail
        return ChunkSegments(
            len(head),
            None
            if refinement is None
            else SegmentGain(len(refinement), self.payloads.refinement_drop),
            None if tail is None else SegmentGain(len(tail), self.tail_drop),
        )


@dataclass(frozen=True)
class EncodedLevel:
    """Level of a scene with several levels of detail.

    Parameters
    ----------
    chunks : int
        Number of chunks from the start of the file to the end of the level.
    scale : float
        Divisor of the width and height of the full picture.
    """

    chunks: int
    scale: float


@dataclass(frozen=True, repr=False)
class EncodeReport:
    """Report of an encode: times, views, quality and size.

    Parameters
    ----------
    seconds : mapping of str to float
        Wall-clock time by stage (`Progress`), in the order of the stages; ``write`` is the
        container's.
    cpu_seconds : mapping of str to float
        Processor time by stage, summed over the threads of this process.
    scored_views : int
        Number of scored views with their jittered copies; 0 for given scores.
    quality_db : float
        Nominal quality, dB: that of the configuration, or the one found for a target. With planned
        views, a search reports the mean of `test_psnr_db`.
    trials : int
        Number of encodes of the chunks. More than 1 for a target, and for planned views whose first
        PSNR was far from the nominal quality.
    size_bytes : int
        Size of the file, bytes; 0 until a container was written.
    views : str
        Origin of the scored views: ``given``, ``planned``, ``given and planned`` where the cameras
        overlap too little, or ``none``.
    coverage : float
        Share of the scene that the scored views show, 0 to 1. Given views: share of splats that lie
        in a picture. Planned views: share of visible splats shown at least a quarter as clearly as
        from the best candidate place.
    test_views : str
        Origin of the test views: ``given`` by the request, ``left-out`` of the scored cameras,
        ``scored`` where the cameras are too few to leave any out, ``planned`` or ``none``.
    test_psnr_db : tuple of float
        PSNR of the whole scene in each test view, dB; empty without a prediction.
    test_distances : tuple of float
        Distance of each test view from the surface that it shows, scene units.
    close_psnr_db, close_distances : tuple of float
        PSNR and distance of the close views (`close_views.view_distances`) of some test views.
    """

    seconds: Mapping[str, float] = field(default_factory=dict)
    cpu_seconds: Mapping[str, float] = field(default_factory=dict)
    scored_views: int = 0
    quality_db: float = 0.0
    trials: int = 1
    size_bytes: int = 0
    views: str = "none"
    coverage: float = 0.0
    test_views: str = "none"
    test_psnr_db: tuple[float, ...] = ()
    test_distances: tuple[float, ...] = ()
    close_psnr_db: tuple[float, ...] = ()
    close_distances: tuple[float, ...] = ()

    def __repr__(self) -> str:
        facts = "; ".join(f"{name} {value}" for name, value in self._facts())
        return f"EncodeReport({facts})"

    def _repr_html_(self) -> str:
        """Return a table for notebooks."""
        rows = "".join(f"<tr><th>{name}</th><td>{value}</td></tr>" for name, value in self._facts())
        return f"<table>{rows}</table>"

    def _facts(self) -> list[tuple[str, str]]:
        """Return name and text of each figure that was measured."""
        facts = [("size", f"{self.size_bytes:,} B")] if self.size_bytes else []
        if self.quality_db:
            facts.append(("nominal quality", f"{self.quality_db:.2f} dB"))
        if self.test_psnr_db:
            mean = sum(self.test_psnr_db) / len(self.test_psnr_db)
            facts.append(("PSNR", f"{mean:.2f} dB, lowest {min(self.test_psnr_db):.2f} dB"))
        if self.close_psnr_db:
            mean = sum(self.close_psnr_db) / len(self.close_psnr_db)
            facts.append(("close up", f"{mean:.2f} dB, lowest {min(self.close_psnr_db):.2f} dB"))
        facts.append(("scored views", f"{self.scored_views} {self.views}"))
        return [*facts, ("time", f"{sum(self.seconds.values()):.1f} s")]


@dataclass(frozen=True, eq=False)
class EncodedScene:
    """Encoded scene, ready for a container.

    Parameters
    ----------
    scene : Splats
        Scene without rows: holds SH degree, `info` and types of extra attributes.
    splats : int
        Number of stored splats.
    pruned : int
        Number of splats of the source that were dropped.
    box : (6,) float64
        Bounding box of all chunks, lower and upper corner, scene units.
    codebooks : sequence of EncodedCodebook
        Shape and colour codebooks.
    chunks : sequence of EncodedChunk
        Chunks in stored order.
    decoded : Splats
        Decoded splats of all chunks in stored order, without extra attributes.
    compensation : Compensation or None
        Prefix compensation; None for a file without.
    prefix_mse : (c + 1,) float64 or None
        Mean squared error of the pictures of 0, 1, … c chunks with `best_inflation`; None if
        it was not measured.
    report : EncodeReport
        Report of the encode.
    levels : sequence of EncodedLevel
        Levels, coarsest first; empty for a scene without levels.
    view_table : ViewTable or None
        Contribution of each chunk to some viewpoints; None for a file without.
    compressed : bool
        Whether the planes of all payloads are compressed; those of a search trial are not.
    """

    scene: Splats
    splats: int
    pruned: int
    box: NDArray[np.float64]
    codebooks: Sequence[EncodedCodebook]
    chunks: Sequence[EncodedChunk]
    decoded: Splats
    compensation: Compensation | None = None
    prefix_mse: NDArray[np.float64] | None = None
    report: EncodeReport = field(default_factory=EncodeReport)
    levels: Sequence[EncodedLevel] = ()
    view_table: ViewTable | None = None
    compressed: bool = True

    def prefix_splats(self, chunks: int) -> Splats:
        """Return the refined splats of the first chunks.

        Chunks that have ended, because later ones replace them, are left out (SPEC 5.10).

        Parameters
        ----------
        chunks : int
            Number of first chunks, 0 to all.
        """
        own = self.chunks[:chunks]
        rows = self.decoded.take(slice(0, sum(chunk.splats for chunk in own)))
        ended = [0 < chunk.until <= chunks for chunk in own]
        if not any(ended):
            return rows
        return rows.take(~np.repeat(ended, [chunk.splats for chunk in own]))

    def ordered_segments(self) -> list[OrderedSegment]:
        """Return the segments of the chunks and the colour codebooks in the order of the file."""
        if self.prefix_mse is None:
            contribution = np.array([chunk.contribution for chunk in self.chunks])
            missing = segment_order.missing_shares(contribution)
        else:
            missing = segment_order.missing_shares_from_mse(self.prefix_mse)
        parts = [chunk.parts for chunk in self.chunks]
        return segment_order.order_segments(parts, missing, self._colour_bytes)

    def segment_bytes(self, place: OrderedSegment) -> int:
        """Return the size of a segment, bytes.

        Parameters
        ----------
        place : OrderedSegment
            One of `ordered_segments`.
        """
        if place.kind is OrderedKind.CODEBOOKS:
            return self._colour_bytes
        payloads = self.chunks[place.chunk].payloads
        payload = {
            OrderedKind.HEAD: payloads.head,
            OrderedKind.REFINEMENT: payloads.refinement,
            OrderedKind.TAIL: payloads.tail,
        }[place.kind]
        return len(payload or b"")

    @property
    def _colour_bytes(self) -> int:
        """Size of the colour codebooks, bytes."""
        books = [book.payloads for book in self.codebooks if book.attribute == "colour"]
        return sum(len(payload) for payloads in books for payload in payloads)
