import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec import rans
from cogsplat.codec.errors import FormatError
from cogsplat.codec.rans import MAX_LANES, Decoder, encode, lanes_for
from cogsplat.codec.rans_table import Table, unpack_table

BOTH = pytest.mark.parametrize("compiled", [False, True], ids=["numpy", "numba"])


def slow_weight(code):
    """Weight of a code, by a definition other than the module's: float fields, as in IEEE 754."""
    exponent, mantissa = code >> 4, code & 15
    if exponent == 0:
        return mantissa  # subnormal: no hidden bit
    return (0b1_0000 | mantissa) * 2 ** (exponent - 1)


def slow_freqs(codes):
    """Frequencies of a table's codes, symbol by symbol."""
    weights = [slow_weight(code) for code in codes]
    present = sum(weight > 0 for weight in weights)
    freqs, running, given_out = [], 0, 0
    for weight in weights:
        running += weight
        share = running * (4096 - present) // sum(weights) - given_out
        given_out += share
        freqs.append(share + 1 if weight else 0)
    return freqs


def slow_decode(body, lanes, planes):
    """Decode planes of (codes, n) one symbol at a time, in Python's own integers."""
    states = [int.from_bytes(body[4 * k : 4 * k + 4], "little") for k in range(lanes)]
    rest = body[4 * lanes :]
    words = [int.from_bytes(rest[i : i + 2], "little") for i in range(0, len(rest), 2)]
    results = []
    for codes, n in planes:
        freqs = slow_freqs(codes)
        plane = []
        while len(plane) < n:
            active = min(lanes, n - len(plane))
            for k in range(active):
                slot = states[k] % 4096
                symbol, cum = 0, 0
                while slot >= cum + freqs[symbol]:
                    cum += freqs[symbol]
                    symbol += 1
                plane.append(symbol)
                states[k] = freqs[symbol] * (states[k] // 4096) + slot - cum
            for k in range(active):
                if states[k] < 65536:
                    states[k] = states[k] * 65536 + words.pop(0)
        results.append(plane)
    assert states == [65536] * lanes
    assert words == []
    return results


def slow_encode(planes, lanes):
    """Encode planes of (codes, symbols) by undoing the steps of `slow_decode`, last first."""
    states = [65536] * lanes
    words = []
    for codes, plane in reversed(planes):
        freqs = slow_freqs(codes)
        for i in reversed(range(len(plane))):
            k, symbol = i % lanes, plane[i]
            if states[k] >= freqs[symbol] * 2**20:
                words.insert(0, states[k] % 65536)
                states[k] //= 65536
            quotient, remainder = divmod(states[k], freqs[symbol])
            states[k] = quotient * 4096 + sum(freqs[:symbol]) + remainder
    return b"".join(state.to_bytes(4, "little") for state in states) + b"".join(
        word.to_bytes(2, "little") for word in words
    )


def table_of(plane):
    return Table.from_counts(np.bincount(plane))


def decode_all(body, lanes, planes, compiled):
    decoder = Decoder(memoryview(body), lanes, compiled=compiled)
    results = [decoder.decode(table, plane.size) for table, plane in planes]
    decoder.finish()
    return results


@st.composite
def planes_with_tables(draw):
    """Up to four planes, from empty to a few steps of many lanes, flat to all but constant."""
    planes = []
    for _ in range(draw(st.integers(0, 4))):
        rng = np.random.default_rng(draw(st.integers(0, 2**32)))
        alphabet = draw(st.sampled_from([1, 2, 3, 17, 255, 256]))
        skew = draw(st.sampled_from([0.0, 0.1, 1.0, 10.0]))
        share = np.exp(-skew * rng.permutation(alphabet))
        n = draw(st.integers(0, 300))
        plane = rng.choice(alphabet, n, p=share / share.sum()).astype(np.uint8)
        planes.append((table_of(plane), plane))
    return planes


@given(planes_with_tables(), st.sampled_from([1, 2, 8, 64, MAX_LANES]))
@settings(max_examples=60, deadline=None)
def test_all_implementations_agree(planes, lanes):
    body = encode(planes, lanes)
    assert body == slow_encode([(table.codes, plane.tolist()) for table, plane in planes], lanes)
    slow = slow_decode(body, lanes, [(table.codes, plane.size) for table, plane in planes])
    assert slow == [plane.tolist() for _, plane in planes]
    for compiled in (False, True):
        decoded = decode_all(body, lanes, planes, compiled)
        assert [plane.tolist() for plane in decoded] == slow
        assert all(plane.dtype == np.uint8 for plane in decoded)


@BOTH
@pytest.mark.parametrize("lanes", [4, 1024])
def test_long_planes_come_back(compiled, lanes):
    # Longer than the blocks in which numpy looks symbols up, and not a whole number of steps.
    rng = np.random.default_rng(5)
    long = rng.geometric(0.4, 3 * 65536 + 777).clip(1, 200).astype(np.uint8)
    short = rng.integers(0, 256, 3, dtype=np.uint8)
    planes = [(table_of(plane), plane) for plane in (long[:130_000:9], short, long)]
    body = encode(planes, lanes)
    for (_, plane), decoded in zip(planes, decode_all(body, lanes, planes, compiled), strict=True):
        np.testing.assert_array_equal(plane, decoded)


def test_numpy_serves_where_numba_cannot_be_imported(monkeypatch):
    plane = np.arange(100, dtype=np.uint8)
    body = encode([(table_of(plane), plane)], 8)
    monkeypatch.setitem(sys.modules, "cogsplat.codec.rans_kernels", None)
    rans._compiled_decode.cache_clear()
    try:
        (decoded,) = decode_all(body, 8, [(table_of(plane), plane)], compiled=True)
    finally:
        rans._compiled_decode.cache_clear()
    np.testing.assert_array_equal(plane, decoded)


@pytest.mark.parametrize(
    "share",
    [
        [0.97, 0.01, 0.01, 0.01],
        [0.5, 0.5],
        np.exp(-np.arange(12) / 1.5),
        np.exp(-np.arange(40) / 8.0),
        np.ones(200),
        np.ones(256),
    ],
    ids=["sparse", "coin", "steep", "gentle", "flat", "bytes"],
)
def test_length_is_the_entropy_within_a_percent(share):
    n, lanes = 200_000, 16
    share = np.asarray(share) / np.sum(share)
    plane = np.random.default_rng(1).choice(share.size, n, p=share).astype(np.uint8)
    counts = np.bincount(plane)
    entropy_bytes = -(counts * np.log2(counts / n)).sum() / 8
    table = Table.from_counts(counts)
    body = encode([(table, plane)], lanes)
    assert len(body) <= 1.01 * entropy_bytes + 4 * lanes
    estimate_bytes = table.bits(counts) / 8
    assert abs(estimate_bytes - (len(table.pack()) + len(body))) <= 4 * lanes


def test_plane_of_one_symbol_takes_no_words():
    plane = np.full(100_000, 200, np.uint8)
    table = table_of(plane)
    assert len(encode([(table, plane)], 2)) == 8
    assert table.bits(np.bincount(plane)) == 8 * len(table.pack())


@pytest.mark.parametrize("num_bytes", [0, 1, 749, 750, 1499, 1500, 100_000, 10**9])
def test_lanes_add_less_than_their_share(num_bytes):
    lanes = lanes_for(num_bytes)
    assert 1 <= lanes <= MAX_LANES
    assert lanes & (lanes - 1) == 0
    assert lanes == 1 or 3 * lanes <= 0.004 * num_bytes
    assert lanes == MAX_LANES or 3 * 2 * lanes > 0.004 * num_bytes


# Tables


@given(st.lists(st.integers(0, 255), max_size=255), st.integers(1, 255), st.binary(max_size=3))
@settings(deadline=None)
def test_any_codes_make_a_table(codes, last, behind):
    codes = bytes([*codes, last])
    table, size = unpack_table(memoryview(Table(codes).pack() + behind))
    assert (table.codes, size) == (codes, len(codes) + 1)
    assert table.freqs.tolist() == slow_freqs(codes)
    assert int(table.freqs.sum()) == 4096
    assert ((table.freqs > 0) == (np.frombuffer(codes, np.uint8) > 0)).all()


@given(st.lists(st.one_of(st.integers(0, 3), st.integers(0, 2**40)), max_size=256))
@settings(deadline=None)
def test_a_table_has_the_symbols_that_were_counted(counts):
    counts = np.array(counts, np.int64)
    table = Table.from_counts(counts)
    occurs = np.flatnonzero(counts) if counts.any() else np.array([0])
    assert np.flatnonzero(table.freqs).tolist() == occurs.tolist()
    assert np.isfinite(table.bits(counts))


def test_every_symbol_can_be_rare():
    counts = np.ones(256, np.int64)
    counts[77] = 2**50
    freqs = Table.from_counts(counts).freqs
    assert (freqs == 1).sum() >= 252  # the least weights are still a little of the rest
    assert freqs.argmax() == 77


def test_a_table_without_a_symbol_cannot_code_it():
    table = Table.from_counts(np.array([5, 0, 7]))
    assert table.bits(np.array([0, 1])) == np.inf
    assert table.bits(np.array([1, 0, 0, 1])) == np.inf
    for symbol in (1, 3):
        with pytest.raises(ValueError, match=f"symbol {symbol} "):
            encode([(table, np.array([0, symbol], np.uint8))], 1)


@pytest.mark.parametrize("stored", [b"", b"\x00", b"\x02\x01\x01", b"\x00\x00", b"\x01\x07\x00"])
def test_bad_table_is_refused(stored):
    with pytest.raises(FormatError) as refusal:
        unpack_table(memoryview(stored))
    assert refusal.value.code == "rans-table"
    assert refusal.value.clause == "6.9"


@pytest.mark.parametrize("codes", [b"", b"\x00", b"\x01\x00", b"\x01" * 257])
def test_codes_that_cannot_be_packed_are_misuse(codes):
    with pytest.raises(ValueError, match="expected 1 to 256 codes"):
        Table(codes)


@pytest.mark.parametrize("counts", [np.ones(257, int), np.array([-1]), np.ones((2, 2), int)])
def test_counts_that_are_none_are_misuse(counts):
    with pytest.raises(ValueError, match="expected a row of up to 256"):
        Table.from_counts(counts)


# Bodies from hostile hands


@pytest.fixture
def planes():
    rng = np.random.default_rng(9)
    rows = [rng.binomial(60, 0.2, 500).astype(np.uint8), rng.integers(0, 9, 77).astype(np.uint8)]
    return [(table_of(row), row) for row in rows]


def refusal_of(body, lanes, planes, compiled):
    with pytest.raises(FormatError) as refusal:
        decode_all(body, lanes, planes, compiled)
    assert refusal.value.clause == "6.9"
    return refusal.value.code


@BOTH
@pytest.mark.parametrize("lanes", [-1, 0, 3, 2048, 2**40])
def test_lanes_out_of_range_are_refused(planes, compiled, lanes):
    assert refusal_of(bytes(1000), lanes, planes, compiled) == "rans-lanes"


@BOTH
def test_body_shorter_than_its_states_is_refused(planes, compiled):
    for size in (0, 1, 31):
        assert refusal_of(b"\x01" * size, 8, planes, compiled) == "rans-states"


@BOTH
def test_state_that_no_encoder_reaches_is_refused(planes, compiled):
    body = bytearray(encode(planes, 8))
    body[14:16] = b"\x00\x00"  # lane 3, upper half
    assert refusal_of(bytes(body), 8, planes, compiled) == "rans-states"


@BOTH
def test_half_a_word_is_refused(planes, compiled):
    assert refusal_of(encode(planes, 8)[:-1], 8, planes, compiled) == "rans-words"


@BOTH
@pytest.mark.parametrize("cut", [2, 20, 64, 200])
def test_words_that_run_out_are_refused(planes, compiled, cut):
    assert refusal_of(encode(planes, 8)[:-cut], 8, planes, compiled) == "rans-words"


@BOTH
def test_running_out_is_noticed_in_the_last_step_of_any_length(compiled):
    # A symbol takes half a word and a state holds one to spare: the third cannot be decoded.
    row = np.arange(256, dtype=np.uint8).repeat(2)
    table = table_of(row)
    body = encode([(table, row)], 16)[:64]
    for n in range(33, 70):
        decoder = Decoder(memoryview(body), 16, compiled=compiled)
        with pytest.raises(FormatError, match="ends after 0 words"):
            decoder.decode(table, n)


@BOTH
def test_words_left_over_are_refused(planes, compiled):
    assert refusal_of(encode(planes, 8) + b"\x00\x00", 8, planes, compiled) == "rans-end"


@BOTH
def test_planes_left_over_are_refused(planes, compiled):
    assert refusal_of(encode(planes, 8), 8, planes[:1], compiled) == "rans-end"


@BOTH
def test_state_that_is_not_the_first_is_refused(compiled):
    body = (65536).to_bytes(4, "little") + (65537).to_bytes(4, "little")
    assert refusal_of(body, 2, [], compiled) == "rans-end"


@given(st.binary(max_size=300), st.sampled_from([1, 4, 32]), st.integers(0, 200))
@settings(deadline=None)
def test_noise_is_refused_or_decoded_alike(noise, lanes, n):
    table = Table.from_counts(np.array([100, 20, 0, 3, 1]))
    outcomes = []
    for compiled in (False, True):
        try:
            decoder = Decoder(memoryview(noise), lanes, compiled=compiled)
            outcome = [decoder.decode(table, n).tolist(), decoder.decode(table, n).tolist()]
            decoder.finish()
        except FormatError as refusal:
            outcome = [refusal.code, refusal.message]
        outcomes.append(outcome)
    assert outcomes[0] == outcomes[1]


def test_damage_never_crashes(planes):
    body = encode(planes, 4)
    rng = np.random.default_rng(3)
    for _ in range(200):
        damaged = bytearray(body)
        damaged[rng.integers(len(damaged))] ^= 1 << rng.integers(8)
        outcomes = []
        for compiled in (False, True):
            try:
                rows = decode_all(bytes(damaged), 4, planes, compiled)
                outcomes.append([row.tolist() for row in rows])
            except FormatError as refusal:
                outcomes.append(refusal.code)
        assert outcomes[0] == outcomes[1]


@BOTH
def test_negative_length_is_misuse(planes, compiled):
    decoder = Decoder(memoryview(encode(planes, 1)), 1, compiled=compiled)
    with pytest.raises(ValueError, match="-1 symbols"):
        decoder.decode(planes[0][0], -1)


@pytest.mark.parametrize("lanes", [0, 3, 2048])
def test_encoding_into_odd_lanes_is_misuse(planes, lanes):
    with pytest.raises(ValueError, match="power of two"):
        encode(planes, lanes)


@pytest.mark.parametrize("row", [np.zeros(4, np.int64), np.zeros((2, 2), np.uint8)])
def test_planes_that_are_not_bytes_are_misuse(row):
    with pytest.raises(ValueError, match="expected one row of uint8"):
        encode([(Table(b"\x01"), row)], 1)
