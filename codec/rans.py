"""Static range coding of byte planes: interleaved rANS, integers only (SPEC 6.9)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .errors import FormatError
from .rans_table import PRECISION, TOTAL, Table

U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
I64 = NDArray[np.int64]
Integers = NDArray[np.integer]

MAX_LANES: Final = 1024
"""Most states a body may interleave; their number is a power of two."""

_LOW: Final = 1 << 16  # states are in [2^16, 2^32) and are refilled by 16-bit words

# A lane costs 24 bits: a start of 2^16 and 32 bits for a state of 24 on average. So 0.4 %.
_BYTES_PER_LANE: Final = 750

# Symbols decoded by numpy between two look-ups of what the slots mean.
_BLOCK: Final = 1 << 16

_DecodePlane = Callable[[Integers, Integers, int, int, U32, U8], int]


def lanes_for(num_bytes: int) -> int:
    """Return how many lanes suit a body of about so many bytes: a power of two, 1 to `MAX_LANES`.

    More lanes decode faster in numpy; these are the most that add less than 0.4 %.
    """
    lanes = min(max(num_bytes // _BYTES_PER_LANE, 1), MAX_LANES)
    return 1 << (lanes.bit_length() - 1)


def encode(planes: Sequence[tuple[Table, U8]], lanes: int) -> bytes:
    """Encode planes into one body; needs the extra `encode`.

    Parameters
    ----------
    planes : sequence of (Table, (n,) uint8)
        In the order in which they will be decoded. Every symbol occurs in its table.
    lanes : int
        Interleaved states: a power of two, 1 to `MAX_LANES`.

    Returns
    -------
    bytes
        `lanes` states of 4 bytes, then words of 2 (SPEC 6.9).

    Raises
    ------
    ValueError
        Lanes out of range, planes of another type, or a symbol that its table has not.

    Notes
    -----
    J. Duda, "Asymmetric numeral systems", arXiv:1311.2540; interleaved as in F. Giesen,
    "Interleaved entropy coders", arXiv:1402.3392.
    """
    if not _valid_lanes(lanes):
        raise ValueError(f"{lanes} lanes, expected a power of two, 1 to {MAX_LANES}")
    # Here, because the core has no numba.
    from .rans_kernels import encode_plane

    states = np.full(lanes, _LOW, np.uint32)
    capacity = sum(plane.size for _, plane in planes)  # a symbol takes one word at the most
    words = np.empty(capacity, np.uint16)
    position = capacity
    for table, plane in reversed(planes):
        if plane.dtype != np.uint8 or plane.ndim != 1:
            raise ValueError(f"plane of {plane.dtype}{plane.shape}, expected one row of uint8")
        freqs, cums = np.zeros((2, 256), np.uint32)
        freqs[: table.freqs.size] = table.freqs
        cums[: table.cums.size] = table.cums
        strange = np.flatnonzero(np.bincount(plane, minlength=256) * (freqs == 0))
        if strange.size:
            raise ValueError(f"symbol {strange[0]} in a plane, expected one that its table has")
        position = encode_plane(states, words, position, freqs, cums, np.ascontiguousarray(plane))
    return states.astype("<u4").tobytes() + words[position:].astype("<u2").tobytes()


class Decoder:
    """A body that is decoded plane after plane (SPEC 6.9).

    Parameters
    ----------
    body : memoryview
        The states and words of one body, and nothing else.
    lanes : int
        Interleaved states, as the file says.
    compiled : bool
        Use numba where it is there; the results are the same without.

    Raises
    ------
    FormatError
        ``rans-lanes``: not a power of two, 1 to `MAX_LANES`. ``rans-states``: the body has fewer
        states, or one is below 2^16. ``rans-words``: half a word at the end.
    """

    def __init__(self, body: memoryview, lanes: int, *, compiled: bool = True) -> None:
        if not _valid_lanes(lanes):
            raise FormatError(
                "rans-lanes",
                f"rANS body: {lanes} lanes, expected a power of two, 1 to {MAX_LANES}",
                clause="6.9",
            )
        if len(body) < 4 * lanes:
            raise FormatError(
                "rans-states",
                f"rANS body: {len(body)} bytes, expected at least {4 * lanes} for {lanes} states",
                clause="6.9",
            )
        if len(body) % 2:
            raise FormatError(
                "rans-words",
                f"rANS body: {len(body)} bytes, expected whole words of 2",
                clause="6.9",
            )
        states = np.frombuffer(body[: 4 * lanes], "<u4").astype(np.uint32)
        if states.min() < _LOW:
            raise FormatError(
                "rans-states",
                f"rANS body: state {int(states.min())} in lane {int(states.argmin())}, "
                f"expected at least {_LOW}",
                clause="6.9",
            )
        self._num_words = len(body) // 2 - 2 * lanes
        self._position = 0
        # Padded, so that a step may run past the end before anybody looks.
        words = np.zeros(self._num_words + lanes, np.uint16)
        words[: self._num_words] = np.frombuffer(body[4 * lanes :], "<u2")
        self._states: Integers = states
        self._words: Integers = words
        kernel = _compiled_decode() if compiled else None
        if kernel is None:
            # Indices are int64, and numpy would convert any other type at every step.
            self._states, self._words = states.astype(np.int64), words.astype(np.int64)
        self._decode_plane = kernel or _decode_plane

    def decode(self, table: Table, n: int) -> U8:
        """Return the next plane.

        Parameters
        ----------
        table : Table
        n : int
            Symbols in the plane. The caller has checked it against its limits.

        Returns
        -------
        (n,) uint8

        Raises
        ------
        FormatError
            ``rans-words``: the body has no more words.
        """
        if n < 0:
            raise ValueError(f"{n} symbols, expected 0 or more")
        symbols = np.empty(n, np.uint8)
        if table.freqs[-1] == TOTAL:
            # A symbol without an alternative neither changes the states nor takes words.
            symbols.fill(table.freqs.size - 1)
            return symbols
        position = self._decode_plane(
            self._states, self._words, self._position, self._num_words, table.entries, symbols
        )
        if position > self._num_words:
            raise FormatError(
                "rans-words",
                f"rANS body: ends after {self._num_words} words, expected more",
                clause="6.9",
            )
        self._position = position
        return symbols

    def finish(self) -> None:
        """Check that the planes decoded so far were all there is.

        Raises
        ------
        FormatError
            ``rans-end``: words are left, or a state is not the one encoders start from.
        """
        if self._position != self._num_words:
            raise FormatError(
                "rans-end",
                f"rANS body: {self._num_words - self._position} words behind the last plane, "
                "expected none",
                clause="6.9",
            )
        strange = np.flatnonzero(self._states != _LOW)
        if strange.size:
            raise FormatError(
                "rans-end",
                f"rANS body: state {int(self._states[strange[0]])} in lane {int(strange[0])} "
                f"after the last plane, expected {_LOW}",
                clause="6.9",
            )


def _decode_plane(
    states: Integers, words: Integers, position: int, num_words: int, entries: U32, symbols: U8
) -> int:
    """Decode one plane with numpy, a step of all lanes at a time; as `rans_kernels.decode_plane`.

    `states` and `words` are int64.
    """
    n, lanes = symbols.size, states.size
    symbol_of = (entries & 0xFF).astype(np.uint8)
    freq_of = (entries >> 8 & 0xFFF).astype(np.int64) + 1
    bias_of = (entries >> 20).astype(np.int64)
    steps_per_block = max(_BLOCK // lanes, 1)
    slots = np.empty((min(steps_per_block, -(-n // lanes)), lanes), np.int64)
    freq, bias = np.empty((2, lanes), np.int64)
    need = np.empty(lanes, np.bool_)
    for start in range(0, n, steps_per_block * lanes):
        count = min(steps_per_block * lanes, n - start)
        full, rest = divmod(count, lanes)
        for slot in slots[:full]:
            position = _step(states, words, position, freq_of, bias_of, slot, freq, bias, need)
            if position > num_words:
                return position
        if rest:
            position = _step(
                states[:rest],
                words,
                position,
                freq_of,
                bias_of,
                slots[full, :rest],
                freq[:rest],
                bias[:rest],
                need[:rest],
            )
        symbol_of.take(slots.ravel()[:count], out=symbols[start : start + count], mode="clip")
    return position


def _step(
    x: Integers,
    words: Integers,
    position: int,
    freq_of: I64,
    bias_of: I64,
    slot: I64,
    freq: I64,
    bias: I64,
    need: NDArray[np.bool_],
) -> int:
    """Decode a symbol in every lane of `x`; the other lane arrays are overwritten."""
    np.bitwise_and(x, TOTAL - 1, out=slot)
    # No slot is out of range; clipping spares the copy that the check would make of `out`.
    freq_of.take(slot, out=freq, mode="clip")
    bias_of.take(slot, out=bias, mode="clip")
    np.right_shift(x, PRECISION, out=x)
    np.multiply(x, freq, out=x)
    np.add(x, bias, out=x)
    np.less(x, _LOW, out=need)
    (low,) = need.nonzero()
    if low.size:
        taken = x.take(low)
        taken <<= 16
        taken |= words[position : position + low.size]
        x[low] = taken
    return position + low.size


def _valid_lanes(lanes: int) -> bool:
    return 1 <= lanes <= MAX_LANES and lanes & (lanes - 1) == 0


@cache
def _compiled_decode() -> _DecodePlane | None:
    """Return the compiled loop, or None where numba cannot be had."""
    try:
        from .rans_kernels import decode_plane
    except (ImportError, RuntimeError):
        # Not installed, not for this numpy, or nowhere to keep what it compiles (RuntimeError).
        return None
    return decode_plane
