"""Radix sort of 64-bit keys, and with it the depth order: nearest first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with

from .jit import kernel

# Digits of 11 bits: their histogram fits into the first-level cache, and six make a float64.
_DIGIT_BITS = 11
_DIGITS = 6
_VALUES = 1 << _DIGIT_BITS


@called_with("uint64[::1], int32[::1], uint64[::1], int32[::1], int64[:, ::1]")
@kernel
def _sort(
    keys: NDArray[np.uint64],
    places: NDArray[np.int32],
    spare_keys: NDArray[np.uint64],
    spare_places: NDArray[np.int32],
    counts: NDArray[np.int64],
) -> bool:
    """Sort keys by digits, lowest digit first; return whether the result is in the spare arrays.

    Parameters
    ----------
    keys : (M,) uint64
        Keys to sort.
    places : (M,) int32
        Values that are permuted with the keys.
    spare_keys, spare_places : (M,) uint64, int32
        Scratch arrays.
    counts : (_DIGITS, _VALUES) int64
        Scratch array of zeros.
    """
    mask = np.uint64(_VALUES - 1)
    for i in range(len(keys)):
        key = keys[i]
        for digit in range(_DIGITS):
            counts[digit, (key >> np.uint64(digit * _DIGIT_BITS)) & mask] += 1
    source_keys, source_places = keys, places
    target_keys, target_places = spare_keys, spare_places
    swapped = False
    for digit in range(_DIGITS):
        shift = np.uint64(digit * _DIGIT_BITS)
        first = 0
        # If all keys share a digit, as with the highest digits of similar depths, skip it.
        alone = False
        for value in range(_VALUES):
            count = counts[digit, value]
            alone |= count == len(keys)
            counts[digit, value] = first
            first += count
        if alone:
            continue
        for i in range(len(keys)):
            key = source_keys[i]
            value = (key >> shift) & mask
            to = counts[digit, value]
            counts[digit, value] = to + 1
            target_keys[to] = key
            target_places[to] = source_places[i]
        source_keys, target_keys = target_keys, source_keys
        source_places, target_places = target_places, source_places
        swapped = not swapped
    return swapped


def key_order(keys: NDArray[np.uint64]) -> NDArray[np.int32]:
    """Return the permutation that sorts keys in ascending order, ties in their original order.

    Parameters
    ----------
    keys : (M,) uint64
        Keys, overwritten.

    Returns
    -------
    (M,) int32
        Equal to ``np.argsort(keys, kind="stable")``, in a fraction of the time.
    """
    places = np.arange(len(keys), dtype=np.int32)
    spare_keys, spare_places = np.empty_like(keys), np.empty_like(places)
    counts = np.zeros((_DIGITS, _VALUES), np.int64)
    return spare_places if _sort(keys, places, spare_keys, spare_places, counts) else places


def depth_order(depths: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the permutation that sorts depths in ascending order, ties in their original order.

    Parameters
    ----------
    depths : (M,) float64
        Positive depths; the bits of positive floats sort like their values.

    Returns
    -------
    (M,) int32
        Equal to ``np.argsort(depths, kind="stable")``, in a fraction of the time.
    """
    return key_order(depths.view(np.uint64).copy())
