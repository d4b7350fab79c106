"""Compiled decoding against numpy's: the same bits, the same refusals."""

import json
import sys
from pathlib import Path

import decoding
import numpy as np
import pytest
import zstandard
from encoding import encode, unseen

import cogsplat.codec.streams as streams
from cogsplat.codec.errors import CogsplatError, FormatError
from cogsplat.codec.geometry import rotations
from cogsplat.codec.streams import (
    compiled,
    kernels_planes,
    kinds,
    records,
    refinement_bits,
    scalar,
    sorted_means,
    swing_twist,
    zstd_frames,
)
from cogsplat.codec.streams.adaptive_step import MAX_EXTRA_BITS, StepModel
from cogsplat.codec.streams.byte_planes import DIGITS, ZSTD_FLAG, pack_plane, unpack_plane
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.inputs import Inputs
from cogsplat.codec.streams.records import StoredStream
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.storage.source import BytesSource
from cogsplat.tools.lab.synthetic.terrace import synth

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
        assert compiled.use(True)
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


def payload_of(bodies, words):
    """A payload of one float stream with these planes, however many it should have."""
    record = records.RECORD.pack(
        records.Attribute.QUATS, records.Kind.FLOAT, 4, 0, 700, len(words), 0
    )
    return b"".join([b"\1\0", record, np.array(words, "<u4").tobytes(), *bodies])


def with_window(frame, size):
    """The same blocks behind a header with a window of 8 MiB and a size of 4 bytes (RFC 8878)."""
    blocks = frame[5 + (1, 2, 4)[frame[4] >> 6] :]
    return frame[:4] + bytes([0x80, 13 << 3]) + size.to_bytes(4, "little") + blocks


@pytest.mark.parametrize("count", [1, 7, 8, 16])
@pytest.mark.parametrize("backend", ["many", "one"])
def test_planes_together_are_those_one_by_one(count, backend, monkeypatch):
    monkeypatch.setattr(zstd_frames, "_MANY_AT_ONCE", backend == "many")
    rng = np.random.default_rng(count)
    bodies, words, expected = [], [], []
    for number in range(count):
        plane = rng.integers(0, (2, 3, 5, 16, 40, 255)[number % 6], 700).astype(np.uint8)
        if number % 3 == 2:
            plane = np.repeat(plane[:1], 700)
        word, stored = pack_plane(plane, digits=number % 4 != 3)
        bodies.append(stored)
        words.append(word)
        expected.append(plane)
    (stream,) = records.unpack(memoryview(payload_of(bodies, words)), "here", 700)
    for first in range(count):
        joined = kernels_planes.join_run(stream, first, [700] * (count - first))
        assert joined.tobytes() == b"".join(p.tobytes() for p in expected[first:]) + b"\0\0"
    whole = records.unpack(memoryview(payload_of(bodies, words)), "here", 700)[0].planes
    assert [bytes(whole.body(n)) for n in range(count)] == [bytes(body) for body in bodies]


@pytest.mark.parametrize("rows", [100, 700, 70_000, 300_000])
def test_frames_of_any_size_and_kind_are_read(rows, monkeypatch):
    """Sizes of 1, 2 and 4 bytes, several blocks, and headers that are left to the slow way."""
    raw = np.random.default_rng(rows).integers(0, 60, rows).astype(np.uint8).tobytes()
    usual = zstandard.ZstdCompressor(level=3).compress(raw)
    frames = [usual, with_window(usual, rows)]
    slow = []
    plain = StoredStream.plane
    monkeypatch.setattr(
        StoredStream, "plane", lambda self, *which: slow.append(which) or plain(self, *which)
    )
    for frame, left_out in zip(frames, (0, 1), strict=True):
        payload = payload_of([frame], [len(frame) | ZSTD_FLAG])
        (stream,) = records.unpack(memoryview(payload), "here", 700)
        slow.clear()
        assert kernels_planes.join_run(stream, 0, [rows]).tobytes() == raw + b"\0\0"
        assert len(slow) == left_out


def damaged_frames():
    raw = np.random.default_rng(1).integers(0, 60, 700).astype(np.uint8).tobytes()
    frame = zstandard.ZstdCompressor(level=3).compress(raw)
    yield "magic", b"\0" + frame[1:]
    yield "behind", frame + b"\0"
    yield "second", frame + frame
    yield "cut", frame[:-3]
    yield "header", frame[:6]
    yield "size", zstandard.ZstdCompressor(level=3).compress(raw[:-1])
    yield "checksum", zstandard.ZstdCompressor(level=3, write_checksum=True).compress(raw)
    yield "reserved", frame[:7] + bytes([frame[7] | 6]) + frame[8:]


@pytest.mark.parametrize(("name", "frame"), list(damaged_frames()))
@pytest.mark.parametrize("count", [1, 9])
def test_damage_is_refused_in_the_words_of_one_plane(name, frame, count):
    good = pack_plane(np.arange(700).astype(np.uint8))[1]
    good_word = len(good) | (ZSTD_FLAG if len(good) < 700 else 0)
    bodies = [good] * (count - 1) + [frame]
    words = [good_word] * (count - 1) + [len(frame) | ZSTD_FLAG]
    (stream,) = records.unpack(memoryview(payload_of(bodies, words)), "here", 700)
    with pytest.raises(FormatError) as alone:
        stream.plane(count - 1, 700)
    with pytest.raises(FormatError) as together:
        kernels_planes.join_run(stream, 0, [700] * count)
    assert together.value.code == alone.value.code
    assert together.value.message == alone.value.message


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
        stored = [records.unpack(memoryview(payload), "here", 700)[0] for payload in payloads]
        kinds.read(stored[0], out[0], Inputs(scales=scales))
        kinds.read(stored[1], out[1], Inputs(scales=scales[order]))
        kinds.read(stored[1], out[2], Inputs(scales=scales[order], refinement=stored[2]))
        return out

    for plain, fast in zip(*both(read), strict=True):
        assert np.array_equal(plain.view(np.uint32), fast.view(np.uint32))


class Loader:
    """Counts how often it is asked to load."""

    def __init__(self):
        self.starts = 0

    def start(self):
        self.starts += 1


@pytest.mark.parametrize(
    ("loaded", "decoded", "expected"),
    [
        (True, [1], 1),
        (False, [1], 0),
        (False, [compiled.WORTH_LOADING - 1], 0),
        (False, [compiled.WORTH_LOADING], 1),
        (False, [1, compiled.WORTH_LOADING_AGAIN - 2], 0),
        (False, [1, compiled.WORTH_LOADING_AGAIN - 1], 1),
    ],
)
def test_kernels_are_loaded_where_numba_is_or_the_work_is_large(
    loaded, decoded, expected, monkeypatch
):
    loader = Loader()
    monkeypatch.setattr(compiled, "LOADER", loader)
    for name, value in (("_decided", False), ("_begun", 0), ("_readers", {})):
        monkeypatch.setattr(compiled, name, value)
    monkeypatch.setitem(sys.modules, "numba", sys.modules["numba"] if loaded else None)
    for splats in decoded:
        compiled.prepare(splats)
    assert loader.starts == expected
    for wanted in (False, True):
        compiled.use(wanted)
        compiled.prepare(compiled.WORTH_LOADING)
        compiled._loaded()
        assert loader.starts == expected
        assert compiled.ready() is wanted


def test_numpy_decodes_where_numba_is_not_to_be_had(monkeypatch):
    for name in ("_decided", "_readers"):
        monkeypatch.setattr(compiled, name, getattr(compiled, name))
    monkeypatch.setitem(sys.modules, "numba", None)
    for name in [n for n in sys.modules if n.startswith("cogsplat.codec.streams.kernels")]:
        monkeypatch.delitem(sys.modules, name)
        monkeypatch.delattr(streams, name.rpartition(".")[2])
    assert not compiled.use(True)
    assert not compiled.ready()
