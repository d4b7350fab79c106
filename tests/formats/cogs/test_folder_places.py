"""Tables of places: packed, read, and refused; names of objects."""

import hashlib

import numpy as np
import pytest

from cogsplat.codec.errors import FormatError
from cogsplat.formats.cogs.folder_places import (
    PlaceTable,
    check_object,
    key_of,
    object_name,
    pack_places,
    places_bytes,
    unpack_places,
)

KEYS = np.arange(48, dtype=np.uint8).reshape(3, 16)
PLACES = PlaceTable(KEYS, np.array([10, 20, 30], np.uint32), np.array([0, 15, 1], np.uint32))
LENGTHS = np.array([10, 5, 29], np.uint32)


def test_tables_come_back() -> None:
    data = pack_places(PLACES)
    # As SPEC 3.4 has it: names, sizes, offsets, CRC.
    assert len(data) == places_bytes(3) == 3 * 24 + 4
    assert data[:48] == bytes(range(48))
    assert np.frombuffer(data, "<u4", 6, 48).tolist() == [10, 20, 30, 0, 15, 1]
    found = unpack_places(data, LENGTHS, "x")
    assert (len(found), found.sizes.tolist(), found.offsets.tolist()) == (
        3,
        [10, 20, 30],
        [0, 15, 1],
    )
    assert np.array_equal(found.objects, KEYS)
    assert found.rows(slice(1, 2)).sizes.tolist() == [20]
    empty = pack_places(PLACES.rows(slice(0, 0)))
    assert empty == bytes(4)
    assert len(unpack_places(empty, LENGTHS[:0], "x")) == 0


@pytest.mark.parametrize("at", [0, 50, 75])
def test_a_flipped_bit_is_refused(at: int) -> None:
    data = bytearray(pack_places(PLACES))
    data[at] ^= 4
    with pytest.raises(FormatError) as refused:
        unpack_places(bytes(data), LENGTHS, "x")
    assert refused.value.code == "places-crc"


def test_a_segment_behind_its_object_is_refused() -> None:
    longest = np.array([10, 5, 2**32 - 1], np.uint32)
    for lengths in (LENGTHS + np.array([0, 1, 0], np.uint32), longest):
        with pytest.raises(FormatError, match="expected an end within") as refused:
            unpack_places(pack_places(PLACES), lengths, "x")
        assert refused.value.code == "places-range"


def test_objects_are_named_by_their_bytes() -> None:
    data = b"some bytes"
    name = f"segments/{hashlib.sha256(data).hexdigest()[:32]}.bin"
    assert object_name(key_of(data)) == name
    check_object(name, data, "x")
    with pytest.raises(FormatError, match=name) as refused:
        check_object(object_name(bytes(16)), data, "x")
    assert refused.value.code == "object-hash"
