from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams.byte_planes import (
    DIGITS,
    LENGTH_MASK,
    PACKED_FLAG,
    ZSTD_FLAG,
    pack_plane,
    unpack_plane,
)
from cogsplat.codec.streams.payload_limits import MAX_PLANE_BYTES, MAX_WINDOW_BYTES

MAGIC = bytes.fromhex("28b52ffd")


def back(stored, word, length):
    return unpack_plane(memoryview(stored), word, length, "chunk 4, sh0, plane 1")


def refusal(stored, word, length):
    with pytest.raises(FormatError, match="chunk 4, sh0, plane 1") as caught:
        back(stored, word, length)
    assert caught.value.clause in ("6.3", "6.9", "9.1")
    return caught.value.code


def frame(data, **options):
    return zstandard.ZstdCompressor(**options).compress(data)


def plain_digits(symbols, radix, count):
    """SPEC 6.9 byte by byte: the first symbol is the lowest digit."""
    packed = bytearray()
    for start in range(0, len(symbols), count):
        byte = 0
        for symbol in reversed(symbols[start : start + count]):
            byte = byte * radix + symbol
        packed.append(byte)
    return bytes(packed)


def plain_symbols(packed, radix, count, length):
    """SPEC 6.9 digit by digit."""
    symbols = []
    for byte in packed:
        for _ in range(count):
            byte, digit = divmod(byte, radix)
            symbols.append(digit)
    return bytes(symbols[:length])


def digits_of(stored, word):
    """Radix and packed bytes of a packed plane, its frame opened."""
    assert word & PACKED_FLAG
    body = stored[1:]
    if word & ZSTD_FLAG:
        body = zstandard.ZstdDecompressor().decompress(body)
    return stored[0], body


@settings(derandomize=True, deadline=None, max_examples=300)
@given(
    st.one_of(
        st.binary(max_size=300),
        st.binary(max_size=8).map(lambda data: data * 100),
        st.lists(st.sampled_from(b"\0\0\0\0\1\2"), max_size=300).map(bytes),
        st.integers(1, 17).flatmap(
            lambda top: st.lists(st.integers(0, top - 1), max_size=200).map(bytes)
        ),
    )
)
def test_planes_come_back(data):
    plane = np.frombuffer(data, np.uint8)
    sizes = []
    for digits in (False, True):
        word, stored = pack_plane(plane, digits=digits)
        assert digits or not word & PACKED_FLAG
        assert word & LENGTH_MASK == len(stored) <= len(data)
        assert back(stored, word, len(data)).tobytes() == data
        sizes.append(len(stored))
        if word & PACKED_FLAG:
            radix, packed = digits_of(stored, word)
            assert plain_symbols(packed, radix, DIGITS[radix], len(data)) == data
    assert sizes[1] <= sizes[0]


def test_a_byte_holds_as_many_digits_as_fit():
    assert sorted(DIGITS) == list(range(2, 17))
    for radix, count in DIGITS.items():
        assert radix**count <= 256 < radix ** (count + 1)


@pytest.mark.parametrize("radix", range(2, 17))
def test_digits_are_packed_and_read_as_written(radix):
    rng = np.random.default_rng(radix)
    count = DIGITS[radix]
    for length in (*range(2 * count + 2), 4000):
        symbols = rng.integers(0, radix, length, np.uint8)
        packed = plain_digits(symbols.tolist(), radix, count)
        plain = bytes([radix]) + packed
        assert back(plain, PACKED_FLAG | len(plain), length).tobytes() == symbols.tobytes()
        framed = bytes([radix]) + frame(packed)
        word = PACKED_FLAG | ZSTD_FLAG | len(framed)
        assert back(framed, word, length).tobytes() == symbols.tobytes()
    symbols[0] = radix - 1
    word, stored = pack_plane(symbols)
    if radix < 9:  # where zstd's whole bits lose more than digits do
        expected = plain_digits(symbols.tolist(), radix, count)
        assert digits_of(stored, word) == (radix, expected)


def test_every_plane_takes_its_smallest_way():
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 256, 1000, np.uint8)
    assert pack_plane(noise) == (1000, noise.tobytes())
    assert pack_plane(np.zeros(0, np.uint8)) == (0, b"")
    assert pack_plane(np.array([7], np.uint8)) == (1, b"\7")
    word, stored = pack_plane(np.tile(noise, 20))
    assert word == ZSTD_FLAG | len(stored)
    bits = rng.integers(0, 2, 1000, np.uint8)
    assert pack_plane(bits) == (
        PACKED_FLAG | 126,
        b"\2" + np.packbits(bits, bitorder="little").tobytes(),
    )
    sparse = (rng.random(20_000) < 0.05).astype(np.uint8)
    word, stored = pack_plane(sparse)
    assert word == PACKED_FLAG | ZSTD_FLAG | len(stored)
    entropy = -(0.05 * np.log2(0.05) + 0.95 * np.log2(0.95)) * 20_000 / 8
    assert len(stored) <= 1.2 * entropy
    assert len(stored) < 0.9 * len(pack_plane(sparse, digits=False)[1])


def test_frames_state_their_size_and_carry_no_checksum():
    numbers = np.tile(np.arange(256, dtype=np.uint8), 400)
    sparse = np.tile(np.array([0, 0, 1, 0, 2], np.uint8), 4000)
    for plane, size, flag in ((numbers, 102_400, 0), (sparse, 4000, PACKED_FLAG)):
        word, stored = pack_plane(plane)
        assert word & ~LENGTH_MASK == ZSTD_FLAG | flag
        parameters = zstandard.get_frame_parameters(stored[1:] if flag else stored)
        assert parameters.content_size == size
        assert not parameters.has_checksum
        assert parameters.dict_id == 0


def test_packing_is_repeatable():
    planes = [np.random.default_rng(seed).integers(0, 4, 50_000, np.uint8) for seed in range(3)]
    first = [pack_plane(plane) for plane in planes]
    assert [pack_plane(plane.copy()) for plane in planes] == first
    with ThreadPoolExecutor(3) as pool:
        assert list(pool.map(pack_plane, planes)) == first


def test_planes_are_read_alike_in_any_thread():
    planes = [np.random.default_rng(seed).integers(0, 3, 9000, np.uint8) for seed in range(20)]
    parts = [pack_plane(plane) for plane in planes]
    with ThreadPoolExecutor(4) as pool:
        out = list(pool.map(lambda part: back(part[1], part[0], 9000), parts))
    for actual, expected in zip(out, planes, strict=True):
        assert actual.tobytes() == expected.tobytes()


# Packed digits.


@pytest.mark.parametrize("stored", [b"", b"\0", b"\0\0", b"\1\0", b"\x11\0", b"\xff\0"])
@pytest.mark.parametrize("flag", [0, ZSTD_FLAG])
def test_other_radixes_are_refused(stored, flag):
    assert refusal(stored, PACKED_FLAG | flag | len(stored), 2) == "plane-radix"


@pytest.mark.parametrize("radix", range(2, 17))
def test_bytes_beyond_their_digits_are_refused(radix):
    count = DIGITS[radix]
    top = radix**count - 1
    good = bytes([radix, 0, top, 0])
    assert back(good, PACKED_FLAG | 4, 3 * count)[count : 2 * count].tolist() == [radix - 1] * count
    for value in range(top + 1, 256):
        bad = bytes([radix, 0, value, 0])
        assert refusal(bad, PACKED_FLAG | 4, 3 * count) == "plane-digits"
        framed = bytes([radix]) + frame(bad[1:])
        assert refusal(framed, PACKED_FLAG | ZSTD_FLAG | len(framed), 3 * count) == "plane-digits"


@pytest.mark.parametrize("radix", range(2, 17))
def test_digits_behind_the_last_symbol_are_refused(radix):
    count = DIGITS[radix]
    for missing in range(1, count):
        length = 2 * count - missing
        for place in range(count):
            stored = bytes([radix, 0, radix**place])
            if place < count - missing:
                assert back(stored, PACKED_FLAG | 3, length).sum() == 1
            else:
                assert refusal(stored, PACKED_FLAG | 3, length) == "plane-digits"


def test_packed_bytes_of_another_length_are_refused():
    stored = b"\2" + bytes(3)
    for length in (17, 24):
        assert back(stored, PACKED_FLAG | 4, length).tobytes() == bytes(length)
    for length in (0, 16, 25, 4096):
        assert refusal(stored, PACKED_FLAG | 4, length) == "plane-length"
    assert refusal(b"\2", PACKED_FLAG | 1, 1) == "plane-length"
    assert len(back(b"\2", PACKED_FLAG | 1, 0)) == 0
    # The limit holds for the plane, not for what it is packed into.
    assert refusal(stored, PACKED_FLAG | 4, MAX_PLANE_BYTES + 1) == "plane-length"


def test_frames_of_packed_bytes_are_checked_as_others():
    def framed(data):
        return b"\2" + data, PACKED_FLAG | ZSTD_FLAG | len(data) + 1

    good = frame(bytes(1000))
    assert back(*framed(good), 8000).tobytes() == bytes(8000)
    for length in (7992, 8001, 0, 1000):
        assert refusal(*framed(good), length) == "zstd-size"
    for data in (b"", MAGIC, good[1:], good[:-1], good + b"\0"):
        assert refusal(*framed(data), 8000) == "zstd-frame"
    summed = frame(bytes(1000), write_checksum=True)
    assert refusal(*framed(summed), 8000) == "zstd-checksum"


# Stored planes and frames.


def test_stored_planes_are_views_and_nothing_is_writeable():
    stored = bytes(range(10))
    plane = back(stored, 10, 10)
    assert np.shares_memory(plane, np.frombuffer(stored, np.uint8))
    assert not plane.flags.writeable
    data = frame(bytes(50))
    assert not back(data, ZSTD_FLAG | len(data), 50).flags.writeable


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
    framed = frame(data)
    word, packed = pack_plane(np.frombuffer(data, np.uint8))
    rng = np.random.default_rng(5)
    for good, flags in ((framed, ZSTD_FLAG), (packed, word & ~LENGTH_MASK)):
        for position in range(len(good)):
            broken = bytearray(good)
            broken[position] ^= int(rng.integers(1, 256))
            try:
                plane = back(bytes(broken), flags | len(good), 500)
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
