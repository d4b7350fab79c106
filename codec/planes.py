"""Byte planes: the entropy stage, zstd frame or stored bytes per plane (SPEC 6.3)."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Final

import numpy as np
import zstandard
from numpy.typing import NDArray

from . import rans
from .errors import FormatError
from .rans_table import Table, unpack_table

U8 = NDArray[np.uint8]

ZSTD_FLAG: Final = 0x8000_0000
"""Bit 31 of a plane's word: the plane is a zstd frame; the other bits are its stored length."""

RANS_FLAG: Final = 0x4000_0000
"""Bit 30 of a plane's word: the stored bytes are a table, the symbols in the rANS body."""

LENGTH_MASK: Final = 0x3FFF_FFFF

MAX_PLANE_BYTES: Final = 8 * 1024 * 1024
"""Largest decoded plane, bytes (SPEC 9.1)."""

MAX_WINDOW_BYTES: Final = 8 * 1024 * 1024
"""Largest zstd window a reader must provide: what browsers accept (RFC 9659)."""

Meter = Callable[[memoryview, float], None]
"""``meter(body, bits)``: a plane of so many bits was read from a segment's rANS body."""

_METER: ContextVar[Meter | None] = ContextVar("meter", default=None)

_FRAME_MAGIC: Final = bytes.fromhex("28b52ffd")  # RFC 8878, 3.1.1

# Level 19 is where the ratio stops growing on planes this small.
_LEVEL: Final = 19


class PlaneCoder:
    """Codes the planes of one segment, each in whatever way takes the fewest bytes."""

    def __init__(self) -> None:
        self._ranked: list[tuple[Table, U8]] = []
        self._bits = 0.0

    def pack(self, plane: U8) -> tuple[int, bytes]:
        """Take one plane.

        Parameters
        ----------
        plane : (n,) uint8

        Returns
        -------
        word : int
            Stored length, with `ZSTD_FLAG` for a zstd frame, `RANS_FLAG` for the table of a plane
            whose symbols are in the segment's rANS body.
        stored : bytes
        """
        raw = plane.tobytes()
        best, word = raw, len(raw)
        # One thread, no checksum (the segment has its CRC), content size always stated.
        compressor = zstandard.ZstdCompressor(
            level=_LEVEL, write_checksum=False, write_content_size=True, threads=0
        )
        frame = compressor.compress(raw)
        if len(frame) < len(best):
            best, word = frame, len(frame) | ZSTD_FLAG
        if len(raw):
            counts = np.bincount(plane)
            table = Table.from_counts(counts)
            bits = table.bits(counts)
            if bits / 8 < len(best):
                self._ranked.append((table, plane))
                self._bits += bits
                best = table.pack()
                word = len(best) | RANS_FLAG
        return word, best

    def finish(self) -> tuple[int, bytes]:
        """Return the number of lanes and the rANS body; 0 and nothing where no plane uses it."""
        if not self._ranked:
            return 0, b""
        lanes = rans.lanes_for(int(self._bits / 8))
        return lanes, rans.encode(self._ranked, lanes)


@contextmanager
def metered(meter: Meter) -> Iterator[None]:
    """Report what planes take of the bodies they share, as the block decodes them on this thread.

    Parameters
    ----------
    meter : Meter
        Called for the planes of a body in the order in which they are stored.
    """
    token = _METER.set(meter)
    try:
        yield
    finally:
        _METER.reset(token)


class PlaneReader:
    """Reads the planes in one segment's rANS body, in the order of their records.

    Parameters
    ----------
    lanes : int
        As the payload states; 0 where there is no body.
    where : str
        Names the segment in messages.

    Attributes
    ----------
    body : memoryview
        What the planes share, as it is stored.
    """

    def __init__(self, lanes: int, where: str) -> None:
        self._lanes = lanes
        self._where = where
        self.body = memoryview(b"")
        self._waiting: deque[memoryview] = deque()
        self._decoder: rans.Decoder | None = None

    def expect(self, stored: memoryview) -> None:
        """Note that a plane of this table comes next."""
        self._waiting.append(stored)

    def attach(self, body: memoryview) -> None:
        """Set the bytes behind the last plane.

        Raises
        ------
        FormatError
            ``stream-record``: bytes where no plane wants any; ``rans-lanes``.
        """
        if bool(self._lanes) != bool(self._waiting) or (len(body) and not self._lanes):
            raise FormatError(
                "stream-record",
                f"{self._where}: {self._lanes} lanes, {len(self._waiting)} rANS planes and "
                f"{len(body)} bytes behind the last plane, expected all or none",
                clause="6.1",
            )
        self.body = body

    def read(self, stored: memoryview, length: int, where: str) -> U8:
        """Return the next plane, whose table is `stored`.

        Raises
        ------
        FormatError
            ``stream-order``: not the next one; ``rans-table``, ``rans-states``, ``rans-words``,
            ``plane-length``.
        """
        if length > MAX_PLANE_BYTES:
            raise _too_long(where, length)
        if not self._waiting or self._waiting[0] is not stored:
            raise FormatError(
                "stream-order",
                f"{where}: not where a decoder reads it, expected streams in reading order",
                clause="6.9",
            )
        self._waiting.popleft()
        if self._decoder is None:
            # Compiled code pays once it is loaded; loading it takes longer than a small file.
            compiled = sys.modules.get("numba") is not None
            self._decoder = rans.Decoder(self.body, self._lanes, compiled=compiled)
        table, used = unpack_table(stored)
        if used != len(stored):
            raise FormatError(
                "rans-table",
                f"{where}: a table of {len(stored)} bytes, expected {used}",
                clause="6.9",
            )
        plane = self._decoder.decode(table, length)
        meter = _METER.get()
        if meter is not None:
            # Without the bits of the table, which is stored apart.
            meter(self.body, table.bits(np.bincount(plane, minlength=1)) - 8.0 * len(stored))
        return plane

    def finish(self) -> None:
        """Check that the body ended where its last plane did, once all planes were read."""
        if self._decoder is not None and not self._waiting:
            self._decoder.finish()


def unpack_plane(stored: memoryview, word: int, length: int, where: str) -> U8:
    """Return the bytes of one plane.

    Parameters
    ----------
    stored : memoryview
        Exactly the plane's stored bytes.
    word : int
        The plane's word.
    length : int
        Decoded length in bytes that the stream's record implies.
    where : str
        Names the plane in messages.

    Returns
    -------
    (length,) uint8, read-only; a view of `stored` where the plane is not compressed.

    Raises
    ------
    FormatError
        ``plane-length``, ``zstd-frame``, ``zstd-size``, ``zstd-window``, ``zstd-dictionary``,
        ``zstd-checksum``.
    """
    if length > MAX_PLANE_BYTES:
        raise _too_long(where, length)
    if not word & ZSTD_FLAG:
        if len(stored) != length:
            raise FormatError(
                "plane-length",
                f"{where}: {len(stored)} stored bytes, expected {length}",
                clause="6.3",
            )
        return np.frombuffer(stored, np.uint8)
    # Skippable and legacy frames have other magic numbers, and zstd would accept the first.
    if bytes(stored[:4]) != _FRAME_MAGIC:
        raise FormatError(
            "zstd-frame",
            f"{where}: starts with {bytes(stored[:4]).hex()}, expected {_FRAME_MAGIC.hex()}",
            clause="6.3",
        )
    try:
        parameters = zstandard.get_frame_parameters(stored)
    except zstandard.ZstdError as error:
        raise FormatError("zstd-frame", f"{where}: {error}", clause="6.3") from error
    # Before anything is allocated: the frame's own claim must be the length the record implies.
    if parameters.content_size != length:
        raise FormatError(
            "zstd-size",
            f"{where}: the frame states {parameters.content_size} bytes, expected {length}",
            clause="6.3",
        )
    if parameters.window_size > MAX_WINDOW_BYTES:
        raise FormatError(
            "zstd-window",
            f"{where}: window of {parameters.window_size} bytes, "
            f"expected at most {MAX_WINDOW_BYTES}",
            clause="6.3",
        )
    if parameters.dict_id:
        raise FormatError(
            "zstd-dictionary",
            f"{where}: dictionary {parameters.dict_id}, expected none",
            clause="6.3",
        )
    # Decoders for browsers do not verify it: a wrong one would be an error in some readers only.
    if parameters.has_checksum:
        raise FormatError(
            "zstd-checksum",
            f"{where}: the frame has a checksum, expected none beside the segment's CRC",
            clause="6.3",
        )
    try:
        raw = zstandard.ZstdDecompressor().decompress(stored, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise FormatError("zstd-frame", f"{where}: {error}", clause="6.3") from error
    if len(raw) != length:
        raise FormatError(
            "zstd-size", f"{where}: {len(raw)} bytes, expected {length}", clause="6.3"
        )
    return np.frombuffer(raw, np.uint8)


def _too_long(where: str, length: int) -> FormatError:
    return FormatError(
        "plane-length",
        f"{where}: {length} bytes, expected at most {MAX_PLANE_BYTES}",
        clause="9.1",
    )
