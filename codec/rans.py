"""Static range coding of byte planes: interleaved rANS, integers only (SPEC 6.9)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .errors import FormatError

U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
I64 = NDArray[np.int64]
Integers = NDArray[np.integer]

PRECISION: Final = 12
"""The frequencies of a table sum to 2^12."""

MAX_LANES: Final = 1024
"""Most states a body may interleave; their number is a power of two."""

_TOTAL: Final = 1 << PRECISION
_LOW: Final = 1 << 16  # states are in [2^16, 2^32) and are refilled by 16-bit words
_MANTISSA: Final = 16  # weight codes below it are their own weight (SPEC 6.9)

# A lane costs 24 bits: a start of 2^16 and 32 bits for a state of 24 on average. So 0.4 %.
_BYTES_PER_LANE: Final = 750

# Symbols decoded by numpy between two look-ups of what the slots mean.
_BLOCK: Final = 1 << 16

_DecodePlane = Callable[[Integers, Integers, int, int, U32, U8], int]


def _weights() -> I64:
    """Return the (256,) weight of every weight code, rising (SPEC 6.9)."""
    code = np.arange(256)
    exponent = np.maximum(code // _MANTISSA - 1, 0)
    mantissa = code % _MANTISSA + np.where(code < _MANTISSA, 0, _MANTISSA)
    return (mantissa << exponent).astype(np.int64)


_WEIGHTS: Final = _weights()


@dataclass(frozen=True)
class Table:
    """How often each symbol of a plane occurs, as the file states it.

    Parameters
    ----------
    codes : bytes
        Weight code of symbol 0, 1, …, up to the last one that occurs: 1 to 256 bytes, the last
        not 0. Code c < 16 is weight c, and 0 says that the symbol does not occur; any other is
        weight ``16 + c % 16 << c // 16 - 1`` (SPEC 6.9).
    """

    codes: bytes

    def __post_init__(self) -> None:
        if not 1 <= len(self.codes) <= 256 or self.codes[-1] == 0:
            raise ValueError(f"table {self.codes!r}, expected 1 to 256 codes, the last not 0")

    @classmethod
    def from_counts(cls, counts: NDArray[np.integer]) -> Table:
        """Return the table under which a plane takes the fewest bytes, or nearly.

        Parameters
        ----------
        counts : (A,) integers, A ≤ 256
            Times that each symbol occurs. Where none does, the table is of symbol 0 alone.

        Raises
        ------
        ValueError
            Not a row of up to 256 counts of 0 or more.
        """
        counts = _checked_counts(counts)
        used = np.flatnonzero(counts)
        if used.size < 2:
            return cls(bytes(used[0] if used.size else 0) + b"\x01")
        wanted = _ideal_frequencies(counts[used]) - 1.0
        # The largest weight falls on a code exactly; of the ways to do so, the best is kept.
        best, fewest = cls(b"\x01"), np.inf
        for code in range(239, 255, 2):
            weights = wanted * (_WEIGHTS[code] / wanted.max())
            codes = np.zeros(used[-1] + 1, np.uint8)
            codes[used] = _nearest_codes(weights)
            table = cls(codes.tobytes())
            bits = table.bits(counts)
            if bits < fewest:
                best, fewest = table, bits
        return best

    @cached_property
    def freqs(self) -> U32:
        """Frequencies, (A,) uint32, of sum 4096; 0 for symbols that do not occur.

        Each symbol that occurs has 1, and a share of the rest by its weight, rounded so that the
        running sums are floors (SPEC 6.9).
        """
        weights = _WEIGHTS[np.frombuffer(self.codes, np.uint8)]
        occurs = weights > 0
        running = np.cumsum(weights)
        shares = running * (_TOTAL - int(occurs.sum())) // running[-1]
        freqs: U32 = (np.diff(shares, prepend=0) + occurs).astype(np.uint32)
        return freqs

    @cached_property
    def cums(self) -> U32:
        """Sum of the frequencies before each symbol, (A,) uint32."""
        return (np.cumsum(self.freqs) - self.freqs).astype(np.uint32)

    @cached_property
    def entries(self) -> U32:
        """What each slot means, (4096,) uint32: ``symbol | freq - 1 << 8 | slot - cum << 20``."""
        symbol = np.repeat(np.arange(self.freqs.size), self.freqs)
        bias = np.arange(_TOTAL) - self.cums[symbol]
        return (symbol | (self.freqs[symbol] - 1) << 8 | bias << 20).astype(np.uint32)

    def bits(self, counts: NDArray[np.integer]) -> float:
        """Return the length in bits of a plane with these counts, and of the table itself.

        Parameters
        ----------
        counts : (A,) integers, A ≤ 256

        Returns
        -------
        float
            Infinite where a symbol occurs that the table has not.
        """
        counts = _checked_counts(counts)
        used = np.flatnonzero(counts)
        if used.size and (used[-1] >= self.freqs.size or not self.freqs[used].all()):
            return float("inf")
        lengths = PRECISION - np.log2(self.freqs[used])
        return float(counts[used] @ lengths) + 8.0 * (1 + len(self.codes))

    def pack(self) -> bytes:
        """Return the stored form: number of symbols less one as a byte, then the weight codes."""
        return bytes([len(self.codes) - 1]) + self.codes


def unpack_table(stored: memoryview) -> tuple[Table, int]:
    """Read the table that `stored` starts with.

    Parameters
    ----------
    stored : memoryview
        Bytes; there may be more behind the table.

    Returns
    -------
    Table
    int
        Bytes the table takes, 2 to 257.

    Raises
    ------
    FormatError
        ``rans-table``: cut short, or its last code is 0.
    """
    size = 2 + stored[0] if len(stored) else 2
    codes = bytes(stored[1:size])
    if len(codes) != size - 1:
        raise FormatError(
            "rans-table", f"table: {len(stored)} bytes, expected at least {size}", clause="6.9"
        )
    if codes[-1] == 0:
        raise FormatError(
            "rans-table",
            f"table: code 0 for symbol {len(codes) - 1}, the last, expected 1 to 255",
            clause="6.9",
        )
    return Table(codes), size


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
        if table.freqs[-1] == _TOTAL:
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
    np.bitwise_and(x, _TOTAL - 1, out=slot)
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


def _nearest_codes(weights: NDArray[np.float64]) -> U8:
    """Return the weight code nearest each weight by value, at least 1."""
    upper = np.searchsorted(_WEIGHTS, weights).clip(2, 255)
    lower = upper - 1
    below = weights - _WEIGHTS[lower] <= _WEIGHTS[upper] - weights
    return np.where(below, lower, upper).astype(np.uint8)


def _ideal_frequencies(counts: I64) -> NDArray[np.float64]:
    """Return the real frequencies of sum 4096, none below 1, with the shortest code.

    Those above 1 are in proportion to their counts, all of them 1 or more.
    """
    freqs = np.ones(counts.size)
    free = np.ones(counts.size, np.bool_)
    while True:
        share = (_TOTAL - int((~free).sum())) / int(counts[free].sum())
        short = free & (counts * share < 1.0)
        if not short.any():
            freqs[free] = counts[free] * share
            return freqs
        free &= ~short


def _checked_counts(counts: NDArray[np.integer]) -> I64:
    """Return counts as int64."""
    if counts.ndim != 1 or counts.size > 256 or (counts.size and counts.min() < 0):
        raise ValueError(f"counts {counts!r}, expected a row of up to 256, none below 0")
    return counts.astype(np.int64)


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
