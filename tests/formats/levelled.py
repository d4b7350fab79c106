"""A small file with levels, made by the encoder's own chunks, that several tests read."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
from cogs_samples import encoded

from cogsplat.codec.encode.encoded import EncodedLevel
from cogsplat.codec.segments.opacities import pack_opacities
from cogsplat.formats.cogs import scene_writer as cogs
from cogsplat.formats.cogs.writer import lay_out

STEP = 0.02


def unit(logit):
    """The opacity of a logit."""
    return 1 / (1 + math.exp(-float(logit)))


@cache
def levelled_scene():
    """Six chunks, levels of two, four and six; chunk 1 ends at level 1, chunk 2 at level 2.

    Returns
    -------
    EncodedScene, and for each level the logits of the chunks that it draws, by their numbers
    """
    made = encoded("transform")
    assert len(made.chunks) == 6
    ends = np.cumsum([0, *(chunk.splats for chunk in made.chunks)])
    first = [made.decoded.opacities[ends[k] : ends[k + 1]] for k in range(6)]
    rng = np.random.default_rng(7)
    second = {0: first[0] + rng.normal(0, 1, len(first[0])).astype(np.float32)}
    third = {
        0: rng.normal(0, 3, len(first[0])).astype(np.float32),
        3: first[3] - np.float32(0.5),
    }
    payloads = {
        0: (pack_opacities(second[0], first[0], STEP), pack_opacities(third[0], first[0], STEP)),
        3: (pack_opacities(third[3], first[3], STEP),),
    }
    until = {1: 4, 2: 6}
    chunks = [
        replace(chunk, opacities=payloads.get(number, ()), until=until.get(number, 0))
        for number, chunk in enumerate(made.chunks)
    ]
    levels = (EncodedLevel(2, 4.0), EncodedLevel(4, 2.0), EncodedLevel(6, 1.0))
    expected = [
        {0: first[0], 1: first[1]},
        {0: second[0], 2: first[2], 3: first[3]},
        {0: third[0], 3: third[3], 4: first[4], 5: first[5]},
    ]
    return replace(made, chunks=chunks, levels=levels), expected


@cache
def levelled_file():
    """The bytes of that scene's file."""
    scene, _ = levelled_scene()
    return b"".join(lay_out(cogs.build_root(scene, "samples"), cogs.segments(scene)))
