"""The compiled chunk reader against numpy: the same bits, the same refusals."""

import json
from pathlib import Path

import decoding
import numpy as np
import pytest
import zstandard
from encoding import encode, unseen

from cogsplat.codec.errors import CogsplatError
from cogsplat.codec.geometry import rotations
from cogsplat.codec.segments.whole_chunk import decode_chunk
from cogsplat.codec.splats import empty
from cogsplat.codec.streams import (
    chunk_arrays,
    decoding_tiers,
    grid,
    kernels_chunk,
    kernels_planes,
    records,
    refinement_bits,
    scalar,
    scale_differences,
    sh0_transform,
    sorted_means,
    swing_twist,
    zstd_frames,
)
from cogsplat.codec.streams.adaptive_step import MAX_EXTRA_BITS, StepModel
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import Attribute
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.storage.source import BytesSource
from cogsplat.tools.lab.synthetic.terrace import synth

VECTORS = Path(__file__).resolve().parents[2] / "vectors"
MANIFEST = json.loads((VECTORS / "manifest.json").read_text(encoding="utf-8"))
ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")
ROWS = 700


@pytest.fixture
def both():
    """Call something with numpy alone and then with the compiled chunk reader."""
    before = decoding_tiers.is_compiled()

    def call(function):
        decoding_tiers.use_compiled(False)
        plain = function()
        assert decoding_tiers.use_compiled(True)
        return plain, function()

    yield call
    decoding_tiers.use_compiled(before)


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


@pytest.mark.parametrize("rows", [1, 100, 700, 70_000, 300_000])
def test_frame_headers_with_sizes_of_1_2_and_4_bytes(rows):
    raw = np.random.default_rng(rows).integers(0, 60, rows).astype(np.uint8).tobytes()
    frame = zstandard.ZstdCompressor(level=3).compress(raw)
    data = np.frombuffer(b"\7" * 5 + frame + b"\7" * 9, np.uint8)
    assert kernels_planes.parse_frame(data, 5, len(frame)) == (5 + len(frame), rows)


@pytest.mark.parametrize("count", [1, 7, 8, 16])
@pytest.mark.parametrize("has_batch_call", [True, False])
def test_located_frames_decompress_in_order_or_not_at_all(count, has_batch_call, monkeypatch):
    batch = zstd_frames._HAS_BATCH_CALL and has_batch_call
    monkeypatch.setattr(zstd_frames, "_HAS_BATCH_CALL", batch)
    rng = np.random.default_rng(count)
    plain = [rng.integers(0, 9, 700 + n).astype(np.uint8).tobytes() for n in range(count)]
    frames = [zstandard.ZstdCompressor(level=3).compress(raw) for raw in plain]
    ends = np.cumsum([len(frame) for frame in frames])
    located = np.array([(e - len(f), len(f)) for e, f in zip(ends, frames, strict=True)], np.uint64)
    sizes = np.array([len(raw) for raw in plain], np.uint64)
    stored = bytearray(b"".join(frames))
    found = zstd_frames.decompress_located(memoryview(bytes(stored)), located, sizes)
    assert found == b"".join(plain)
    # The header of the last frame's first block: type 3 is reserved (RFC 8878, 3.1.1.2.2).
    stored[int(located[-1, 0]) + 7] |= 6
    assert zstd_frames.decompress_located(memoryview(bytes(stored)), located, sizes) is None


def unusual_frames():
    raw = np.random.default_rng(1).integers(0, 60, 700).astype(np.uint8).tobytes()
    frame = zstandard.ZstdCompressor(level=3).compress(raw)
    yield "magic", b"\0" + frame[1:]
    yield "header", frame[:6]
    yield "checksum", zstandard.ZstdCompressor(level=3, write_checksum=True).compress(raw)
    yield "no size", zstandard.ZstdCompressor(write_content_size=False).compress(raw)
    # A window of 8 MiB and a size of 4 bytes (RFC 8878).
    yield "window", frame[:4] + bytes([0x80, 13 << 3]) + (700).to_bytes(4, "little") + frame[7:]


@pytest.mark.parametrize(("name", "frame"), list(unusual_frames()))
def test_unusual_frame_headers_are_declined(name, frame):
    data = np.frombuffer(frame, np.uint8)
    assert kernels_planes.parse_frame(data, 0, len(frame)) == (-1, -1)


def decode_head(head, refinement, both):
    """Decode a head without tail both ways; the compiled chunk reader must accept it."""

    def decode():
        out = empty(0, ROWS)
        views = [memoryview(head), None if refinement is None else memoryview(refinement)]
        if decoding_tiers.is_compiled():
            shN = out.shN.reshape(ROWS, 0)
            arrays = (out.means, out.scales, out.quats, out.opacities, out.sh0, shN)
            own = chunk_arrays.ChunkArrays(*arrays)
            assert kernels_chunk.read(*views, None, lambda number: None, own)
        decode_chunk(*views, None, ({}, {}), out, "chunk", sh_degree=0)
        return out

    plain, fast = both(decode)
    assert_same_bits(fast, plain)


def head_of(rng, scales, model, levels, refined_by):
    """Return a head with grids of some levels, and the refinement of its means."""
    differences = scale_differences.differences_of(scales)
    spans = differences.min(axis=0), differences.max(axis=0)
    scale_grid = Grid(*spans, np.array(levels, np.uint32))
    decoded = scale_differences.scales_of(scale_grid.dequantise(scale_grid.quantise(differences)))
    quats = rotations.unit(rng.normal(size=(ROWS, 4)).astype(np.float32))
    turns, _ = swing_twist.decompose(quats, scales)
    extra = model.extra_bits(decoded)
    cells = Grid(np.full(3, -1, np.float32), np.full(3, 1, np.float32), np.full(3, 99, np.uint32))
    means = rng.uniform(-1, 1, (ROWS, 3)).astype(np.float32)
    fine = sorted_means.quantise(means, cells, extra, refined_by=refined_by)
    codes = refinement_bits.coarse_codes(fine, refined_by)
    order = sorted_means.morton_order(codes, extra)
    opacities = rng.normal(size=(ROWS, 1)).astype(np.float32)
    colours = rng.normal(size=(ROWS, 3)).astype(np.float32)
    colour_grid = Grid(colours.min(axis=0), colours.max(axis=0), np.array(levels, np.uint32))
    head = records.pack(
        [
            scale_differences.write(differences[order], scale_grid),
            swing_twist.write(turns[order], decoded[order], model, model),
            sorted_means.write(codes[order], cells, extra[order], model),
            scalar.write(Attribute.OPACITIES, opacities, grid.fit(opacities, 1e-4)),
            sh0_transform.write(colours, np.eye(3, dtype=np.float32), colour_grid),
        ]
    )
    return head, records.pack([refinement_bits.write(fine[order], refined_by)])


@pytest.mark.parametrize("levels", [(1, 2, 256), (257, 70_000, 1 << 24), (255, 65_536, 65_537)])
def test_grids_of_every_width(levels, both):
    rng = np.random.default_rng(levels[1])
    scales = np.sort(rng.normal(-4, 1, (ROWS, 3)), axis=1)[:, [1, 0, 2]].astype(np.float32)
    head, _ = head_of(rng, scales, StepModel.constant(3), levels, 0)
    decode_head(head, None, both)


@pytest.mark.parametrize("offset", [-6.0, -1.0, 0.0, 9.0])
@pytest.mark.parametrize("refined_by", [0, 3])
def test_adaptive_steps_at_every_number_of_extra_bits(offset, refined_by, both):
    rng = np.random.default_rng(11)
    model = StepModel((float(offset), -1.25, 0.5, 0.25, -0.75, 0.125))
    scales = np.sort(rng.normal(-4, 4, (ROWS, 3)), axis=1)[:, [1, 0, 2]].astype(np.float32)
    assert (model.extra_bits(scales).max() == MAX_EXTRA_BITS) == (offset > 0)
    head, refinement = head_of(rng, scales, model, (9000, 9000, 9000), refined_by)
    decode_head(head, refinement if refined_by else None, both)
