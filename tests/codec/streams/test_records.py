import struct

import numpy as np
import pytest
from hypothesis import settings
from streamed import refused

from cogsplat.codec.errors import FormatError, UnsupportedError
from cogsplat.codec.streams import codebook_index, kinds, quaternion, scalar
from cogsplat.codec.streams import records as streams
from cogsplat.codec.streams.byte_planes import PACKED_FLAG, ZSTD_FLAG
from cogsplat.codec.streams.grid import fit
from cogsplat.codec.streams.records import COMPONENTS, ESCAPE, INFINITIES, Attribute, Kind

checked = settings(derandomize=True, deadline=None, max_examples=100)


def record(attribute=3, kind=1, components=3, flags=0, rows=0, planes=0, params=b""):
    head = struct.pack(
        "<BBBBIHH", attribute, kind, components, flags, rows, planes, len(params)
    )  # SPEC 6.2
    return head + params


def payload(*records, count=None):
    body = b"".join(records)
    return memoryview(struct.pack("<H", len(records) if count is None else count) + body)


def random_quats(seed, rows):
    quats = np.random.default_rng(seed).normal(size=(rows, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    quats[quats[:, 0] < 0] *= -1
    return quats.astype(np.float32)


def some_streams():
    rng = np.random.default_rng(11)
    values = rng.normal(size=(200, 3)).astype(np.float32)
    escape = rng.normal(size=(7, 3)).astype(np.float32)
    logits = np.append(rng.normal(size=199), np.inf).astype(np.float32)[:, None]
    return [
        scalar.write(Attribute.SH0, values, fit(values, 0.01)),
        scalar.write(Attribute.SCALES, escape, fit(escape, 0.1), escape=True),
        scalar.write_with_infinities(Attribute.OPACITIES, logits, fit(logits[:199], 0.1)),
        quaternion.write(random_quats(1, 200), 0.01),
        quaternion.write(random_quats(2, 7), 0.01, escape=True),
    ]


def read_all(data):
    """Values of every stream."""
    values = []
    found = streams.unpack(memoryview(data), "head 5", 200)
    for one in found:
        out = np.zeros((one.rows, COMPONENTS[one.attribute]), np.float32)
        if one.kind == Kind.VQ:
            codebook_index.read_indices(one, 10)
        else:
            kinds.read(one, out)
        values.append(out)
    return values


@pytest.mark.parametrize("digits", [True, False])
def test_planes_can_be_compressed_after_they_were_packed(digits):
    plain = streams.pack_uncompressed(some_streams())
    at_once = streams.pack(some_streams(), digits=digits)
    assert streams.compress_payload(plain, digits=digits) == at_once
    assert len(at_once) < len(plain)
    for one in streams.unpack(memoryview(plain), "head 5", 200):
        assert not (one.words & np.uint32(ZSTD_FLAG | PACKED_FLAG)).any()
    for before, after in zip(read_all(plain), read_all(at_once), strict=True):
        np.testing.assert_array_equal(before, after)


def test_a_payload_gives_back_its_records():
    given_streams = some_streams()
    data = streams.pack(given_streams)
    found = streams.unpack(memoryview(data), "head 5", 200)
    assert [(s.attribute, s.kind, s.flags, s.rows) for s in found] == [
        (s.attribute, s.kind, s.flags, s.rows) for s in given_streams
    ]
    assert [bytes(s.params) for s in found] == [s.params for s in given_streams]
    assert 2 + sum(s.stored_bytes for s in found) == len(data)
    assert [s.label for s in found] == [
        "sh0 scalar", "scales scalar escape", "opacities scalar", "quats quat", "quats quat escape",
    ]  # fmt: skip
    assert found[1].flags == ESCAPE
    assert streams.pack(given_streams) == data


def test_a_payload_without_streams_is_two_zero_bytes():
    assert streams.pack([]) == bytes(2)
    assert streams.unpack(memoryview(bytes(2)), "head 5", 10) == []


def test_every_cut_and_every_extra_byte_is_refused():
    data = streams.pack(some_streams())
    read_all(data)
    for end in range(len(data)):
        refused(lambda end=end: streams.unpack(memoryview(data[:end]), "head 5", 200),
                "stream-record", "6.1")  # fmt: skip
    for extra in (b"\0", bytes(2), b"\xff" * 8, data):
        refused(lambda extra=extra: read_all(data + extra), "stream-record", "6.1")


def test_digits_are_shared_only_where_they_may_be():
    given_streams = some_streams()
    with_digits, without = (streams.pack(given_streams, digits=digits) for digits in (True, False))
    assert len(with_digits) < len(without)
    for data, packed in ((with_digits, True), (without, False)):
        found = streams.unpack(memoryview(data), "head 5", 200)
        assert any((one.words & PACKED_FLAG).any() for one in found) == packed
    for one, other in zip(read_all(with_digits), read_all(without), strict=True):
        assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize(
    ("broken", "code", "clause"),
    [
        (record(components=4), "stream-record", "6.2"),
        (record(attribute=1, components=1), "stream-record", "6.2"),
        (record(flags=4), "stream-record", "6.2"),
        (record(flags=128), "stream-record", "6.2"),
        (record(flags=INFINITIES), "stream-record", "6.2"),
        (record(attribute=2, kind=5, components=1, flags=INFINITIES), "stream-record", "6.2"),
        (record(rows=11), "stream-rows", "6.2"),
        (record(rows=2**32 - 1), "stream-rows", "6.2"),
        (record() + record(), "stream-duplicate", "6.2"),
        (record() + record(kind=5), "stream-duplicate", "6.2"),
    ],
)
def test_records_that_break_the_rules_are_refused(broken, code, clause):
    data = payload(broken, count=len(broken) // len(record()))
    refused(lambda: streams.unpack(data, "head 5", 10), code, clause)


def test_the_same_attribute_may_come_once_more_as_escape_rows():
    found = streams.unpack(payload(record(), record(flags=ESCAPE)), "head 5", 10)
    assert [s.flags for s in found] == [0, ESCAPE]


def test_what_a_later_version_may_add_is_unsupported_not_invalid():
    for number in (0, 200, 255):
        data = payload(record(attribute=number))
        refused(
            lambda data=data: streams.unpack(data, "head 5", 10),
            "stream-attribute-unknown",
            kind=UnsupportedError,
        )
        data = payload(record(kind=number))
        refused(
            lambda data=data: streams.unpack(data, "head 5", 10),
            "stream-kind-unknown",
            kind=UnsupportedError,
        )


def test_counts_that_do_not_fit_are_refused_before_anything_is_made():
    refused(
        lambda: streams.unpack(payload(record(), count=65), "head 5", 10), "stream-count", "9.1"
    )
    # 65535 planes and parameters in a payload of a few bytes.
    for broken in (record(planes=65535), record(params=b"12")[:-2]):
        refused(
            lambda broken=broken: streams.unpack(payload(broken), "head 5", 10), "stream-record"
        )
    # A plane that claims 2 GiB.
    huge = payload(record(planes=1) + struct.pack("<I", ZSTD_FLAG - 1))
    refused(lambda: streams.unpack(huge, "head 5", 10), "stream-record")


def test_any_flipped_byte_is_refused_or_read_to_the_right_shape():
    data = streams.pack(some_streams())
    rng = np.random.default_rng(12)
    for position in [*range(300), *rng.integers(300, len(data), 200).tolist()]:
        broken = bytearray(data)
        broken[position] ^= int(rng.integers(1, 256))
        try:
            for out in read_all(bytes(broken)):
                assert not np.isnan(out).any()
        except (FormatError, UnsupportedError):
            continue
