"""Compensation of scenes that are joined: their layers side by side, as far as they fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .prefix_compensation import MAX_CODE_BITS, Compensation, Layer

I64 = NDArray[np.int64]


def layers_of_chunks(compensation: Compensation) -> I64:
    """Return the first layer of each chunk, (c,) int64: the number of layers for chunks in none."""
    ends = [layer.chunks for layer in compensation.layers]
    return np.searchsorted(ends, np.arange(len(compensation.chunk_splats)), side="right")


def join_compensations(
    parts: Sequence[Compensation], places: Sequence[I64], most_chunks: int
) -> Compensation:
    """Return layers of a joined scene, each made of one layer of every part.

    Parameters
    ----------
    parts : sequence of Compensation
        Compensation of each part, at least one.
    places : sequence of (c,) int64
        Number of each part's chunks in the joined scene. Chunks of earlier layers
        (`layers_of_chunks`) come first.
    most_chunks : int
        Maximum number of chunks of a layer; a layer with more, and all after it, are left out.

    Returns
    -------
    Compensation
        As many layers as every part has. Where the books of the parts have more distinct rows than
        a layer can hold, the layer has no codes: its chunks are shifted as a whole.
    """
    splats = np.zeros(sum(len(own) for own in places), np.int64)
    for part, own in zip(parts, places, strict=True):
        splats[own] = part.chunk_splats
    layers: list[Layer] = []
    for number in range(min(len(part.layers) for part in parts)):
        found = [part.layers[number] for part in parts]
        if sum(layer.chunks for layer in found) > most_chunks:
            break
        firsts = [part.layers[number - 1].chunks if number else 0 for part in parts]
        layers.append(_join_layers(found, firsts, parts, places))
    return Compensation(layers, splats)


def _join_layers(
    layers: Sequence[Layer],
    firsts: Sequence[int],
    parts: Sequence[Compensation],
    places: Sequence[I64],
) -> Layer:
    """Return the layer of all parts; `firsts` are the chunks of the layers before."""
    chunks = sum(layer.chunks for layer in layers)
    scales, opacities = np.zeros(chunks, np.int8), np.zeros(chunks, np.int8)
    strengths = np.zeros((chunks, 2), np.uint8)
    for layer, own in zip(layers, places, strict=True):
        held = own[: layer.chunks]
        scales[held], opacities[held] = layer.scales, layer.opacities
        strengths[held] = layer.strengths
    # A row of zeros stands for the entries of a part without a book.
    books = [layer.book if len(layer.book) else np.zeros((1, 2), np.int8) for layer in layers]
    book, rows = np.unique(np.concatenate(books), axis=0, return_inverse=True)
    if len(book) > 1 << MAX_CODE_BITS or not any(len(layer.book) for layer in layers):
        none = np.zeros(0, np.uint8)
        return Layer(scales, opacities, strengths, np.zeros((0, 2), np.int8), none)
    row_of = np.split(rows.reshape(-1), np.cumsum([len(each) for each in books])[:-1])
    # Codes of each chunk that the layer before lacks, in the order of the joined scene.
    codes: list[tuple[int, NDArray[np.uint8]]] = []
    for layer, first, part, own, names in zip(layers, firsts, parts, places, row_of, strict=True):
        counts = part.chunk_splats[first : layer.chunks]
        given = layer.codes if len(layer.book) else np.zeros(int(counts.sum()), np.uint8)
        new = np.split(names[given].astype(np.uint8), np.cumsum(counts)[:-1])
        codes += zip(own[first : layer.chunks].tolist(), new, strict=True)
    ordered = [each for _, each in sorted(codes, key=lambda pair: pair[0])]
    return Layer(scales, opacities, strengths, book, np.concatenate(ordered))
