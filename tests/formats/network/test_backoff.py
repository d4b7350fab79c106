import pytest

from cogsplat.codec.errors import StorageError
from cogsplat.formats.network.backoff import Backoff, TransientError, retry_after_seconds
from cogsplat.formats.network.network_options import NetworkOptions

NOON = "Sun, 22 Nov 2026 12:00:00 GMT"


@pytest.mark.parametrize(
    ("header", "date", "wait"),
    [
        (None, None, 0.0),
        ("3", None, 3.0),
        (" 120 ", NOON, 120.0),
        ("Sun, 22 Nov 2026 12:00:30 GMT", NOON, 30.0),
        ("Sun, 22 Nov 2026 11:00:00 GMT", NOON, 0.0),
        ("Sun, 22 Nov 2026 12:00:30 -0000", NOON, 30.0),
        ("-3", None, 0.0),
        ("soon", None, 0.0),
        ("9" * 30, None, 0.0),
        ("Sun, 22 Nov 2026 12:00:30 +9999", NOON, 0.0),
        ("Sun, 22 Nov 2026 12:00:30 -99999999999", NOON, 0.0),
        ("Fri, 31 Dec 9999 23:59:59 GMT", NOON, 251606951999.0),
        ("Fri, 31 Dec 9999 23:59:59 -2359", "Fri, 31 Dec 9999 23:59:59 -2359", 0.0),
        ("Mon, 01 Jan 0001 00:00:00 +2359", NOON, 0.0),
        ("3", "Mon, 01 Jan 0001 00:00:00 +2359", 3.0),
        ("Sun, 99 Foo 99999999999999999999 1:1:1 GMT", NOON, 0.0),
    ],
)
def test_a_server_asks_for_seconds_or_for_a_date_of_its_clock(header, date, wait):
    assert retry_after_seconds(header, date) == wait


@pytest.mark.parametrize("chance", [0.0, 1.0])
def test_pauses_double_up_to_the_longest_and_half_of_them_is_chance(chance):
    backoff = Backoff(NetworkOptions(retries=8, random=lambda: chance))
    fault = TransientError("http-status", "a: status 500")
    pauses = [backoff.pause_after(fault) for _ in range(8)]
    whole = [0.25, 0.5, 1, 2, 4, 8, 8, 8]
    assert pauses == [pause * (1 + chance) / 2 for pause in whole]


def test_a_wait_that_is_asked_for_comes_on_top():
    backoff = Backoff(NetworkOptions(random=lambda: 1.0))
    assert backoff.pause_after(TransientError("http-status", "a", wait_seconds=5)) == 5.25


def test_attempts_end_and_begin_anew_with_progress():
    backoff = Backoff(NetworkOptions(retries=2))
    fault = TransientError("connection-broken", "a: broke")
    for _ in range(5):
        backoff.pause_after(fault)
        assert not backoff.add_bytes(16383)
        assert backoff.add_bytes(1)
    # A byte with each attempt is no progress.
    backoff.add_bytes(1)
    backoff.pause_after(fault)
    backoff.pause_after(fault)
    with pytest.raises(StorageError, match="a: broke; 3 attempts without progress") as caught:
        backoff.pause_after(fault)
    assert caught.value.code == "connection-broken"


def test_a_wait_that_is_too_long_is_the_end():
    backoff = Backoff(NetworkOptions(longest_wait_seconds=10))
    with pytest.raises(StorageError):
        backoff.pause_after(TransientError("http-status", "a", wait_seconds=11))
