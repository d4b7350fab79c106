"""How often the symbols of a byte plane occur: the tables of the rANS coder (SPEC 6.9)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .errors import FormatError

U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
I64 = NDArray[np.int64]

PRECISION: Final = 12
"""Bits of a slot."""

TOTAL: Final = 1 << PRECISION
"""What the frequencies of a table sum to, the number of slots."""

_MANTISSA: Final = 16  # weight codes below it are their own weight (SPEC 6.9)


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
        shares = running * (TOTAL - int(occurs.sum())) // running[-1]
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
        bias = np.arange(TOTAL) - self.cums[symbol]
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
        share = (TOTAL - int((~free).sum())) / int(counts[free].sum())
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
