"""Extra attributes and cameras in a COGS file: the right rows, to the bit, or a refusal."""

from dataclasses import replace

import numpy as np
import pytest
from cogs_samples import ARRAYS, scene
from encoding import encode, unseen
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.config import PROFILE_NAMES
from cogsplat.codec.errors import CogsplatError, DataError, LimitError, TruncatedError
from cogsplat.codec.splats import EXTRA_DTYPES
from cogsplat.formats.cogs import scene_writer as cogs
from cogsplat.formats.cogs.camera_segment import pack_cameras, unpack_cameras
from cogsplat.formats.cogs.decoded_rows import scratch_bytes
from cogsplat.formats.cogs.layout import MAX_CAMERAS, SegmentKind
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.cogs.writer import lay_out
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.source import BytesSource

N = 700


def with_extras(count=N, degree=1):
    rng = np.random.default_rng(7)
    extras = {"number": np.arange(count, dtype=np.uint32)}
    for dtype in EXTRA_DTYPES:
        raw = rng.integers(0, 256, (count, 2, int(dtype[1])), np.uint8)
        extras[dtype] = raw.view(dtype)[..., 0]
    extras["label"] = (extras["number"] % 5).astype(np.uint8)
    return replace(scene(count, degree), extras=extras)


def file_of(splats, profile="transform", cameras=(), **config):
    settings_ = unseen(profile=profile, chunk_splats=150, prune=None, **config)
    made = encode(splats, None, settings_)
    root = cogs.build_root(made, "samples")
    data = b"".join(lay_out(root, cogs.segments(made, cameras)))
    assert cogs.size_bytes(made, writer="samples", cameras=cameras) == len(data)
    return data


def opened(data, **how):
    return open_cogs(BytesSource(data), **how)


def assert_rows(found, splats, rows):
    for name, values in splats.extras.items():
        assert found.extras[name].dtype == values.dtype
        assert found.extras[name].tobytes() == values[rows].tobytes(), name


@pytest.mark.parametrize("profile", PROFILE_NAMES)
@pytest.mark.parametrize("morton", [True, False])
def test_extras_stay_with_their_splats(profile, morton):
    splats = with_extras()
    # What no quantisation can confuse: every splat at a place of its own.
    splats = replace(splats, means=(splats.means * 100).astype(np.float32))
    with opened(file_of(splats, profile, quality_db=60.0, morton=morton)) as file:
        found = file.decode()
        rows = found.extras["number"]
        assert sorted(rows.tolist()) == list(range(N))
        assert_rows(found, splats, rows)
        off = np.linalg.norm(found.means[:, None] - splats.means[None], axis=2).argmin(axis=1)
        assert (off == rows).mean() > 0.99
        parts = [file.decode([chunk]) for chunk in range(file.num_chunks)]
        together = np.concatenate([part.extras["number"] for part in parts])
        np.testing.assert_array_equal(together, rows)
        assert not file.decode(extras=False).extras
        file.verify()


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_extras_change_nothing_of_what_is_drawn(profile):
    splats = with_extras()
    plain, rich = (file_of(s, profile) for s in (splats.without_extras(), splats))
    with opened(plain) as one, opened(rich) as two:
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(one.decode(), name), getattr(two.decode(), name))
        assert not one.root.attributes
        kinds = two.segments.kind
        first = int(np.flatnonzero(kinds == SegmentKind.ATTRIBUTES)[0])
        assert (kinds[first:] == SegmentKind.ATTRIBUTES).all()
        drawn_end = int(two.offsets[first])
    # A prefix without them is a scene without them.
    with opened(rich[:drawn_end], partial=True) as part:
        assert part.complete_chunks() == part.num_chunks
        found = part.decode()
        assert len(found) == N
        assert not found.extras
        assert not part.has_extras(0)


def test_chunks_whose_extras_are_there_have_them():
    data = file_of(with_extras())
    with opened(data[:-1], partial=True) as part:
        assert [part.has_extras(chunk) for chunk in range(part.num_chunks)][-2:] == [True, False]
        assert part.decode([0]).extras
        assert not part.decode().extras


def test_a_scene_of_no_splats_keeps_its_extras_names():
    data = file_of(with_extras(0))
    with opened(data) as file:
        assert list(file.decode().extras) == list(with_extras(1).extras)


def test_extras_count_for_the_limit():
    splats = replace(scene(N), extras={"wide": np.zeros((N, 16), np.float64)})
    data = file_of(splats)
    with opened(data) as file:
        # Beside its arrays the largest chunk takes its working memory.
        without = file.decode(extras=False)
        drawn = without.nbytes + scratch_bytes(int(file.chunks.splats.max()), 3, file.root)
        drawn += sum(book.nbytes for book in file._codebooks.values())
    limits = Limits(decoded_bytes=drawn + N * 128 - 1)
    with opened(data, limits=limits) as file:
        file.decode(extras=False)
        with pytest.raises(LimitError):
            file.decode()
    with opened(data, limits=Limits(decoded_bytes=drawn + N * 128)) as file:
        assert file.decode().extras


def test_names_that_the_root_cannot_hold_are_refused():
    many = {f"{'x' * 240}{k}": np.zeros(20, np.uint8) for k in range(100)}
    with pytest.raises(DataError) as caught:
        file_of(replace(scene(20), extras=many))
    assert caught.value.code == "root-size"


def test_bytes_do_not_depend_on_threads():
    splats = with_extras()
    assert file_of(splats, threads=1) == file_of(splats, threads=3)


def cameras_of(count):
    rng = np.random.default_rng(5)
    cameras = []
    for number in range(count):
        rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        rotation *= np.sign(np.linalg.det(rotation))
        fx, fy, cx, cy = rng.uniform(1, 2000, 4)
        cameras.append(
            Camera(
                int(rng.integers(1, 65536)), 480, fx, fy, cx, cy,
                rotation, rng.normal(size=3), f"bild-{number}-é",
            )
        )  # fmt: skip
    return cameras


def assert_same_cameras(found, expected):
    assert len(found) == len(expected)
    for one, two in zip(found, expected, strict=True):
        for key in ("name", "width", "height", "fx", "fy", "cx", "cy"):
            assert getattr(one, key) == getattr(two, key)
        np.testing.assert_array_equal(one.rotation, two.rotation)
        np.testing.assert_array_equal(one.translation, two.translation)


@pytest.mark.parametrize("count", [1, 33])
def test_cameras_come_back_to_the_bit(count):
    expected = cameras_of(count)
    data = file_of(scene(N), cameras=expected)
    with opened(data) as file:
        assert_same_cameras(file.cameras(), expected)
        start = int(file.offsets[file.camera_row])
        file.verify()
    with opened(data[:start], partial=True) as part, pytest.raises(TruncatedError):
        part.cameras()


def test_a_file_without_cameras_has_none():
    with opened(file_of(scene(50))) as file:
        assert file.cameras() == []
        assert file.camera_row is None


@pytest.mark.parametrize(
    ("cameras", "code"),
    [
        ([], "too-many-cameras"),
        (cameras_of(1) * (MAX_CAMERAS + 1), "too-many-cameras"),
        ([replace(cameras_of(1)[0], name="x" * 256)], "bad-camera"),
        ([replace(cameras_of(1)[0], name="\ud800")], "bad-camera"),
    ],
)
def test_cameras_that_no_file_can_hold_are_refused(cameras, code):
    with pytest.raises(DataError) as caught:
        pack_cameras(cameras)
    assert caught.value.code == code


def test_cameras_count_for_the_limit():
    data = file_of(scene(20), cameras=cameras_of(3))
    with opened(data, limits=Limits(decoded_bytes=3 * 1024)) as file:
        assert len(file.cameras()) == 3
    with opened(data, limits=Limits(decoded_bytes=3 * 1024 - 1)) as file:
        with pytest.raises(LimitError) as caught:
            file.cameras()
        assert caught.value.code == "decoded-size"


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_damaged_cameras_are_read_or_refused(data):
    payload = bytearray(pack_cameras(cameras_of(2)))
    for _ in range(data.draw(st.integers(1, 3))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    stop = data.draw(st.integers(0, len(payload)))
    try:
        count, code = len(unpack_cameras(bytes(payload[:stop]), "here", 1 << 20)), ""
    except CogsplatError as error:
        count, code = 0, error.code
    assert count == 2 or code.startswith(("msgpack-", "root-"))
