"""Compiled decoding against numpy's: the same bits, the same refusals."""

import json
import sys
from pathlib import Path

import decoding
import numpy as np
import pytest
from encoding import encode, unseen

import cogsplat.codec.streams as streams
from cogsplat.codec.errors import CogsplatError
from cogsplat.codec.geometry import rotations
from cogsplat.codec.streams import (
    compiled,
    kinds,
    records,
    refinement_bits,
    scalar,
    sorted_means,
    swing_twist,
)
from cogsplat.codec.streams.adaptive_step import MAX_EXTRA_BITS, StepModel
from cogsplat.codec.streams.byte_planes import DIGITS, pack_plane, unpack_plane
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.inputs import Inputs
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.storage.source import BytesSource
from cogsplat.tools.synthetic.scene import synth

VECTORS = Path(__file__).resolve().parents[2] / "vectors"
MANIFEST = json.loads((VECTORS / "manifest.json").read_text(encoding="utf-8"))
ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")


@pytest.fixture
def both():
    """Call something with numpy alone and then with kernels."""
    before = compiled.ready()

    def call(function):
        compiled.use(False)
        plain = function()
        compiled.prepare(compiled.WORTH_LOADING)
        assert compiled.ready()
        return plain, function()

    yield call
    compiled.use(before)


def assert_same_bits(actual, expected):
    for name in ARRAYS:
        ours, theirs = getattr(actual, name), getattr(expected, name)
        assert np.array_equal(ours.view(np.uint32), theirs.view(np.uint32)), name


def test_valid_vectors_decode_to_the_same_bits(both):
    for entry in MANIFEST["valid"]:
        data = (VECTORS / "valid" / f"{entry['name']}.cogs").read_bytes()
        for degree in range(entry["sh_degree"] + 1):
            with open_cogs(BytesSource(data)) as file:
                plain, fast = both(lambda: file.decode(sh_degree=degree))  # noqa: B023
            assert_same_bits(fast, plain)


def test_invalid_vectors_are_refused_in_the_same_words(both):
    def refusal(data):
        try:
            with open_cogs(BytesSource(data)) as file:
                file.decode()
                file.verify()
        except CogsplatError as error:
            return type(error), error.code, error.message
        return None

    for entry in MANIFEST["invalid"]:
        data = (VECTORS / "invalid" / f"{entry['name']}.cogs").read_bytes()
        plain, fast = both(lambda: refusal(data))  # noqa: B023
        assert plain is not None
        assert fast == plain


@pytest.mark.parametrize("profile", ["transform", "vq", "near-lossless"])
@pytest.mark.parametrize("degree", [0, 3])
def test_encoded_scenes_decode_to_the_same_bits(profile, degree, both):
    scene = synth(3000, sh_degree=degree)
    encoded = encode(scene, None, unseen(profile=profile, prune=None))
    for plain, fast in zip(*both(lambda: decoding.chunks(encoded)), strict=True):
        assert_same_bits(fast, plain)


@pytest.mark.parametrize("radix", sorted(DIGITS))
@pytest.mark.parametrize("length", [1, 7, 240, 241, 2000])
def test_digits(radix, length, both):
    plane = np.random.default_rng(radix).integers(0, radix, length).astype(np.uint8)
    plane[0] = radix - 1
    word, stored = pack_plane(plane)
    for found in both(lambda: unpack_plane(memoryview(stored), word, length, "here")):
        np.testing.assert_array_equal(found, plane)


@pytest.mark.parametrize("levels", [(1, 2, 256), (257, 70_000, 1 << 24), (255, 65_536, 65_537)])
def test_grids_of_every_width(levels, both):
    rng = np.random.default_rng(levels[1])
    minimum = np.array([-0.0, -3.7, 1e-3], np.float32)
    grid = Grid(minimum, minimum + np.float32(2.3), np.array(levels, np.uint32))
    values = (rng.random((500, 3)) * 2.3 + minimum).astype(np.float32)
    payload = records.pack([scalar.write(records.Attribute.SCALES, values, grid)])

    def read():
        out = np.empty((500, 3), np.float32)
        (stored,) = records.unpack(memoryview(payload), "here", 500)
        kinds.read(stored, out)
        return out

    plain, fast = both(read)
    assert np.array_equal(plain.view(np.uint32), fast.view(np.uint32))


@pytest.mark.parametrize("offset", [-6.0, -1.0, 0.0, 9.0])
def test_adaptive_steps_at_every_number_of_extra_bits(offset, both):
    rng = np.random.default_rng(11)
    rows = 700
    model = StepModel((float(offset), -1.25, 0.5, 0.25, -0.75, 0.125))
    quats = rotations.unit(rng.normal(size=(rows, 4)).astype(np.float32))
    values, scales = swing_twist.decompose(quats, rng.normal(-4, 4, (rows, 3)).astype(np.float32))
    turned = swing_twist.write(values, scales, model, model)
    extra = model.extra_bits(scales)
    assert (extra.max() == MAX_EXTRA_BITS) == (offset > 0)
    grid = Grid(np.full(3, -1, np.float32), np.full(3, 1, np.float32), np.full(3, 99, np.uint32))
    fine = sorted_means.codes_of(
        rng.uniform(-1, 1, (rows, 3)).astype(np.float32), grid, extra, refined_by=3
    )
    codes = refinement_bits.coarse_codes(fine, 3)
    # The rows' scales go where the Morton order takes the rows.
    order = sorted_means.morton_order(codes, extra)
    means = sorted_means.write(codes[order], grid, extra[order], model)
    below = refinement_bits.write(fine[order], 3)
    payloads = [records.pack([stream]) for stream in (turned, means, below)]

    def read():
        out = [np.empty((rows, width), np.float32) for width in (4, 3, 3)]
        stored = [records.unpack(memoryview(payload), "here", rows)[0] for payload in payloads]
        kinds.read(stored[0], out[0], Inputs(scales=scales))
        kinds.read(stored[1], out[1], Inputs(scales=scales[order]))
        kinds.read(stored[1], out[2], Inputs(scales=scales[order], refinement=stored[2]))
        return out

    for plain, fast in zip(*both(read), strict=True):
        assert np.array_equal(plain.view(np.uint32), fast.view(np.uint32))


def test_kernels_are_used_where_numba_is_loaded_or_the_work_is_large(monkeypatch):
    before = compiled.ready()
    numba = sys.modules["numba"]
    try:
        for loaded, splats, expected in (
            (numba, 1, True),
            (None, 1, False),
            (None, compiled.WORTH_LOADING - 1, False),
        ):
            compiled.use(False)
            monkeypatch.setitem(sys.modules, "numba", loaded)
            compiled.prepare(splats)
            assert compiled.ready() is expected
        # Not to be had: numpy decodes, whatever the size.
        for name in [n for n in sys.modules if n.startswith("cogsplat.codec.streams.kernels")]:
            monkeypatch.delitem(sys.modules, name)
            monkeypatch.delattr(streams, name.rpartition(".")[2])
        compiled.prepare(compiled.WORTH_LOADING)
        assert not compiled.ready()
    finally:
        monkeypatch.undo()
        compiled.use(before)
