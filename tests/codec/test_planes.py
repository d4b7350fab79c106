import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.errors import FormatError
from cogsplat.codec.planes import (
    MAX_PLANE_BYTES,
    MAX_WINDOW_BYTES,
    ZSTD_FLAG,
    pack_plane,
    unpack_plane,
)

MAGIC = bytes.fromhex("28b52ffd")


def back(stored, word, length):
    return unpack_plane(memoryview(stored), word, length, "chunk 4, sh0, plane 1")


def refusal(stored, word, length):
    with pytest.raises(FormatError, match="chunk 4, sh0, plane 1") as caught:
        back(stored, word, length)
    assert caught.value.clause in ("6.3", "9.1")
    return caught.value.code


def frame(data, **options):
    return zstandard.ZstdCompressor(**options).compress(data)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(st.one_of(st.binary(max_size=300), st.binary(max_size=8).map(lambda data: data * 100)))
def test_planes_come_back(data):
    plane = np.frombuffer(data, np.uint8)
    word, stored = pack_plane(plane)
    assert word & ~ZSTD_FLAG == len(stored) <= len(data)
    np.testing.assert_array_equal(back(stored, word, len(data)), plane)


def test_what_zstd_does_not_shrink_is_stored():
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 256, 1000, np.uint8)
    assert pack_plane(noise) == (1000, noise.tobytes())
    assert pack_plane(np.zeros(0, np.uint8)) == (0, b"")
    assert pack_plane(np.array([7], np.uint8)) == (1, b"\7")


def test_frames_state_their_size_and_carry_no_checksum():
    word, stored = pack_plane(np.zeros(100_000, np.uint8))
    assert word & ZSTD_FLAG
    parameters = zstandard.get_frame_parameters(stored)
    assert parameters.content_size == 100_000
    assert not parameters.has_checksum
    assert parameters.dict_id == 0


def test_packing_is_repeatable():
    plane = np.random.default_rng(2).integers(0, 4, 50_000, np.uint8)
    assert pack_plane(plane) == pack_plane(plane.copy())


def test_stored_planes_are_views_and_nothing_is_writeable():
    stored = bytes(range(10))
    plane = back(stored, 10, 10)
    assert np.shares_memory(plane, np.frombuffer(stored, np.uint8))
    assert not plane.flags.writeable
    word, packed = pack_plane(np.zeros(50, np.uint8))
    assert not back(packed, word, 50).flags.writeable


@pytest.mark.parametrize("length", [0, 9, 11])
def test_stored_bytes_of_another_length_are_refused(length):
    assert refusal(bytes(10), 10, length) == "plane-length"


def test_planes_above_the_limit_are_refused_before_anything_else():
    assert refusal(b"", 0, MAX_PLANE_BYTES + 1) == "plane-length"
    assert refusal(b"", ZSTD_FLAG, MAX_PLANE_BYTES + 1) == "plane-length"


def test_what_is_no_frame_is_refused():
    good = frame(bytes(1000))
    skippable = bytes.fromhex("502a4d18") + (4).to_bytes(4, "little") + b"abcd"
    legacy = bytes.fromhex("27b52ffd") + good[4:]
    for data in (b"", b"\0", MAGIC, MAGIC[:3], skippable, skippable + good, legacy, b"\1" + good):
        assert refusal(data, ZSTD_FLAG | len(data), 1000) == "zstd-frame"


def test_frames_that_end_early_or_late_are_refused():
    data = np.random.default_rng(3).integers(0, 8, 2000, np.uint8).tobytes()
    good = frame(data)
    for cut in (1, 2, 3, len(good) // 2, len(good) - 12):
        assert refusal(good[:-cut], ZSTD_FLAG | len(good) - cut, 2000) == "zstd-frame"
    for extra in (b"\0", good, bytes.fromhex("502a4d1800000000")):
        assert refusal(good + extra, ZSTD_FLAG, 2000) == "zstd-frame"


def test_every_damaged_byte_is_refused_or_decodes_to_the_right_length():
    data = np.random.default_rng(4).integers(0, 8, 500, np.uint8).tobytes()
    good = frame(data)
    rng = np.random.default_rng(5)
    for position in range(len(good)):
        broken = bytearray(good)
        broken[position] ^= int(rng.integers(1, 256))
        try:
            plane = back(bytes(broken), ZSTD_FLAG | len(good), 500)
        except FormatError:
            continue
        assert len(plane) == 500


@pytest.mark.parametrize("length", [0, 999, 1001, MAX_PLANE_BYTES])
def test_frames_that_state_another_size_are_refused(length):
    good = frame(bytes(1000))
    assert refusal(good, ZSTD_FLAG | len(good), length) == "zstd-size"


def test_frames_that_state_no_size_are_refused():
    data = frame(bytes(1000), write_content_size=False)
    assert zstandard.get_frame_parameters(data).content_size != 1000
    assert refusal(data, ZSTD_FLAG | len(data), 1000) == "zstd-size"


def test_frames_that_understate_their_size_are_refused():
    # Single segment, 2-byte size (256 less), then an RLE block of 2000 bytes, the last.
    header = MAGIC + bytes([0x60]) + (1000 - 256).to_bytes(2, "little")
    for size in (999, 1000, 1001, 2000):
        data = header + (1 | 1 << 1 | size << 3).to_bytes(3, "little") + b"\7"
        if size == 1000:
            assert (back(data, ZSTD_FLAG | len(data), 1000) == 7).all()
        else:
            assert refusal(data, ZSTD_FLAG | len(data), 1000) in ("zstd-frame", "zstd-size")


def test_windows_above_the_limit_are_refused():
    # No single segment: a window descriptor, exponent in the upper five bits, then a 4-byte size.
    def header(exponent):
        return MAGIC + bytes([0x80, exponent << 3]) + (1000).to_bytes(4, "little")

    body = (1 | 1 << 1 | 1000 << 3).to_bytes(3, "little") + b"\7"
    assert MAX_WINDOW_BYTES == 1 << 10 + 13
    assert (back(header(13) + body, ZSTD_FLAG, 1000) == 7).all()
    assert refusal(header(14) + body, ZSTD_FLAG, 1000) == "zstd-window"


def test_dictionaries_and_checksums_are_refused():
    named = MAGIC + bytes([0x61, 5]) + (1000 - 256).to_bytes(2, "little") + b"\1\0\0"
    assert refusal(named, ZSTD_FLAG, 1000) == "zstd-dictionary"
    summed = frame(bytes(1000), write_checksum=True)
    assert refusal(summed, ZSTD_FLAG, 1000) == "zstd-checksum"
