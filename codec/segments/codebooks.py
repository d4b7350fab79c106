"""Codebook segments: shapes and SH coefficients that chunks share (SPEC 7.1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError
from cogsplat.codec.splats import sh_coefficients
from cogsplat.codec.streams import kinds
from cogsplat.codec.streams.records import Attribute, StoredStream
from cogsplat.codec.streams.stream_inputs import Inputs

from .bands import read_band
from .stream_set import StreamSet

F32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class ShapeCodebook:
    """Codebook of shapes, without the size of the splat.

    Parameters
    ----------
    scales : (C, 3) float32
        Log scales without the splat's scale factor.
    quats : (C, 4) float32
        Unit, wxyz, w ≥ 0.
    """

    scales: F32
    quats: F32

    def __len__(self) -> int:
        return len(self.scales)

    @property
    def nbytes(self) -> int:
        """Size of both arrays, bytes."""
        return self.scales.nbytes + self.quats.nbytes


@dataclass(frozen=True, eq=False)
class ColourCodebook:
    """Codebook of SH coefficients above DC.

    Parameters
    ----------
    shN : (C, K-1, 3) float32
        Coefficients; 0 in bands that were not read.
    """

    shN: F32  # noqa: N815 - the field's name

    def __len__(self) -> int:
        return len(self.shN)

    @property
    def nbytes(self) -> int:
        """Size of the array, bytes."""
        return self.shN.nbytes


Codebook = ShapeCodebook | ColourCodebook


def decode_shape_codebook(payload: memoryview, rows: int, where: str) -> ShapeCodebook:
    """Decode a shape codebook from its segment (SPEC 7.1)."""
    found = StreamSet(payload, where, rows, "7.1")
    book = read_shapes(found, rows)
    found.require_empty()
    return book


def read_shapes(found: StreamSet, rows: int, *, escape: bool = False) -> ShapeCodebook:
    """Decode the rows of a shape codebook, or with `escape` the escape rows of a head.

    No streams are read for no rows.
    """
    out = ShapeCodebook(np.empty((rows, 3), np.float32), np.empty((rows, 4), np.float32))
    if rows:
        take = partial(found.pop_escape, rows=rows) if escape else found.pop
        kinds.read(take(Attribute.SCALES), out.scales)
        kinds.read(take(Attribute.QUATS), out.quats, Inputs(scales=out.scales))
    return out


def decode_colour_codebook(
    payloads: Mapping[int, memoryview], rows: int, degree: int, where: str
) -> ColourCodebook:
    """Decode a colour codebook from the segments of its bands (SPEC 7.1).

    Parameters
    ----------
    payloads : mapping of int to memoryview
        Bytes of each segment by band, 1 to `degree`.
    rows, degree : int
        Number of rows in the codebook, and SH degree of the result.
    where : str
        Name of the codebook in messages.
    """
    coefficients = np.zeros((rows, sh_coefficients(degree) - 1, 3), np.float32)
    for band, payload in payloads.items():
        label = f"{where}, band {band}"
        found = StreamSet(payload, label, rows, "7.1")
        read_band(found, band, coefficients)
        found.require_empty()
    return ColourCodebook(coefficients)


def missing_codebook_error(stream: StoredStream, number: int, attribute: str) -> FormatError:
    """Return the error for a stream whose codebook is not among the codebooks of its segment.

    Parameters
    ----------
    stream : StoredStream
        Stream that refers to the codebook.
    number : int
        Number of the codebook.
    attribute : str
        Name of the expected type, ``shape`` or ``colour``.
    """
    return FormatError(
        "codebook-missing",
        f"{stream.where}: codebook {number}, "
        f"expected a {attribute} codebook that the segment needs",
        clause="6.7",
    )


@dataclass(frozen=True)
class EncodedCodebook:
    """Payloads of a codebook.

    Parameters
    ----------
    attribute : str
        ``shape`` or ``colour``.
    rows : int
        Number of rows.
    payloads : tuple of bytes
        One for a shape codebook, one per SH band for a colour codebook.
    """

    attribute: str
    rows: int
    payloads: tuple[bytes, ...]

    def decode(self, sh_degree: int, where: str = "codebook") -> Codebook:
        """Decode the rows of the codebook.

        Parameters
        ----------
        sh_degree : int
            SH degree of the scene, 0 to 3.
        where : str
            Name of the codebook in messages.
        """
        payloads = [memoryview(payload) for payload in self.payloads]
        if self.attribute == "shape":
            return decode_shape_codebook(payloads[0], self.rows, where)
        bands = dict(enumerate(payloads, start=1))
        return decode_colour_codebook(bands, self.rows, sh_degree, where)
