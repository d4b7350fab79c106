"""Size of sorted Morton differences against octree occupancy coding of a point cloud."""

import math

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.encode.profiles.chunk_streams import chunk_means
from cogsplat.codec.geometry import morton
from cogsplat.codec.streams import records
from cogsplat.codec.streams.grid import fit
from cogsplat.tools.lab.synthetic.terrace import synth

# Initial adaptive count: a small value learns small alphabets fast.
START = 0.05


def occupancy_bits(codes: NDArray[np.uint32]) -> float:
    """Return the bits of an ideal adaptive coder for child masks, level by level from the root.

    Each level has its own counts of the 255 masks. Points in one cell are counted apart: which
    cells hold the surplus, at the cost of choosing them.
    """
    keys = np.sort(morton.interleave(codes))
    cells = np.unique(keys)
    depth = int(codes.max()).bit_length()
    bits = 0.0
    for level in range(depth):
        children = np.unique(cells >> np.uint64(3 * (depth - level - 1)))
        parents, inverse = np.unique(children >> np.uint64(3), return_inverse=True)
        masks = np.zeros(len(parents), np.int64)
        np.bitwise_or.at(masks, inverse, 1 << (children & np.uint64(7)).astype(np.int64))
        counts = np.bincount(masks, minlength=256)[1:]
        total = math.lgamma(len(masks) + 255 * START) - math.lgamma(255 * START)
        each = sum(math.lgamma(n + START) - math.lgamma(START) for n in counts if n)
        bits += (total - each) / math.log(2)
    surplus = len(keys) - len(cells)
    chosen = math.lgamma(len(keys)) - math.lgamma(len(cells)) - math.lgamma(surplus + 1)
    return bits + max(chosen, 0.0) / math.log(2)


def test_means_come_within_a_tenth_of_an_octree() -> None:
    means = synth(12_000, sh_degree=0).means
    for step in (0.3, 0.03, 0.003):
        _, stream, _ = chunk_means(means, step, sort=True)
        ours = 8 * len(records.pack([stream], digits=True))
        theirs = occupancy_bits(fit(means, step).quantise(means))
        assert ours < 1.1 * theirs, (
            f"{ours / len(means):.2f} against {theirs / len(means):.2f} bits"
        )
