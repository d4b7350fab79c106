"""Files that the container's tests share, encoded from made-up scenes."""

from dataclasses import replace
from functools import cache

import numpy as np
from encoding import encode, unseen
from random_splats import random_splats

from cogsplat.formats.cogs import scene_writer as cogs
from cogsplat.formats.cogs.writer import lay_out

ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")


def scene(count, degree=3):
    """Return random splats with SH up to a degree, within a few units of the origin."""
    splats = random_splats(count, (degree + 1) ** 2 - 1, sh_scale=0.1)
    return replace(splats, means=splats.means / np.float32(5))


@cache
def encoded(profile, count=900, degree=3, chunk=150):
    return encode(
        scene(count, degree), None, unseen(profile=profile, chunk_splats=chunk, prune=None)
    )


@cache
def file_of(profile, count=900, degree=3, chunk=150):
    made = encoded(profile, count, degree, chunk)
    root = cogs.build_root(made, "samples")
    return b"".join(lay_out(root, cogs.segments(made)))


def assert_same(actual, expected, rows=slice(None)):
    """Compare the bits of all arrays with rows of a scene's."""
    for name in ARRAYS:
        found, wanted = getattr(actual, name), getattr(expected, name)[rows]
        assert found.shape == wanted.shape, name
        assert np.array_equal(found.view(np.uint32), wanted.view(np.uint32)), name
