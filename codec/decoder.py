"""From segment payloads to rows: chunk heads, chunk tails and codebooks (SPEC 7)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from . import colour_streams, fine_means, shape_streams, streams
from . import grid as grids
from . import refinement as refinement_streams
from .errors import FormatError
from .grid import Grid
from .refinement import Finer
from .splats import MAX_SH_DEGREE, Splats, sh_coefficients
from .streams import KEPT, SH_BANDS, Attribute, Kind, StoredStream

F32 = NDArray[np.float32]
U32 = NDArray[np.uint32]

# Coarse values that nobody asks for.
_NOBODY: Final = np.empty((0, 3), np.float32)


@dataclass(frozen=True, eq=False)
class ShapeCodebook:
    """Rows of normalised shapes.

    Parameters
    ----------
    scales : (C, 3) float32
        Natural logarithm, without the splat's scale factor.
    quats : (C, 4) float32
        Unit, wxyz, w ≥ 0.
    """

    scales: F32
    quats: F32

    def __len__(self) -> int:
        return len(self.scales)

    @property
    def nbytes(self) -> int:
        """Bytes of both arrays."""
        return self.scales.nbytes + self.quats.nbytes


@dataclass(frozen=True, eq=False)
class ColourCodebook:
    """Rows of SH coefficients above DC.

    Parameters
    ----------
    shN : (C, K-1, 3) float32
        Zeros in the bands that were not read.
    """

    shN: F32  # noqa: N815 - the field's name

    def __len__(self) -> int:
        return len(self.shN)

    @property
    def nbytes(self) -> int:
        """Bytes of the array."""
        return self.shN.nbytes


Codebook = ShapeCodebook | ColourCodebook


def decode_shape_codebook(payload: memoryview, rows: int, where: str) -> ShapeCodebook:
    """Return the rows of a shape codebook segment (SPEC 7.1)."""
    found = _Streams(payload, where, rows, "7.1")
    book = ShapeCodebook(np.empty((rows, 3), np.float32), np.empty((rows, 4), np.float32))
    found.take(Attribute.SCALES).read_numbers(book.scales)
    found.take(Attribute.QUATS).read_quats(book.quats)
    found.finish()
    return book


def decode_colour_codebook(
    payloads: Mapping[int, memoryview], rows: int, degree: int, where: str
) -> ColourCodebook:
    """Return the rows of a colour codebook from its band segments (SPEC 7.1).

    Parameters
    ----------
    payloads : mapping of int to memoryview
        Band (1 to `degree`) to the bytes of its segment.
    rows, degree : int
        Of the codebook and of the result.
    where : str
        Names the codebook in messages.
    """
    coefficients = np.zeros((rows, sh_coefficients(degree) - 1, 3), np.float32)
    for band, payload in payloads.items():
        label = f"{where}, band {band}"
        found = _Streams(payload, label, rows, "7.1")
        _read_band(found, band, coefficients)
        found.finish()
    return ColourCodebook(coefficients)


def decode_head(
    payload: memoryview,
    codebooks: Mapping[int, Codebook],
    out: Splats,
    where: str,
    refinement: memoryview | None = None,
) -> None:
    """Write a chunk head's means, opacities, sh0, scales and quats into the rows of `out`.

    Parameters
    ----------
    payload : memoryview
        The segment's bytes, its CRC already checked.
    codebooks : mapping of int to Codebook
        At least those the segment needs.
    out : Splats
        The chunk's rows, as views of a larger scene; shN is left alone.
    where : str
        Names the segment in messages.
    refinement : memoryview, optional
        Bytes of the chunk's refinement, likewise checked; without it the head's coarse values.

    Raises
    ------
    FormatError, UnsupportedError, LimitError
        A payload breaks SPEC 6, 7.2 or 7.4.
    """
    found = _Streams(payload, where, len(out), "7.2")
    finer = _Refinement(refinement, f"{where}, refined", len(out))
    # What the halvings of the head's own codes follow from.
    scales = out.scales
    if found.has(Attribute.SHAPE):
        _read_shapes(found, codebooks, out)
    else:
        scales = _read_scales(found.take(Attribute.SCALES), finer.take(Attribute.SCALES), out)
        _read_quats(found.take(Attribute.QUATS), finer, scales, out)
    _read_means(found.take(Attribute.MEANS), finer, scales, out)
    _read_opacities(found.take(Attribute.OPACITIES), finer.take(Attribute.OPACITIES), out)
    _read_sh0(found.take(Attribute.SH0), finer.take(Attribute.SH0), out.sh0)
    found.finish()
    finer.finish()


def _read_shapes(found: _Streams, codebooks: Mapping[int, Codebook], out: Splats) -> None:
    shape = found.take(Attribute.SHAPE)
    kept = ShapeCodebook(
        np.empty((shape.kept, 3), np.float32), np.empty((shape.kept, 4), np.float32)
    )
    if shape.kept:
        found.take_kept(Attribute.SCALES, shape.kept).read_numbers(kept.scales)
        found.take_kept(Attribute.QUATS, shape.kept).read_quats(kept.quats)
    book = codebooks.get(shape.codebook)
    if not isinstance(book, ShapeCodebook):
        raise _no_codebook(shape, shape.codebook, "shape")
    indices = shape.read_indices(len(book))
    _gather(book.scales, kept.scales, indices, out.scales)
    _gather(book.quats, kept.quats, indices, out.quats)
    factor = np.empty((len(out), 1), np.float32)
    found.take(Attribute.SCALE_FACTOR).read_numbers(factor)
    np.add(out.scales, factor, out=out.scales)


def _read_scales(stream: StoredStream, finer: StoredStream | None, out: Splats) -> F32:
    """Read scales into `out`; return those of the head alone."""
    coarse = out.scales if finer is None else np.empty_like(out.scales)
    if stream.kind == Kind.LADDER:
        shape_streams.read_ladder(stream, out.scales, finer, coarse)
    elif finer is None:
        stream.read_numbers(out.scales)
    else:
        refinement_streams.read_digits(stream, _grid(stream, 3), finer, out.scales, coarse)
    return coarse


def _grid(stream: StoredStream, components: int) -> Grid:
    """Return the grid of a scalar stream that is to be refined."""
    stream.require_kind(Kind.SCALAR)
    params = stream.require_params(components * grids.ENTRY_BYTES)
    return grids.unpack(params, components, stream.where)


def _read_quats(stream: StoredStream, finer: _Refinement, scales: F32, out: Splats) -> None:
    if stream.kind == Kind.TURN:
        shape_streams.read_turns(stream, scales, out.quats, finer.finer(Attribute.QUATS, out))
    else:
        stream.read_quats(out.quats)


def _read_means(stream: StoredStream, finer: _Refinement, scales: F32, out: Splats) -> None:
    if stream.kind == Kind.FINE:
        fine_means.read_fine_means(stream, scales, out.means, finer.finer(Attribute.MEANS, out))
    else:
        stream.read_means(out.means)


def _read_opacities(stream: StoredStream, finer: StoredStream | None, out: Splats) -> None:
    column = out.opacities[:, None]
    if finer is None:
        stream.read_numbers(column)
    else:
        refinement_streams.read_digits(stream, _grid(stream, 1), finer, column, _NOBODY)


def _read_sh0(stream: StoredStream, finer: StoredStream | None, out: F32) -> None:
    if stream.kind == Kind.BASIS:
        colour_streams.read_sh0(stream, out, finer)
    elif finer is None:
        stream.read_numbers(out)
    else:
        refinement_streams.read_digits(stream, _grid(stream, 3), finer, out, _NOBODY)


def decode_tail(
    payload: memoryview,
    codebooks: Mapping[int, Codebook],
    out: F32,
    where: str,
    *,
    sh_degree: int = MAX_SH_DEGREE,
) -> None:
    """Write a chunk tail's shN into the rows of `out`.

    Parameters
    ----------
    payload, codebooks, where
        As in `decode_head`.
    out : (n, K-1, 3) float32
        The chunk's rows; K may be lower than the file's, and the bands above are skipped.
    sh_degree : int
        Of the file; bands above it have no place in a tail.

    Raises
    ------
    FormatError, UnsupportedError, LimitError
        The payload breaks SPEC 6 or 7.3.
    """
    rows = len(out)
    found = _Streams(payload, where, rows, "7.3")
    bands = range(1, sh_degree + 1)
    if found.has(Attribute.SHN):
        colour = found.take(Attribute.SHN)
        if colour.kind == Kind.BASIS:
            number = colour_streams.basis_codebook(colour)
            basis = _colours(codebooks, colour, number, out.shape[1])
            colour_streams.read_shn(colour, basis.shN[:, : out.shape[1]], out)
            found.finish()
            return
        kept = np.zeros((colour.kept, *out.shape[1:]), np.float32)
        if colour.kept:
            for band in bands:
                _read_band(found, band, kept, kept=True)
        book = _colours(codebooks, colour, colour.codebook, out.shape[1])
        _gather(book.shN[:, : out.shape[1]], kept, colour.read_indices(len(book)), out)
    else:
        for band in bands:
            _read_band(found, band, out)
    found.finish()


def _gather(book: F32, kept: F32, indices: U32, out: F32) -> None:
    rows = np.concatenate([book, kept]) if len(kept) else book
    # The indices are in range; only a mode that cannot fail writes into `out` without a copy.
    np.take(rows, indices, axis=0, out=out, mode="clip")


def _read_band(found: _Streams, band: int, out: F32, *, kept: bool = False) -> None:
    """Fill one band of (n, K-1, 3) `out`: zeros where the stream is absent, nothing if K is low."""
    attribute = SH_BANDS[band - 1]
    first, last = band * band - 1, (band + 1) * (band + 1) - 1
    wanted = out.shape[1] >= last
    if not found.has(attribute, kept=kept):
        if wanted:
            out[:, first:last] = 0
        return
    stream = found.take_kept(attribute, len(out)) if kept else found.take(attribute)
    if wanted:
        values = np.empty((len(out), (last - first) * 3), np.float32)
        stream.read_numbers(values)
        out[:, first:last] = values.reshape(len(out), last - first, 3)


def _colours(
    codebooks: Mapping[int, Codebook], stream: StoredStream, number: int, coefficients: int
) -> ColourCodebook:
    book = codebooks.get(number)
    if not isinstance(book, ColourCodebook) or book.shN.shape[1] < coefficients:
        raise _no_codebook(stream, number, "colour")
    return book


def _no_codebook(stream: StoredStream, number: int, what: str) -> FormatError:
    return FormatError(
        "codebook-missing",
        f"{stream.where}: codebook {number}, expected a {what} codebook that the segment needs",
        clause="6.7",
    )


class _Streams:
    """The streams of one payload, each to be taken exactly once."""

    def __init__(self, payload: memoryview, where: str, rows: int, clause: str) -> None:
        stored = streams.unpack(payload, where, rows)
        self._stored = {(s.attribute, s.flags & KEPT): s for s in stored}
        self._where = where
        self._rows = rows
        self._clause = clause

    def has(self, attribute: Attribute, *, kept: bool = False) -> bool:
        return (attribute, KEPT if kept else 0) in self._stored

    def take(self, attribute: Attribute) -> StoredStream:
        return self._take(attribute, 0, self._rows)

    def take_kept(self, attribute: Attribute, rows: int) -> StoredStream:
        return self._take(attribute, KEPT, rows)

    def _take(self, attribute: Attribute, flag: int, rows: int) -> StoredStream:
        stream = self._stored.pop((attribute, flag), None)
        name = attribute.name.lower() + (" kept" if flag else "")
        if stream is None:
            raise FormatError(
                "stream-missing",
                f"{self._where}: no stream for {name}, expected one",
                clause=self._clause,
            )
        if stream.rows != rows:
            raise FormatError(
                "stream-rows",
                f"{stream.where}: {stream.rows} rows, expected {rows}",
                clause="6.2",
            )
        if stream.kind == Kind.VQ and attribute not in (Attribute.SHAPE, Attribute.SHN):
            raise FormatError(
                "stream-kind", f"{stream.where}: kind VQ, expected numbers", clause="6.2"
            )
        return stream

    def finish(self) -> None:
        if self._stored:
            names = sorted(s.label for s in self._stored.values())
            raise FormatError(
                "stream-unexpected",
                f"{self._where}: {names} have no place here",
                clause=self._clause,
            )


class _Refinement:
    """The streams of a refinement, each to be taken at most once; none where there is none."""

    def __init__(self, payload: memoryview | None, where: str, rows: int) -> None:
        self._streams = None if payload is None else _Streams(payload, where, rows, "7.4")

    def take(self, attribute: Attribute) -> StoredStream | None:
        if self._streams is None or not self._streams.has(attribute):
            return None
        return self._streams.take(attribute)

    def finer(self, attribute: Attribute, out: Splats) -> Finer | None:
        stream = self.take(attribute)
        return None if stream is None else Finer(stream, out.scales)

    def finish(self) -> None:
        if self._streams is not None:
            self._streams.finish()
