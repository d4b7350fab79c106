"""Prefixes of a scene decoded from a partly received file: coarse heads, few tails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from cogsplat.codec.rate.segment_order import OrderedKind, OrderedSegment
from cogsplat.codec.segments.heads import decode_head
from cogsplat.codec.splats import Splats

from .encoded import EncodedScene

_OF_HEADS: Final = ("means", "scales", "quats", "opacities", "sh0")


@dataclass(frozen=True)
class ReceivedParts:
    """Refinements and tails received so far for a prefix, whose heads are all received.

    Parameters
    ----------
    refined : frozenset of int
        Chunks whose refinement is received.
    tailed : frozenset of int
        Chunks whose tail is received.
    """

    refined: frozenset[int]
    tailed: frozenset[int]


def received_parts(encoded: EncodedScene) -> list[ReceivedParts]:
    """Return the refinements and tails that each prefix has half-way in bytes to the next head.

    Parameters
    ----------
    encoded : EncodedScene
        Encoded scene; its `prefix_mse` decides the order of segments.

    Returns
    -------
    list of ReceivedParts
        Parts of each prefix, from 1 chunk to all but one.
    """
    behind: list[list[OrderedSegment]] = []
    for place in encoded.ordered_segments():
        if place.kind is OrderedKind.HEAD:
            behind.append([])
        else:
            behind[-1].append(place)
    found: list[ReceivedParts] = []
    before: list[OrderedSegment] = []
    for places in behind[:-1]:
        ends = np.cumsum([encoded.segment_bytes(place) for place in places])
        half = int((2 * ends <= ends[-1:]).sum())
        there = [*before, *places[:half]]
        found.append(
            ReceivedParts(
                _chunks_with(there, OrderedKind.REFINEMENT), _chunks_with(there, OrderedKind.TAIL)
            )
        )
        before += places
    return found


def _chunks_with(places: Sequence[OrderedSegment], kind: OrderedKind) -> frozenset[int]:
    """Return the numbers of the chunks that have a segment of a kind among `places`."""
    return frozenset(place.chunk for place in places if place.kind is kind)


def decode_partial_prefixes(
    encoded: EncodedScene, prefixes: Sequence[int], most_splats: int
) -> list[Splats]:
    """Decode prefixes from the segments received half-way between their last head and the next.

    Parameters
    ----------
    encoded : EncodedScene
        Encoded scene.
    prefixes : sequence of int
        Number of chunks of each prefix, ascending, fewer than all.
    most_splats : int
        Size above which prefixes are taken from the complete file, without copies: most of their
        refinements and tails are received by then.

    Returns
    -------
    list of Splats
        Splats of each prefix. Opacity logits of chunks that are no longer drawn are minus infinity.
    """
    ends = np.concatenate([[0], np.cumsum([chunk.splats for chunk in encoded.chunks])])
    runs = [slice(*pair) for pair in pairwise(ends.tolist())]
    states = received_parts(encoded)
    short = [chunks for chunks in prefixes if ends[chunks] <= most_splats]
    coarse = _heads(encoded, runs[: short[-1]] if short else [])
    found = []
    for chunks in prefixes:
        prefix = encoded.decoded.take(slice(0, runs[chunks - 1].stop))
        if chunks in short:
            state = states[chunks - 1]
            prefix = prefix.take(np.arange(len(prefix)))
            for number, run in enumerate(runs[:chunks]):
                if number not in state.refined:
                    for name in _OF_HEADS:
                        getattr(prefix, name)[run] = getattr(coarse, name)[run]
                if number not in state.tailed:
                    prefix.shN[run] = 0.0
        found.append(_without_ended(prefix, encoded, chunks, runs))
    return found


def _without_ended(
    prefix: Splats, encoded: EncodedScene, chunks: int, runs: Sequence[slice]
) -> Splats:
    """Return a prefix with chunks that are no longer drawn made transparent (SPEC 5.10)."""
    ended = [
        run for run, chunk in zip(runs, encoded.chunks, strict=True) if 0 < chunk.until <= chunks
    ]
    if not ended:
        return prefix
    opacities = prefix.opacities.copy()
    for run in ended:
        opacities[run] = -np.inf
    return replace(prefix, opacities=opacities)


def _heads(encoded: EncodedScene, runs: Sequence[slice]) -> Splats:
    """Return the first chunks decoded from their heads alone, at SH degree 0.

    `runs` holds the row range of each chunk in `encoded.decoded`.
    """
    rows = np.arange(runs[-1].stop if runs else 0)
    coarse = encoded.decoded.with_sh_degree(0).take(rows)
    degree = encoded.decoded.sh_degree
    books = {
        number: book.decode(degree)
        for number, book in enumerate(encoded.codebooks)
        if book.attribute == "shape"
    }
    for chunk, run in zip(encoded.chunks, runs, strict=False):
        # A head without refinement is complete.
        if chunk.payloads.refinement is not None:
            decode_head(memoryview(chunk.payloads.head), books, coarse.take(run), "chunk")
    return coarse
