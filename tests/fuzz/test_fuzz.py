"""The corpus, and so many mutations of it, through every reader: refusals or what was promised.

The number is fixed and not the time, so that a run finds the same things everywhere. ``.ci/run``
asks for more of them with ``COGSPLAT_FUZZ``, and ``run.py`` goes on for as long as one likes.
"""

import os
import random
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from http_scripts import made_script, parsed, via_of
from hypothesis import given, settings
from hypothesis import strategies as st
from mutations import mutated
from seeds import CORPUS, corpus
from targets import TARGETS, Target, decoded, joined, run_once, same_bits, split

from cogsplat.codec.errors import CogsplatError

MUTATIONS = int(os.environ.get("COGSPLAT_FUZZ", "40"))
"""Mutations for each target."""

# What the findings that the corpus keeps are refused with.
REFUSALS = {
    ("sog", "one_entry_inflated_for_every_image"): "sog-zip-ratio",
    ("sog", "a_million_splats_in_one_colour"): "too-many-splats",
    ("sog", "overlapping_entries"): "sog-zip",
    ("sog", "many_entries"): "sog-zip",
    ("glb", "shared_accessors"): "gltf-too-many-instances",
    ("glb", "matrix_1e308"): "gltf-shear",
    ("glb", "scale_-1e-110"): "gltf-bad-transform",
    ("glb", "scale_0"): "gltf-shear",
    ("glb", "rotation_1e200"): "gltf-bad-transform",
    ("glb", "escape_sequences"): "gltf-extension",
    ("gltf", "empty_arrays"): "gltf-bad-buffer",
    ("spz", "zeros_1"): "decoded-size",
    ("spz", "zeros_2"): "decoded-size",
    ("spz", "zeros_3"): "decoded-size",
    ("spz", "zeros_4"): "decoded-size",
    ("ply", "empty_lists"): "",
    ("cameras_json", "empty_arrays"): "",
    ("cameras_json", "many"): "",
    ("transforms_json", "one_picture"): "",
    ("colmap_txt", "long_line"): "colmap-malformed",
    ("colmap_txt", "format_characters_in_a_name"): "camera-model",
    ("points_bin", "track_beyond_the_file"): "colmap-truncated",
    ("points_txt", "long_line"): "",
    ("points_txt", "beyond_doubles"): "bad-point",
    ("pt", "large_memo"): "torch-file",
    ("pt", "large_frame"): "torch-file",
    ("pt", "key_of_nested_tuples"): "torch-file",
    ("pt", "id_of_nested_tuples"): "torch-file",
    ("checkpoint", "plain_array"): "bad-checkpoint",
    ("checkpoint", "directory_before_the_file"): "bad-checkpoint",
    ("checkpoint", "missing_arrays"): "bad-checkpoint",
    ("checkpoint", "zeros"): "bad-checkpoint",
    ("checkpoint", "zeros_of_another_run"): "other-checkpoint",
    ("batch_jsonl", "nul"): "",
    ("batch_jsonl", "surrogate"): "",
    ("batch_jsonl", "long_name"): "",
    ("batch_jsonl", "stream"): "",
    ("batch_jsonl", "two_spellings"): "same-output",
    ("batch_toml", "scene_of_a_number"): "bad-manifest",
    ("mask", "text_that_inflates"): "mask",
    ("mask", "eps"): "mask",
    ("http", "byte_a_range"): "connection-broken",
    ("http", "drip"): "network-timeout",
    ("http", "whole_file_for_a_range"): "",
    ("http", "object_of_the_year_10000"): "connection-broken",
    ("http", "manifest_without_end"): "",
    ("http", "body_without_end"): "",
    ("http", "letters_without_end"): "not-cogs",
    ("http", "redirect_to_no_host"): "redirect-refused",
    ("http", "retry_in_an_absurd_zone"): "",
    ("http", "whole_file_that_breaks_then_ranges"): "",
    ("http", "whole_and_ranges_in_turn"): "",
}

every_target = pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS.keys())


@every_target
def test_the_corpus_has_files_that_are_read(target: Target) -> None:
    found = [run_once(target, data) for data in corpus(target.name).values()]
    if target.name == "mask":
        assert found
    else:
        assert None in found


def test_every_folder_of_the_corpus_has_a_target() -> None:
    assert {path.name for path in CORPUS.iterdir()} <= set(TARGETS)


@pytest.mark.parametrize(("target", "name"), REFUSALS)
def test_findings_stay_mended(target: str, name: str) -> None:
    error = run_once(TARGETS[target], (CORPUS / target / name).read_bytes())
    assert (error.code if error else "") == REFUSALS[target, name]


@every_target
def test_mutations_are_refused_or_read(target: Target) -> None:
    files = list(corpus(target.name).values())
    rng = random.Random(1)
    for seed in range(MUTATIONS):
        run_once(target, mutated(rng.choice(files), seed))


def test_scripted_servers_are_refused_or_read() -> None:
    """Responses with a few faults each, which most mutations of the corpus do not make."""
    codes = set()
    for seed in range(MUTATIONS):
        error = run_once(TARGETS["http"], made_script(seed))
        codes.add(error.code if error else "")
    # Neither all refused nor all read.
    assert codes >= {"", "answer-range"}


def test_scripts_of_servers_are_the_same_for_the_same_seed() -> None:
    scripts = [made_script(seed) for seed in range(30)]
    assert scripts == [made_script(seed) for seed in range(30)]
    assert len(set(scripts)) > 20
    assert {via_of(parsed(script)) for script in scripts} == {"file", "folder", "s3"}


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(corpus("cogs").items())), st.integers(0, 1 << 32))
def test_numpy_and_kernels_agree_on_verdict_code_and_bits(
    file: tuple[str, bytes], seed: int
) -> None:
    data = mutated(file[1], seed)
    plain, fast = decoded(data, kernels=False), decoded(data, kernels=True)
    if isinstance(plain, CogsplatError) or isinstance(fast, CogsplatError):
        assert getattr(plain, "code", "") == getattr(fast, "code", "")
    else:
        assert same_bits(plain, fast)


def test_scenes_that_differ_in_a_bit_are_told_apart() -> None:
    data = next(iter(corpus("cogs").values()))
    scene = decoded(data, kernels=False)
    assert not isinstance(scene, CogsplatError)
    other = decoded(data, kernels=False)
    assert not isinstance(other, CogsplatError)
    assert same_bits(scene, other)
    if len(other):
        other.means[0, 0] = np.nextafter(other.means[0, 0], np.float32(np.inf))
        assert not same_bits(scene, other)


@given(st.lists(st.binary(max_size=9), min_size=1, max_size=3))
def test_inputs_of_several_files_come_apart_as_they_were(parts: list[bytes]) -> None:
    assert split(joined(*parts), len(parts)) == parts


@pytest.mark.parametrize("name", [name for name in TARGETS if name != "cogs"])
def test_mutations_are_the_same_for_the_same_seed(name: str) -> None:
    for data in list(corpus(name).values())[:3]:
        changed = [mutated(data, seed) for seed in range(8)]
        assert changed == [mutated(data, seed) for seed in range(8)]
        assert any(one != data for one in changed)


def test_the_command_for_an_hour_runs(tmp_path: Path) -> None:
    command = [sys.executable, str(Path(__file__).with_name("run.py")), "splat", "--mutations", "2"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stdout.startswith("splat: ")
    assert list(tmp_path.iterdir()) == []
