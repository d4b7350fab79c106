"""Scenes that hypothesis makes, through every writer, every reader and the three COGS decoders."""

import os
import random
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from encoding import encode, unseen
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from made_scenes import made_scenes
from seeds import corpus
from targets import ARRAYS, TARGETS, check_splats, run_once
from value_mutations import with_other_values

from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.splats import Splats
from cogsplat.formats.cogs.scene_writer import save
from cogsplat.formats.scenes.registry import FORMATS, WRITABLE, write_scene

EXAMPLES = max(10, int(os.environ.get("COGSPLAT_FUZZ", "40")) // 4)

# Targets whose inputs hold no scene or cameras, or whose values are changed elsewhere.
NO_VALUES = {"cogs", "mask", "http", "checkpoint", "folder", "upload"}
NO_VALUES |= {"batch_jsonl", "batch_toml", "batch_log"}

made = settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))


@pytest.mark.parametrize("profile", ["transform", "vq", "near-lossless"])
@made
@given(data=st.data())
def test_three_decoders_give_the_same_bits_of_every_scene(
    profile: str, data: st.DataObject
) -> None:
    """Numpy, the compiled kernels and the reference decoder, which knows SPEC.md alone."""
    splats = data.draw(made_scenes())
    config = unseen(
        profile=profile,
        quality_db=data.draw(st.sampled_from([20.0, 40.0, 80.0])),
        chunk_splats=data.draw(st.sampled_from([1, 3, 1000])),
        refine=data.draw(st.booleans()),
        prune=None,
    )
    encoded = encode(splats, config=config)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.cogs"
        save(encoded, path, writer="made")
        # Its reader is all three of them, compared to the bit.
        assert run_once(TARGETS["cogs"], path.read_bytes()) is None


def through(splats: Splats, name: str) -> Splats:
    """Return what a format gives back of a scene."""
    format_ = next(format_ for format_ in FORMATS if format_.name == name)
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        # What a format cannot hold, and values that it clips, are said in warnings.
        warnings.simplefilter("ignore", CogsplatWarning)
        path = Path(folder) / f"a{format_.extensions[0]}"
        write_scene(splats, path)
        return format_.read(path)


@pytest.mark.parametrize("name", WRITABLE)
@made
@given(data=st.data())
def test_every_format_gives_back_every_scene(name: str, data: st.DataObject) -> None:
    """The rows in their number, the arrays as promised, and the same from what was read."""
    # glTF has no empty arrays.
    splats = data.draw(made_scenes(least_rows=1 if name == "gltf" else 0))
    found = through(splats, name)
    check_splats(found)
    assert len(found) == len(splats)
    assert found.sh_degree == (0 if name == "splat" else splats.sh_degree)
    if name == "ply":
        for array in ARRAYS:
            np.testing.assert_array_equal(getattr(found, array), getattr(splats, array))
    # Formats of bytes store the ends of opacity, whose logits are infinite.
    again = through(replace(found, opacities=np.clip(found.opacities, -16, 16)), name)
    check_splats(again)
    assert len(again) == len(splats)


@pytest.mark.parametrize("name", [name for name in TARGETS if name not in NO_VALUES])
def test_files_with_other_values_are_mostly_read(name: str) -> None:
    """What readers promise of files that they accept: most random changes are refused instead."""
    target = TARGETS[name]
    files = [data for data in corpus(name).values() if run_once(target, data) is None]
    rng = random.Random(5)
    changed = [with_other_values(name, rng.choice(files), seed) for seed in range(EXAMPLES)]
    accepted = [run_once(target, data) is None for data in changed]
    assert sum(accepted) > EXAMPLES / 2
    assert len(set(changed)) > EXAMPLES / 4
