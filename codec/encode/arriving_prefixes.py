"""Prefixes of a scene as they are decoded while its file arrives: coarse heads, few tails."""

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
class Arrived:
    """What there is of a prefix beside its heads.

    Parameters
    ----------
    refined, tailed : frozenset of int
        Chunks whose refinement and whose tail have arrived.
    """

    refined: frozenset[int]
    tailed: frozenset[int]


def arrived(encoded: EncodedScene) -> list[Arrived]:
    """Return what there is of each prefix half-way, in bytes, between its last head and the next.

    Parameters
    ----------
    encoded : EncodedScene
        Its `prefix_mse` decides the order of the segments.

    Returns
    -------
    list of Arrived
        Of the first chunk, of the first two, and so on, without that of all chunks.
    """
    behind: list[list[OrderedSegment]] = []
    for place in encoded.placed():
        if place.kind is OrderedKind.HEAD:
            behind.append([])
        else:
            behind[-1].append(place)
    found: list[Arrived] = []
    before: list[OrderedSegment] = []
    for places in behind[:-1]:
        ends = np.cumsum([encoded.placed_bytes(place) for place in places])
        half = int((2 * ends <= ends[-1:]).sum())
        there = [*before, *places[:half]]
        found.append(
            Arrived(_owners(there, OrderedKind.REFINEMENT), _owners(there, OrderedKind.TAIL))
        )
        before += places
    return found


def _owners(places: Sequence[OrderedSegment], kind: OrderedKind) -> frozenset[int]:
    return frozenset(place.chunk for place in places if place.kind is kind)


def arriving(encoded: EncodedScene, prefixes: Sequence[int], most_splats: int) -> list[Splats]:
    """Return prefixes as they are decoded half-way between their last head and the next.

    Parameters
    ----------
    encoded : EncodedScene
    prefixes : sequence of int
        Chunks of each, ascending, less than all.
    most_splats : int
        Prefixes of more are returned as the whole file has them, without copies: by then most of
        what their chunks have is there.

    Returns
    -------
    list of Splats
        Of all their chunks; splats of those that have ended have a logit of minus infinity, with
        which nothing is drawn.
    """
    ends = np.concatenate([[0], np.cumsum([chunk.splats for chunk in encoded.chunks])])
    runs = [slice(*pair) for pair in pairwise(ends.tolist())]
    states = arrived(encoded)
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
    """Return a prefix that shows nothing of chunks that have ended (SPEC 5.10)."""
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
    """Return the first chunks as their heads alone have them, without higher SH coefficients."""
    rows = np.arange(runs[-1].stop if runs else 0)
    coarse = encoded.decoded.with_sh_degree(0).take(rows)
    for chunk, run in zip(encoded.chunks, runs, strict=False):
        # Where there is no refinement the head holds all; heads that need a codebook have none.
        if chunk.payloads.refinement is not None:
            decode_head(memoryview(chunk.payloads.head), {}, coarse.take(run), "chunk")
    return coarse
