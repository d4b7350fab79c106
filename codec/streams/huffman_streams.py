"""Exact ends of the Huffman streams in zstd frames, which libzstd checks in part (SPEC 6.3).

libzstd decodes two codes at once where a section of literals is long. It then accepts a stream
without the mark of its end, one whose last code reaches beyond its first bit, and one that has bits
left. RFC 8878 (4.2.2) allows none of them.
"""

from __future__ import annotations

import struct
from functools import cached_property
from typing import Final

import numpy as np

# RFC 8878, 3.1.1.2 and 3.1.1.3.1.1: types of blocks and of literals.
_RLE_BLOCK: Final = 1
_COMPRESSED_BLOCK: Final = 2
_FIRST_HUFFMAN_TYPE: Final = 2

# RFC 8878, 3.1.1.3.1.1: by size format, bits of each of the two sizes, and bytes of the header.
_SIZE_BITS: Final = (10, 10, 14, 18)
_HEADER_BYTES: Final = (3, 3, 4, 5)

# Symbols of a section of literals from which a table of several codes per lookup pays (measured).
_MIN_SYMBOLS_FOR_STEPS: Final = 1000

# Codes of at most 11 bits (RFC 8878, 4.2.1): five lookups take at most 55 of 56 bits.
_LOOKUPS: Final = 5
_WORD_BITS: Final = 56
_MAX_CODE_BITS: Final = 11


def end_exactly(frame: memoryview, start: int) -> bool:
    """Tell whether every Huffman stream of a frame ends with its last code.

    Parameters
    ----------
    frame : memoryview
        A whole frame that libzstd has decompressed.
    start : int
        Position of its first block, bytes.
    """
    code = None
    while True:
        header = int.from_bytes(frame[start : start + 3], "little")
        kind, size = header >> 1 & 3, header >> 3
        start += 3
        if kind == _COMPRESSED_BLOCK and frame[start] & 3 >= _FIRST_HUFFMAN_TYPE:
            code, streams = _literals(frame[start : start + size], code)
            if not all(_ends_exactly(stream, symbols, code) for stream, symbols in streams):
                return False
        start += 1 if kind == _RLE_BLOCK else size
        if header & 1:
            return True


class _Code:
    """Lookup tables of a Huffman code, by the next `bits` bits of a stream.

    Parameters
    ----------
    weights : list of int
        Weight of each symbol (RFC 8878, 4.2.1), the last one included.
    """

    def __init__(self, weights: list[int]) -> None:
        self.bits = sum(1 << weight >> 1 for weight in weights).bit_length() - 1
        self.lengths: list[int] = []
        for weight in sorted(weight for weight in weights if weight):
            self.lengths += [self.bits + 1 - weight] * (1 << weight >> 1)

    @cached_property
    def single_steps(self) -> list[int]:
        """Entries as in `steps`, of one code each."""
        return [length + 256 for length in self.lengths]

    @cached_property
    def steps(self) -> list[int]:
        """Per lookup window, the bits of its whole codes, plus 256 times the code count."""
        lengths = np.array(self.lengths)
        windows = np.arange(len(lengths))
        used = np.zeros_like(windows)
        codes = np.zeros_like(windows)
        while True:
            following = lengths[(windows << used) & (len(lengths) - 1)]
            whole = used + following <= self.bits
            if not whole.any():
                break
            used += following * whole
            codes += whole
        found: list[int] = (used + 256 * codes).tolist()
        return found


def _literals(
    block: memoryview, before: _Code | None
) -> tuple[_Code, list[tuple[memoryview, int]]]:
    """Return the Huffman code of a block's literals, and each stream with its symbol count.

    `before` is the code of the previous block, which a block may use again.
    """
    size_format = block[0] >> 2 & 3
    bits = _SIZE_BITS[size_format]
    sizes = int.from_bytes(block[:5], "little") >> 4
    symbols, stored = sizes & (1 << bits) - 1, sizes >> bits & (1 << bits) - 1
    at = _HEADER_BYTES[size_format]
    section = block[at : at + stored]
    if block[0] & 3 == _FIRST_HUFFMAN_TYPE or before is None:
        weights, length = _read_weights(section)
        before, section = _Code(weights), section[length:]
    if size_format == 0:
        return before, [(section, symbols)]
    part = (symbols + 3) // 4
    ends = np.cumsum((6, *struct.unpack_from("<3H", section))).tolist()
    return before, [
        (section[ends[0] : ends[1]], part),
        (section[ends[1] : ends[2]], part),
        (section[ends[2] : ends[3]], part),
        (section[ends[3] :], symbols - 3 * part),
    ]


def _ends_exactly(stream: memoryview, symbols: int, code: _Code) -> bool:
    """Tell whether `symbols` codes, read from the last bit down, use all bits of a stream."""
    # The highest set bit of the last byte marks the end of the stream.
    if not stream or not stream[-1]:
        return False
    at = 8 * len(stream) - 9 + stream[-1].bit_length()
    bits = code.bits
    mask = (1 << bits) - 1
    # A quarter of the symbols of a section.
    steps = code.steps if 4 * symbols >= _MIN_SYMBOLS_FOR_STEPS else code.single_steps
    while at > _WORD_BITS and symbols > _LOOKUPS * _MAX_CODE_BITS:
        low = at - _WORD_BITS
        word = int.from_bytes(stream[low >> 3 : (low >> 3) + 8], "little") >> (low & 7)
        unused = _WORD_BITS
        for _ in range(_LOOKUPS):
            step = steps[word >> unused - bits & mask]
            unused -= step & 255
            symbols -= step >> 8
        at -= _WORD_BITS - unused
    rest = int.from_bytes(stream[: (at >> 3) + 1], "little")
    for _ in range(symbols):
        rest &= (1 << at) - 1
        # Bits before the first one count as 0.
        at -= code.lengths[rest >> at - bits if at >= bits else rest << bits - at]
        if at < 0:
            return False
    return at == 0


def _read_weights(section: memoryview) -> tuple[list[int], int]:
    """Return the weights of a Huffman code, and the length of their description in bytes.

    RFC 8878, 4.2.1, has the layout.
    """
    header = section[0]
    if header >= 128:
        count = header - 127
        stored = section[1 : 1 + (count + 1) // 2]
        weights = [nibble for byte in stored for nibble in (byte >> 4, byte & 15)][:count]
        length = 1 + len(stored)
    else:
        weights = _read_fse_weights(section[1 : 1 + header])
        length = 1 + header
    total = sum(1 << weight >> 1 for weight in weights)
    # The last weight completes the sum to a power of two.
    return [*weights, ((1 << total.bit_length()) - total).bit_length()], length


def _read_fse_weights(stored: memoryview) -> list[int]:
    """Decode Huffman weights from two interleaved FSE states (RFC 8878, 4.2.1.2)."""
    states, bits, start = _read_fse_states(stored)
    stream = int.from_bytes(stored[start:], "little")
    at = stream.bit_length() - 1

    def take(count: int) -> int:
        nonlocal at
        at -= count
        return (stream >> at if at >= 0 else stream << -at) & (1 << count) - 1

    weights: list[int] = []
    state, other = take(bits), take(bits)
    while True:
        symbol, count, base = states[state]
        weights.append(symbol)
        if count > at:
            return [*weights, states[other][0]]
        state, other = other, base + take(count)


def _read_fse_states(stored: memoryview) -> tuple[list[tuple[int, int, int]], int, int]:
    """Parse an FSE table description, and build its decoding table (RFC 8878, 4.1.1).

    Returns
    -------
    states : list of (symbol, bits, base)
        Symbol of each state. The next state is `base` plus the next `bits` bits of the stream.
    bits : int
        Accuracy log: bits of a state's number.
    length : int
        Length of the description, bytes.
    """
    field = int.from_bytes(stored, "little")
    log, at = (field & 15) + 5, 4
    left = 1 << log
    frequencies: list[int] = []
    while left > 0:
        count = (left + 1).bit_length()
        low = (1 << count - 1) - 1
        short = (1 << count) - 2 - left
        value = field >> at & low
        if value < short:
            at += count - 1
        else:
            value = field >> at & (1 << count) - 1
            value -= short if value > low else 0
            at += count
        frequency = value - 1
        left -= abs(frequency)
        frequencies.append(frequency)
        while frequency == 0:
            zeros = field >> at & 3
            at += 2
            frequencies += [0] * zeros
            if zeros < 3:
                break
    return _spread(frequencies, log), log, (at + 7) // 8


def _spread(frequencies: list[int], log: int) -> list[tuple[int, int, int]]:
    """Build the FSE decoding table of 2^`log` states from symbol frequencies (RFC 8878, 4.1.1)."""
    size = 1 << log
    rare = [symbol for symbol, frequency in enumerate(frequencies) if frequency == -1]
    high = size - len(rare)
    symbols = [0] * high + rare[::-1]
    position = 0
    for symbol, frequency in enumerate(frequencies):
        for _ in range(frequency):
            symbols[position] = symbol
            position = position + (size >> 1) + (size >> 3) + 3 & size - 1
            while position >= high:
                position = position + (size >> 1) + (size >> 3) + 3 & size - 1
    following = [abs(frequency) for frequency in frequencies]
    states = []
    for symbol in symbols:
        state = following[symbol]
        following[symbol] += 1
        bits = log + 1 - state.bit_length()
        states.append((symbol, bits, (state << bits) - size))
    return states
