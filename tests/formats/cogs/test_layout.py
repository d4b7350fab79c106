from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cogsplat.codec.errors import CogsplatError, FormatError, TruncatedError, UnsupportedError
from cogsplat.formats.cogs import layout

PREAMBLE = layout.Preamble(0, layout.MINOR, 500, 10_000, 0xDEADBEEF)


@given(
    st.integers(1, layout.MAX_ROOT_END - layout.PREAMBLE_BYTES),
    st.integers(0, layout.MAX_FILE_BYTES - layout.MAX_ROOT_END),
    st.integers(0, (1 << 32) - 1),
)
def test_preambles_come_back(root, behind, crc):
    preamble = layout.Preamble(0, layout.MINOR, root, layout.PREAMBLE_BYTES + root + behind, crc)
    data = layout.pack_preamble(preamble)
    assert len(data) == 64
    assert layout.unpack_preamble(data, "here") == preamble


@pytest.mark.parametrize("minor", [0, 1, 2, 4, 65535])
def test_other_minor_versions_are_refused(minor):
    data = layout.pack_preamble(replace(PREAMBLE, minor=minor))
    with pytest.raises(UnsupportedError) as caught:
        layout.unpack_preamble(data, "here")
    assert caught.value.code == "version-minor"


@given(st.integers(0, 511))
def test_every_bit_flip_is_found(bit):
    data = bytearray(layout.pack_preamble(PREAMBLE))
    data[bit // 8] ^= 1 << bit % 8
    with pytest.raises(FormatError) as caught:
        layout.unpack_preamble(bytes(data), "here")
    assert caught.value.code == ("not-cogs" if bit < 64 else "preamble-crc")


@pytest.mark.parametrize("length", range(64))
def test_every_cut_asks_for_more(length):
    with pytest.raises(TruncatedError) as caught:
        layout.unpack_preamble(layout.pack_preamble(PREAMBLE)[:length], "here")
    assert (caught.value.code, caught.value.needed) == ("preamble-truncated", 64)


@given(st.binary(max_size=200))
def test_any_bytes_are_refused_in_kind(data):
    with pytest.raises(CogsplatError):
        layout.unpack_preamble(data, "here")


@pytest.mark.parametrize(
    ("data", "hint"),
    [
        (b"ply\nformat ascii 1.0\n", "PLY"),
        (b"\x1f\x8b" + bytes(62), "gzip"),
        (b"PK\x03\x04" + bytes(60), "ZIP"),
        (b"<!DOCTYPE html>", "markup"),
        (layout.MAGIC[::-1], "reverse"),
    ],
)
def test_relatives_are_called_by_name(data, hint):
    with pytest.raises(FormatError, match=hint) as caught:
        layout.unpack_preamble(data, "here")
    assert caught.value.code == "not-cogs"
