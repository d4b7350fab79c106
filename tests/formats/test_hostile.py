"""Files made to break a reader: only refusals come out, and no more memory than they may take."""

import json
import random
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from cogs_samples import ARRAYS, file_of
from hypothesis import given, settings
from hypothesis import strategies as st
from tracing import start_tracing

from cogsplat.codec.errors import CogsplatError
from cogsplat.codec.streams.records import Attribute
from cogsplat.formats.cogs.canonical_msgpack import pack, unpack
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.cogs.scene_index import read_scene_index
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.source import BytesSource
from cogsplat.tools.lab.conformance import handmade_streams, reference_decoder
from cogsplat.tools.lab.conformance.file_builder import (
    build,
    one_chunk,
    payload,
    record,
    replace_payloads,
    split_root,
    with_root,
)

VECTORS = Path(__file__).resolve().parents[1] / "vectors"
MANIFEST = json.loads((VECTORS / "manifest.json").read_text(encoding="utf-8"))
FILES = [(VECTORS / "valid" / f"{e['name']}.cogs").read_bytes() for e in MANIFEST["valid"]]
# Their segments can be put together again from the root alone.
PLAIN = [
    data for data in FILES if not read_scene_index(BytesSource(data), partial=False).root.pages
]
LIMITS = Limits(decoded_bytes=4 << 20)

NUMBERS = [0, 1, 2, 3, 127, 128, 255, 256, 65535, 65536, 1 << 18, (1 << 18) + 1, (1 << 24) + 1,
           (1 << 31) - 1, 1 << 31, (1 << 32) - 1]  # fmt: skip
FLOATS = [0.0, -0.0, 1.0, -1.0, 2.0, 1e-45, 2.0**100, 2.0**101, 3e38, np.inf, -np.inf, np.nan]

quick = settings(max_examples=120, deadline=None)


def opened(data, *, partial=False):
    """Do all a reader does; return what it decodes, or the refusal."""
    try:
        with open_cogs(BytesSource(data), partial=partial, limits=LIMITS) as file:
            file.decode(sh_degree=0)
            splats = file.decode()
            file.verify()
    except CogsplatError as error:
        return error
    return splats


@st.composite
def overwritten(draw, data):
    """Bytes with a few numbers written over them, or some cut out or put in."""
    out = bytearray(draw(data) if isinstance(data, st.SearchStrategy) else data)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(len(out) - 1, 0)))
        kind = draw(st.sampled_from(["flip", "u32", "u16", "f32", "cut", "put"]))
        if kind == "flip" and out:
            out[at] ^= 1 << draw(st.integers(0, 7))
        elif kind == "cut":
            del out[at : at + draw(st.integers(1, 9))]
        elif kind == "put":
            out[at:at] = draw(st.binary(max_size=9))
        else:
            new = {
                "u32": lambda: struct.pack("<I", draw(st.sampled_from(NUMBERS))),
                "u16": lambda: struct.pack("<H", draw(st.sampled_from(NUMBERS)) & 0xFFFF),
                "f32": lambda: struct.pack("<f", draw(st.sampled_from(FLOATS))),
                "flip": lambda: b"",
            }[kind]()
            out[at : at + len(new)] = new
    return bytes(out)


def first_chunks(data):
    """Decode what a partial reader finds, or return its refusal."""
    try:
        with open_cogs(BytesSource(data), partial=True, limits=LIMITS) as file:
            return file.decode()
    except CogsplatError as error:
        return error


@quick
@given(st.sampled_from(FILES), st.data())
def test_damaged_bytes_are_refused(kernels, original, draw):
    data = draw.draw(overwritten(original))
    found = opened(data)
    assert isinstance(found, CogsplatError) or data == original


def assert_nothing_new(data, original):
    """What a partial reader decodes of damaged bytes is what it decodes of as many whole ones."""
    found = first_chunks(data)
    if isinstance(found, CogsplatError):
        return
    whole = first_chunks(original[: len(data)])
    assert not isinstance(whole, CogsplatError)
    for name in ARRAYS:
        assert getattr(found, name).tobytes() == getattr(whole, name).tobytes(), name
    assert list(found.extras) == list(whole.extras)
    for name, values in found.extras.items():
        assert values.tobytes() == whole.extras[name].tobytes(), name


@quick
@given(st.sampled_from(FILES), st.data())
def test_damaged_bytes_give_a_partial_reader_nothing_new(kernels, original, draw):
    assert_nothing_new(draw.draw(overwritten(original)), original)


@pytest.mark.parametrize("profile", ["transform", "vq", "near-lossless"])
def test_flipped_bits_of_cut_files_give_nothing_new(kernels, profile):
    """Damage anywhere in a file of which most bytes are payload, read to anywhere."""
    original = file_of(profile, 300, 3, 60)
    rng = random.Random(5)
    for _ in range(80):
        data = bytearray(original[: rng.randrange(len(original) // 2, len(original) + 1)])
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        assert_nothing_new(bytes(data), original)


@quick
@given(st.sampled_from(FILES), st.data())
def test_damaged_roots_with_a_right_crc(kernels, data, draw):
    root, behind = split_root(data)
    opened(with_root(draw.draw(overwritten(root)), behind))


@quick
@given(st.sampled_from(FILES), st.data())
def test_roots_with_wrong_numbers(kernels, data, draw):
    """Every column and every number may say anything."""
    root, behind = split_root(data)
    value = unpack(root, "root")
    for _ in range(draw.draw(st.integers(1, 3))):
        place = value
        while True:
            key = draw.draw(st.sampled_from(sorted(place)))
            inner = place[key]
            if isinstance(inner, list) and inner and isinstance(inner[0], dict):
                inner = inner[0]
            if not isinstance(inner, dict):
                break
            place = inner
        if isinstance(place[key], bytes):
            place[key] = draw.draw(overwritten(place[key]))
        elif isinstance(place[key], int):
            place[key] = draw.draw(st.sampled_from(NUMBERS))
        elif isinstance(place[key], float):
            place[key] = draw.draw(st.sampled_from([float(f) for f in FLOATS]))
        elif isinstance(place[key], list) and place[key]:
            del place[key][-1]
    opened(with_root(pack(value), behind))


def assert_as_reference(data, splats):
    """What our reader accepts is a valid file: the second decoder must get the same bits."""
    rows = reference_decoder.decode(data).rows
    for name in ARRAYS:
        found = getattr(splats, name)
        wanted = np.array(rows[name], np.float32).reshape(found.shape)
        assert np.array_equal(found.view(np.uint32), wanted.view(np.uint32)), name


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(PLAIN), st.data())
def test_damaged_payloads_are_refused_or_decode_as_specified(kernels, data, draw):
    index = read_scene_index(BytesSource(data), partial=False)
    if not len(index.segments):
        return
    row = draw.draw(st.integers(0, len(index.segments) - 1))
    start = int(index.offsets[row])
    payload = data[start : start + int(index.segments.length[row])]
    changed = replace_payloads(data, {row: draw.draw(overwritten(payload))})
    found = opened(changed)
    if not isinstance(found, CogsplatError):
        assert_as_reference(changed, found)


def test_a_stream_of_two_faults_has_one_code(kernels):
    """A code beyond its grid, and behind it a plane of a radix that there is not."""
    codes = [[0, 1, 4], [0, 1, 2], [0, 1, 2]]
    means = handmade_streams.scalar(Attribute.MEANS, [(-1.0, 1.0, 4)] * 3, codes)
    head = [record(stream) for stream in handmade_streams.random_head(3, 1, means)]
    place = next(i for i, entry in enumerate(head) if entry.fields[0] == Attribute.MEANS)
    head[place].planes[2] = (3 | 1 << 30, b"\x11\0\0")
    found = opened(build(one_chunk(payload(head), 3)))
    assert isinstance(found, CogsplatError)
    assert found.code == "code-range"


@pytest.mark.parametrize("profile", ["transform", "vq", "near-lossless"])
def test_damaged_scenes_take_little_memory(kernels, profile):
    data = file_of(profile, 300, 3, 60)
    index = read_scene_index(BytesSource(data), partial=False)
    rng = random.Random(7)
    worst = 0
    start_tracing()
    for _ in range(40):
        row = rng.randrange(len(index.segments))
        start = int(index.offsets[row])
        payload = bytearray(data[start : start + int(index.segments.length[row])])
        for _ in range(rng.randint(1, 3)):
            at = rng.randrange(max(min(len(payload), 200) - 4, 1))
            payload[at : at + 4] = struct.pack("<I", rng.choice(NUMBERS))
        changed = replace_payloads(data, {row: bytes(payload)})
        tracemalloc.reset_peak()
        before, _ = tracemalloc.get_traced_memory()
        opened(changed)
        worst = max(worst, tracemalloc.get_traced_memory()[1] - before)
    tracemalloc.stop()
    assert worst < 24 << 20


def test_the_must_reject_files_take_little_memory(kernels):
    start_tracing()
    for entry in MANIFEST["invalid"]:
        data = (VECTORS / "invalid" / f"{entry['name']}.cogs").read_bytes()
        tracemalloc.reset_peak()
        before, _ = tracemalloc.get_traced_memory()
        opened(data)
        assert tracemalloc.get_traced_memory()[1] - before < 8 << 20, entry["name"]
    tracemalloc.stop()
