import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.errors import FormatError
from cogsplat.codec.planes import (
    LENGTH_MASK,
    MAX_PLANE_BYTES,
    MAX_WINDOW_BYTES,
    RANS_FLAG,
    ZSTD_FLAG,
    PlaneCoder,
    PlaneReader,
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


def packed(planes):
    """Word and stored bytes of every plane, then lanes and body."""
    coder = PlaneCoder()
    return [coder.pack(plane) for plane in planes], *coder.finish()


def read(parts, lanes, body, lengths):
    reader = PlaneReader(lanes, "chunk 4")
    views = [(word, memoryview(stored)) for word, stored in parts]
    for word, stored in views:
        if word & RANS_FLAG:
            reader.expect(stored)
    reader.attach(memoryview(body))
    out = []
    for (word, stored), length in zip(views, lengths, strict=True):
        where = "chunk 4, sh0, plane 1"
        if word & RANS_FLAG:
            out.append(reader.read(stored, length, where))
        else:
            out.append(unpack_plane(stored, word, length, where))
    reader.finish()
    return out


@settings(derandomize=True, deadline=None, max_examples=150)
@given(
    st.lists(
        st.one_of(
            st.binary(max_size=300),
            st.binary(max_size=8).map(lambda data: data * 100),
            st.lists(st.sampled_from(b"\0\0\0\0\1\2"), max_size=300).map(bytes),
        ),
        max_size=6,
    )
)
def test_planes_come_back(planes):
    arrays = [np.frombuffer(data, np.uint8) for data in planes]
    parts, lanes, body = packed(arrays)
    for (word, stored), data in zip(parts, planes, strict=True):
        assert word & LENGTH_MASK == len(stored) <= len(data)
    assert bool(lanes) == bool(body) == any(word & RANS_FLAG for word, _ in parts)
    out = read(parts, lanes, body, [len(data) for data in planes])
    assert [plane.tobytes() for plane in out] == planes


def test_every_plane_takes_its_smallest_way():
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 256, 1000, np.uint8)
    assert packed([noise]) == ([(1000, noise.tobytes())], 0, b"")
    assert packed([np.zeros(0, np.uint8)]) == ([(0, b"")], 0, b"")
    assert packed([np.array([7], np.uint8)]) == ([(1, b"\7")], 0, b"")
    skewed = rng.geometric(0.4, 20_000).astype(np.uint8)
    repeated = np.tile(noise, 20)
    parts, _, body = packed([noise, skewed, repeated])
    flags = [word & ~LENGTH_MASK for word, _ in parts]
    assert flags == [0, RANS_FLAG, ZSTD_FLAG]
    counts = np.bincount(skewed)
    share = counts[counts > 0] / len(skewed)
    entropy = -(share * np.log2(share)).sum() * len(skewed) / 8
    assert entropy <= len(body) + len(parts[1][1]) <= 1.02 * entropy + 50


def test_frames_state_their_size_and_carry_no_checksum():
    (word, stored), *_ = packed([np.tile(np.arange(256, dtype=np.uint8), 400)])[0]
    assert word & ZSTD_FLAG
    parameters = zstandard.get_frame_parameters(stored)
    assert parameters.content_size == 102_400
    assert not parameters.has_checksum
    assert parameters.dict_id == 0


def test_packing_is_repeatable():
    planes = [np.random.default_rng(seed).integers(0, 4, 50_000, np.uint8) for seed in range(3)]
    assert packed(planes) == packed([plane.copy() for plane in planes])


def test_rans_planes_are_read_in_their_order():
    rng = np.random.default_rng(2)
    planes = [rng.geometric(p, 3000).astype(np.uint8) for p in (0.3, 0.6)]
    parts, lanes, body = packed(planes)
    assert all(word & RANS_FLAG for word, _ in parts)
    views = [memoryview(stored) for _, stored in parts]
    reader = PlaneReader(lanes, "chunk 4")
    for view in views:
        reader.expect(view)
    reader.attach(memoryview(body))
    for wrong, right in ((1, 0), (0, 1)):
        with pytest.raises(FormatError, match="chunk 4, plane") as caught:
            reader.read(views[wrong], 3000, "chunk 4, plane")
        assert caught.value.code == "stream-order"
        plane = reader.read(views[right], 3000, "chunk 4, plane")
        np.testing.assert_array_equal(plane, planes[right])
    reader.finish()


def test_the_end_of_a_body_is_checked_once_all_planes_are_read():
    rng = np.random.default_rng(3)
    planes = [rng.geometric(p, 3000).astype(np.uint8) for p in (0.3, 0.6)]
    parts, lanes, body = packed(planes)
    views = [memoryview(stored) for _, stored in parts]

    def reader_of(data):
        reader = PlaneReader(lanes, "chunk 4")
        for view in views:
            reader.expect(view)
        reader.attach(memoryview(data))
        return reader

    partial = reader_of(body + bytes(2))
    partial.read(views[0], 3000, "chunk 4, plane")
    partial.finish()  # the second plane was not wanted
    partial.read(views[1], 3000, "chunk 4, plane")
    with pytest.raises(FormatError) as caught:
        partial.finish()
    assert caught.value.code == "rans-end"
    short = reader_of(body)
    with pytest.raises(FormatError) as caught:
        short.read(views[0], MAX_PLANE_BYTES + 1, "chunk 4, plane")
    assert caught.value.code == "plane-length"


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
