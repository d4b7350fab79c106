"""The compiled loops of `rans`. They hold integers only, so nothing in them can be fused."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from .kernels import kernel

U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]
U32 = NDArray[np.uint32]
Integers = NDArray[np.integer]  # what `rans` keeps as int64 for numpy; here uint32 and uint16

# Unsigned, because numba makes uint64 with int64 a float64, and looks for negative indices.
_ZERO: Final = np.uint64(0)
_ONE: Final = np.uint64(1)
_PRECISION: Final = np.uint64(12)
_SLOT_MASK: Final = np.uint64(0xFFF)
_SYMBOL_MASK: Final = np.uint64(0xFF)
_FREQ_SHIFT: Final = np.uint64(8)
_BIAS_SHIFT: Final = np.uint64(20)
_WORD_BITS: Final = np.uint64(16)
_WORD_MASK: Final = np.uint64(0xFFFF)
_LOW: Final = np.uint64(0x1_0000)
_EMIT_SHIFT: Final = np.uint64(20)


@kernel
def decode_plane(
    states: Integers, words: Integers, position: int, num_words: int, entries: U32, symbols: U8
) -> int:
    """Decode one plane; `states` and `symbols` are written.

    Parameters
    ----------
    states : (K,) uint32
        In [2^16, 2^32).
    words : (num_words + K,) uint16
        The last K are padding, which lets the inner loop read before it knows whether to.
    position : int
        Words read so far, 0 to `num_words`.
    num_words : int
    entries : (4096,) uint32
        ``symbol | freq - 1 << 8 | slot - cum << 20`` of every slot.
    symbols : (n,) uint8

    Returns
    -------
    int
        Words read in all; more than `num_words` where they ran out.
    """
    lanes = states.size
    count = symbols.size
    end = np.uint64(num_words)
    p = np.uint64(position)
    for start in range(0, count, lanes):
        for k in range(min(lanes, count - start)):
            x = np.uint64(states[np.uint64(k)])
            entry = np.uint64(entries[x & _SLOT_MASK])
            symbols[np.uint64(start + k)] = np.uint8(entry & _SYMBOL_MASK)
            freq = ((entry >> _FREQ_SHIFT) & _SLOT_MASK) + _ONE
            x = freq * (x >> _PRECISION) + (entry >> _BIAS_SHIFT)
            # Without a branch: whether a lane needs a word is what a predictor cannot know.
            refilled = (x << _WORD_BITS) | np.uint64(words[p])
            need = x < _LOW
            p += _ONE if need else _ZERO
            states[np.uint64(k)] = np.uint32(refilled if need else x)
        if p > end:
            break
    return int(p)


@kernel
def encode_plane(states: U32, words: U16, position: int, freqs: U32, cums: U32, symbols: U8) -> int:
    """Encode one plane from its last symbol to its first; `states` and `words` are written.

    Parameters
    ----------
    states : (K,) uint32
        In [2^16, 2^32).
    words : (at least position,) uint16
        Filled from `position` downwards.
    position : int
        Index of the first word written so far; at least n.
    freqs, cums : (256,) uint32
        Frequency of each symbol, and the sum of those before it.
    symbols : (n,) uint8
        Of frequency 1 or more.

    Returns
    -------
    int
        Index of the first word written.
    """
    lanes = np.uint64(states.size)
    p = np.uint64(position)
    i = np.uint64(symbols.size)
    while i > _ZERO:
        i -= _ONE
        k = i % lanes
        x = np.uint64(states[k])
        symbol = np.uint64(symbols[i])
        freq = np.uint64(freqs[symbol])
        if x >= freq << _EMIT_SHIFT:
            p -= _ONE
            words[p] = np.uint16(x & _WORD_MASK)
            x >>= _WORD_BITS
        quotient = x // freq
        x = (quotient << _PRECISION) + (x - quotient * freq) + np.uint64(cums[symbol])
        states[k] = np.uint32(x)
    return int(p)
