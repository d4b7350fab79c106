"""What the encoder returns: payloads, tables, decoded rows and a report of the work."""

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
from cogsplat.codec.segments.codebooks import (
    Codebook,
    decode_colour_codebook,
    decode_shape_codebook,
)
from cogsplat.codec.segments.payloads import Payloads
from cogsplat.codec.segments.prefix_compensation import Compensation
from cogsplat.codec.segments.view_shares import ViewTable
from cogsplat.codec.splats import Splats


@dataclass(frozen=True)
class EncodedCodebook:
    """A codebook's payloads.

    Parameters
    ----------
    attribute : str
        ``shape`` or ``colour``.
    rows : int
    payloads : tuple of bytes
        One for a shape codebook, one per SH band for a colour codebook.
    """

    attribute: str
    rows: int
    payloads: tuple[bytes, ...]

    def decoded(self, sh_degree: int) -> Codebook:
        """Return its rows as a reader decodes them.

        Parameters
        ----------
        sh_degree : int
            Of the scene.
        """
        where = f"{self.attribute} codebook"
        payloads = [memoryview(payload) for payload in self.payloads]
        if self.attribute == "shape":
            return decode_shape_codebook(payloads[0], self.rows, where)
        bands = dict(enumerate(payloads, start=1))
        return decode_colour_codebook(bands, self.rows, sh_degree, where)


@dataclass(frozen=True, eq=False)
class EncodedChunk:
    """A chunk's payloads and its row of the chunk table.

    Parameters
    ----------
    splats : int
    payloads : Payloads
    box : (6,) float64
        What its splats reach as they are decoded, scene units.
    contribution : float
    attributes : bytes or None
        Payload of its splats' extra attributes; None where the scene has none.
    quality_db : float
        Predicted PSNR of a scene that ends with this chunk; 0 where nothing was predicted.
    object : int
        Label of the object it holds; 0 in scenes without.
    tail_drop : float
        Squared error of the pictures that its tail removes.
    until : int
        The chunk is drawn in prefixes of fewer chunks than this; 0 in all (SPEC 5.10).
    opacities : tuple of bytes
        Payloads of its splats' opacities at each level behind its first (SPEC 5.11).
    cell : int
        Number of the cell that it lies in (SPEC 5.4); 0 in scenes that are not cut into cells.
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
        """Sizes of its segments and the squared error that they remove."""
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
    """A level of a scene that is made for pictures of several scales.

    Parameters
    ----------
    chunks : int
        First chunks of the scene that make it up.
    scale : float
        Its pictures are the full ones divided by this in width and height.
    """

    chunks: int
    scale: float


@dataclass(frozen=True, repr=False)
class EncodeReport:
    """How a scene was encoded.

    Parameters
    ----------
    seconds : mapping of str to float
        Wall-clock time of each stage, by the names that `Progress` reports, in the order they
        began; ``write`` is the container's.
    cpu_seconds : mapping of str to float
        Processor time of each stage, all threads of this process together.
    scored_views : int
        Views that splats were scored in, jittered copies included; 0 where scores were given.
    quality_db : float
        Nominal quality of the result, dB: the configuration's, or what the search for a target
        found; where views were planned, such a search finds the mean of `test_psnr_db`.
    trials : int
        Times that the chunks were encoded; more than one for a target, and where views were planned
        and the PSNR of the first in the test views was far from the nominal quality.
    size_bytes : int
        Length of the file; 0 until a container was written.
    views : str
        Where the scored views come from: ``given``, ``planned``, or ``none``.
    coverage : float
        How much of the scene these show, 0 to 1. Of planned views, the share of the visible splats
        that one of them shows at least a quarter as clearly as the best of all places that were
        tried; of given views, the share of the splats that lie in a picture.
    test_views : str
        Where the views come from that quality was predicted and a PSNR searched for in: ``given``,
        ``planned``, or ``none``. Given ones are among those scored unless the caller keeps them
        apart.
    test_psnr_db : tuple of float
        PSNR of the whole in each of them, dB; empty where nothing was predicted.
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
        facts.append(("scored views", f"{self.scored_views} {self.views}"))
        return [*facts, ("time", f"{sum(self.seconds.values()):.1f} s")]


@dataclass(frozen=True, eq=False)
class EncodedScene:
    """A scene ready for a container.

    Parameters
    ----------
    scene : Splats
        No rows: SH degree, `info` and extra attributes of the scene.
    splats : int
        Rows that are stored.
    pruned : int
        Rows of the source that were dropped.
    box : (6,) float64
        Lower and upper corner of all chunks' boxes, scene units.
    codebooks, chunks : sequence
    decoded : Splats
        The rows of all chunks as a reader of the complete file decodes them, in stored order,
        without extra attributes.
    compensation : Compensation or None
        How prefixes are changed so that they look most like the whole scene.
    prefix_mse : (c + 1,) float64 or None
        Mean squared error of pictures of nothing, of the first chunk, and so on to the whole, with
        the usual inflation, for what the splats behind are missing; None where that was not
        measured.
    report : EncodeReport
    levels : sequence of EncodedLevel
        Coarsest first; none where the scene has no levels.
    view_table : ViewTable or None
        What the pictures of some viewpoints show of each chunk; None where nothing is stored.
    compressed : bool
        Whether the planes of all payloads are. Those of a trial that may be thrown away are not.
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

    def drawn(self, chunks: int) -> Splats:
        """Return the decoded rows that the prefix of the first chunks draws (SPEC 5.10).

        Parameters
        ----------
        chunks : int
            From 0 to all.
        """
        own = self.chunks[:chunks]
        rows = self.decoded.take(slice(0, sum(chunk.splats for chunk in own)))
        ended = [0 < chunk.until <= chunks for chunk in own]
        if not any(ended):
            return rows
        return rows.take(~np.repeat(ended, [chunk.splats for chunk in own]))

    def placed(self) -> list[OrderedSegment]:
        """Return the segments that splats need in the order of the file, shape codebooks aside."""
        if self.prefix_mse is None:
            contribution = np.array([chunk.contribution for chunk in self.chunks])
            missing = segment_order.missing_shares(contribution)
        else:
            missing = segment_order.missing_shares_from_mse(self.prefix_mse)
        parts = [chunk.parts for chunk in self.chunks]
        return segment_order.order_segments(parts, missing, self._colour_bytes)

    def placed_bytes(self, place: OrderedSegment) -> int:
        """Return the bytes of one of the segments of `placed`, or of all colour codebooks."""
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
        """Bytes of the colour codebooks."""
        books = [book.payloads for book in self.codebooks if book.attribute == "colour"]
        return sum(len(payload) for payloads in books for payload in payloads)
