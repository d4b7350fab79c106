import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cogsplat.formats.network.range_queue import Piece, RangeQueue, Request

DATA = np.random.default_rng(3).bytes(4000)


def spans(queue, most=1 << 30):
    found = []
    while (request := queue.next_request(most)) is not None:
        found.append((request.first, request.end))
    return found


def test_neighbours_are_joined_in_the_order_in_which_they_are_wanted():
    queue = RangeQueue(gap_bytes=10, request_bytes=1000)
    queue.add([Piece(500, 600), Piece(400, 495), Piece(0, 10), Piece(610, 700), Piece(711, 720)])
    assert spans(queue) == [(400, 600), (0, 10), (610, 700), (711, 720)]


def test_requests_of_several_pieces_are_bounded_and_single_pieces_are_not():
    queue = RangeQueue(gap_bytes=10, request_bytes=100)
    queue.add([Piece(0, 60), Piece(60, 120), Piece(120, 1000)])
    assert spans(queue) == [(0, 60), (60, 120), (120, 1000)]
    queue.add([Piece(0, 30), Piece(30, 60)])
    assert spans(queue, most=40) == [(0, 30), (30, 60)]


def test_urgent_pieces_come_first_and_once():
    queue = RangeQueue(gap_bytes=0, request_bytes=100)
    late = Piece(900, 950)
    queue.add([Piece(0, 50), late])
    assert queue.bytes_before(late, 1000) == 50
    assert queue.bytes_before(late, 20) == 20
    queue.add([late], urgent=True)
    assert queue.is_urgent
    assert spans(queue) == [(900, 950), (0, 50)]


def test_dropped_pieces_are_not_asked_for():
    queue = RangeQueue(gap_bytes=0, request_bytes=100)
    pieces = [Piece(0, 10), Piece(50, 60), Piece(60, 70)]
    pieces[0].is_dropped = pieces[2].is_dropped = True
    queue.add(pieces)
    assert spans(queue) == [(50, 60)]


def test_clearing_gives_what_was_wanted():
    queue = RangeQueue(gap_bytes=0, request_bytes=100)
    queue.add([Piece(0, 10)])
    queue.add([Piece(20, 30)], urgent=True)
    assert [piece.first for piece in queue.clear()] == [20, 0]
    assert spans(queue) == []


def test_what_is_there_of_a_piece_is_not_asked_for():
    piece = Piece(90, 200)
    piece.take(0, DATA[:100])
    assert piece.position == 100
    request = Request([piece, Piece(205, 210)])
    assert (request.first, request.missing) == (100, 110)
    request.take(DATA[100:210])
    assert piece.is_whole
    assert piece.bytes_at(90, 200) == DATA[90:200]


@given(
    ranges=st.lists(
        st.tuples(st.integers(0, 3800), st.integers(1, 200)), min_size=1, max_size=12, unique=True
    ),
    cuts=st.lists(st.integers(1, 400), min_size=1, max_size=5),
    gap=st.integers(0, 300),
)
def test_pieces_are_right_however_answers_are_cut(ranges, cuts, gap):
    queue = RangeQueue(gap_bytes=gap, request_bytes=1500)
    pieces = [Piece(first, first + length) for first, length in ranges]
    queue.add(pieces)
    while (request := queue.next_request(1500)) is not None:
        step = 0
        while request.missing:
            part = DATA[request.position : request.position + cuts[step % len(cuts)]]
            request.take(part[: request.missing])
            step += 1
    for piece in pieces:
        assert piece.is_whole
        assert piece.bytes_at(piece.first, piece.end) == DATA[piece.first : piece.end]
