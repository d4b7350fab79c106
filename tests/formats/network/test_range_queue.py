import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cogsplat.formats.network.range_queue import PendingRange, RangeQueue, Request

DATA = np.random.default_rng(3).bytes(4000)


def spans(queue, most=1 << 30):
    found = []
    while (request := queue.next_request(most)) is not None:
        found.append((request.first, request.end))
    return found


def test_neighbours_are_joined_in_the_order_in_which_they_are_wanted():
    queue = RangeQueue(gap_bytes=10, request_bytes=1000)
    queue.add(
        [
            PendingRange(500, 600),
            PendingRange(400, 495),
            PendingRange(0, 10),
            PendingRange(610, 700),
            PendingRange(711, 720),
        ]
    )
    assert spans(queue) == [(400, 600), (0, 10), (610, 700), (711, 720)]


def test_requests_of_several_ranges_are_limited_and_single_ranges_are_not():
    queue = RangeQueue(gap_bytes=10, request_bytes=100)
    queue.add([PendingRange(0, 60), PendingRange(60, 120), PendingRange(120, 1000)])
    assert spans(queue) == [(0, 60), (60, 120), (120, 1000)]
    queue.add([PendingRange(0, 30), PendingRange(30, 60)])
    assert spans(queue, most=40) == [(0, 30), (30, 60)]


def test_urgent_ranges_come_first_and_once():
    queue = RangeQueue(gap_bytes=0, request_bytes=100)
    late = PendingRange(900, 950)
    queue.add([PendingRange(0, 50), late])
    assert queue.bytes_before(late, 1000) == 50
    assert queue.bytes_before(late, 20) == 20
    queue.add([late], urgent=True)
    assert queue.has_urgent
    assert spans(queue) == [(900, 950), (0, 50)]


def test_dropped_ranges_are_not_requested():
    queue = RangeQueue(gap_bytes=0, request_bytes=100)
    ranges = [PendingRange(0, 10), PendingRange(50, 60), PendingRange(60, 70)]
    ranges[0].is_dropped = ranges[2].is_dropped = True
    queue.add(ranges)
    assert spans(queue) == [(50, 60)]


def test_clearing_gives_what_was_wanted():
    queue = RangeQueue(gap_bytes=0, request_bytes=100)
    queue.add([PendingRange(0, 10)])
    queue.add([PendingRange(20, 30)], urgent=True)
    assert [pending.first for pending in queue.clear()] == [20, 0]
    assert spans(queue) == []


def test_received_bytes_of_a_range_are_not_requested():
    pending = PendingRange(90, 200)
    pending.receive(0, DATA[:100])
    assert pending.position == 100
    request = Request([pending, PendingRange(205, 210)])
    assert (request.first, request.missing) == (100, 110)
    request.receive(DATA[100:210])
    assert pending.is_complete
    assert pending.bytes_at(90, 200) == DATA[90:200]


@given(
    ranges=st.lists(
        st.tuples(st.integers(0, 3800), st.integers(1, 200)), min_size=1, max_size=12, unique=True
    ),
    cuts=st.lists(st.integers(1, 400), min_size=1, max_size=5),
    gap=st.integers(0, 300),
)
def test_ranges_are_right_however_responses_are_split(ranges, cuts, gap):
    queue = RangeQueue(gap_bytes=gap, request_bytes=1500)
    ranges = [PendingRange(first, first + length) for first, length in ranges]
    queue.add(ranges)
    while (request := queue.next_request(1500)) is not None:
        step = 0
        while request.missing:
            part = DATA[request.position : request.position + cuts[step % len(cuts)]]
            request.receive(part[: request.missing])
            step += 1
    for pending in ranges:
        assert pending.is_complete
        assert pending.bytes_at(pending.first, pending.end) == DATA[pending.first : pending.end]
