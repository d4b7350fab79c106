import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cogsplat.codec.order import first_view


def greedy(rows, inside, share):
    """Return rows in order, delaying rows outside until the share holds with them."""
    within = [row for row in rows if inside[row]]
    without = [row for row in rows if not inside[row]]
    place = {row: at for at, row in enumerate(rows)}
    out, outside = [], 0
    while within or without:
        allowed = outside + 1 <= (1 - share) * (len(out) + 1) + 1e-9
        turn = without and (not within or (place[without[0]] < place[within[0]] and allowed))
        if turn:
            out.append(without.pop(0))
            outside += 1
        else:
            out.append(within.pop(0))
    return out


@given(
    st.lists(st.booleans(), max_size=60),
    st.sampled_from([0.0, 0.25, 0.5, 0.6, 0.8, 1.0]),
    st.randoms(use_true_random=False),
)
def test_share_is_kept_up_as_a_greedy_choice_would(inside, share, random):
    rows = list(range(len(inside)))
    random.shuffle(rows)
    found = first_view.keep_share(np.array(rows, np.int64), np.array(inside, np.bool_), share)
    assert found.tolist() == greedy(rows, inside, share)


def test_every_prefix_holds_the_share_while_it_lasts():
    inside = np.zeros(1000, np.bool_)
    inside[700:] = True
    rows = first_view.keep_share(np.arange(1000), inside, 0.8)
    marks = inside[rows]
    held = np.cumsum(marks) / np.arange(1, 1001)
    assert (held[: np.flatnonzero(marks)[-1]] >= 0.8).all()


@pytest.mark.parametrize(("share", "count"), [(0.0, 0), (0.01, 1), (0.3, 3), (1.0, 4)])
def test_lead_takes_the_first_of_another_order(share, count):
    rows, ahead = np.array([5, 3, 1, 0, 2, 4, 9, 8, 7, 6]), np.array([9, 5, 6, 0])
    found = first_view.bring_forward(rows, ahead, share).tolist()
    assert found[:count] == ahead[:count].tolist()
    assert found[count:] == [row for row in rows.tolist() if row not in found[:count]]


@given(
    st.integers(1, 60),
    st.floats(0, 1),
    st.sampled_from([0.0, 0.25, 0.5, 0.8, 1.0]),
    st.randoms(use_true_random=False),
)
def test_both_orders_have_their_part_of_any_beginning(count, share, mix, random):
    rows, ahead = list(range(count)), list(range(count))
    random.shuffle(rows)
    random.shuffle(ahead)
    ahead = ahead[: random.randint(0, count)]
    found = first_view.bring_forward(np.array(rows), np.array(ahead, np.int64), share, mix).tolist()
    assert sorted(found) == list(range(count))
    first = ahead[: int(np.ceil(share * count))]
    for length in range(count + 1):
        # Ranks may tie: one row fewer of either order.
        own = first[: max(0, int(mix * length + 1e-9) - 1)]
        others = rows[: max(0, int((1 - mix) * length + 1e-9) - 1)]
        assert {*own, *others} <= set(found[:length])
    rest = [row for row in rows if row not in first]
    assert [row for row in found if row not in first] == rest
