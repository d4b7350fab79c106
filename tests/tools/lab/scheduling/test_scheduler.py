import json
from pathlib import Path

import numpy as np
import pytest

from cogsplat.tools.lab import make_decisions
from cogsplat.tools.lab.scheduling.scheduler import ClientState, Scheduler, Unit

VECTORS = json.loads((Path(__file__).parent / "decisions.json").read_text(encoding="utf-8"))


def unit_at(end, row, is_head, dependencies):
    """Return a unit of 100 bytes whose gain falls as the square of its end."""
    return Unit(row, is_head, 100.0 / end**2, 100, dependencies)


# Chunk 0 is the parent of 1 and 2, chunk 1 that of 3; each has a head and a refinement.
UNITS = [
    unit_at(100, 0, True, ()),
    unit_at(200, 1, True, (0,)),
    unit_at(300, 0, False, (0,)),
    unit_at(400, 2, True, (0,)),
    unit_at(500, 1, False, (1,)),
    unit_at(600, 3, True, (1,)),
    unit_at(700, 2, False, (3,)),
]
SPLATS = [10, 10, 10, 10]
# As gains per byte fall, so do contributions.
CONTRIBUTION = [1.0, 0.5, 0.25, 0.125]
EQUAL = np.ones(4)


def client(
    present=(), in_flight=(), received=None, budget=0, rate=400.0, latency=0.25, evicted=None
):
    return ClientState(
        frozenset(present),
        frozenset(in_flight),
        received or {},
        budget,
        rate,
        latency,
        evicted or {},
    )


def decide(ratios, **state):
    return Scheduler(UNITS, SPLATS, CONTRIBUTION).decide(np.array(ratios), client(**state))


def test_the_stored_vectors_match_the_generator():
    assert make_decisions.text() == (Path(__file__).parent / "decisions.json").read_text(
        encoding="utf-8"
    )
    states = VECTORS["states"]
    assert len(states) >= 1000
    for action in range(3):
        assert sum(bool(state["decision"][action]) for state in states) >= 100
    assert sum(bool(max(tree["growth"])) for tree in VECTORS["trees"]) >= 10


def test_equal_ratios_give_the_order_of_the_file():
    assert decide(EQUAL).fetch == [0, 1]
    assert decide(EQUAL, rate=4000.0).fetch == list(range(7))
    assert decide(EQUAL, present=[0, 1], in_flight=[2]).fetch == [3]
    assert decide(EQUAL, present=range(7)).fetch == []


def test_visible_chunks_come_first_after_their_dependencies():
    assert decide([1.0, 0.01, 0.01, 9.0], rate=600.0).fetch == [0, 1, 5]
    assert decide([0.01, 0.01, 9.0, 0.01], present=[0]).fetch == [3, 6]


def test_a_chain_is_requested_one_unit_at_a_time():
    # Only chunk 3 is visible; it depends on chunks 0 and 1.
    ratios = [0.01, 0.01, 0.02, 90.0]
    assert decide(ratios, rate=1.0).fetch == [0]
    assert decide(ratios, rate=1.0, present=[0]).fetch == [1]
    # The camera turns around meanwhile: the rest of the chain is not requested.
    assert decide([0.01, 0.01, 90.0, 0.02], rate=1.0, present=[0]).fetch == [3]
    # A dependency in flight has the value of the units that depend on it.
    slow = {"rate": 100.0, "latency": 0.1}
    assert decide(ratios, present=[0], in_flight=[1], **slow).abort == []


def test_the_value_of_a_chain_is_the_mean_over_its_bytes():
    units = [unit_at(100, 0, True, ()), *(unit_at(200, k, True, (k - 1,)) for k in (1, 2, 3))]
    units.append(unit_at(200, 4, True, (0,)))
    scheduler = Scheduler(units, [10] * 5, [1.0] * 5)
    state = client(present=[0], rate=1.0)
    # Unit 3 alone has a higher urgency than 4, but 1 and 2 have to be fetched with it.
    assert scheduler.decide(np.array([1.0, 0.0, 0.0, 2.9, 1.0]), state).fetch == [4]
    assert scheduler.decide(np.array([1.0, 0.0, 0.0, 3.1, 1.0]), state).fetch == [1]


def test_at_least_one_unit_is_in_flight():
    assert decide(EQUAL, rate=1.0, latency=0.0).fetch == [0]
    assert decide(EQUAL, rate=1.0, latency=0.0, in_flight=[0]).fetch == []


def test_bytes_received_before_an_abort_count():
    # Unit 1 has ten bytes left, so the window has room for another unit.
    assert decide(EQUAL, present=[0], received={1: 90}).fetch == [1, 2, 3]


def test_units_of_far_lower_value_are_aborted():
    slow = {"rate": 100.0, "latency": 0.1}
    ratios = [1.0, 0.01, 9.0, 0.01]
    decision = decide(ratios, present=[0, 1, 2, 3], in_flight=[4], **slow)
    assert decision.abort == [4]
    assert decision.fetch == [6]
    # Units that complete within the latency, or are dependencies, are not aborted.
    nearly = {"received": {4: 95}, **slow}
    assert decide(ratios, present=[0, 1, 2, 3], in_flight=[4], **nearly).abort == []
    assert decide([1.0, 0.01, 9.0, 5.0], present=[0, 2], in_flight=[1, 5], **slow).abort == []
    assert decide(ratios, present=[0, 2], in_flight=[1, 5], **slow).abort == [5, 1]


def test_a_budget_is_kept_by_evicting_the_least_valuable_chunks():
    ratios = [1.0, 0.001, 9.0, 0.001]
    decision = decide(ratios, present=[0, 1, 5], budget=30)
    assert list(decision.evict) == [3]
    assert decision.fetch[0] == 3
    # Chunk 1 is the parent of 3 and is evicted after it.
    tight = decide(ratios, present=[0, 1, 5], budget=20)
    assert list(tight.evict) == [3, 1]
    # Chunks of similar value do not replace each other.
    assert list(decide([1.0, 1.0, 1.5, 1.0], present=[0, 1], budget=20).evict) == []
    assert decide([1.0, 1.0, 1.5, 1.0], present=[0, 1], budget=20).fetch == [2, 4]


def test_an_evicted_chunk_is_fetched_again_once_it_is_worth_more():
    gone = decide([1.0, 1.0, 9.0, 0.001], present=[0, 1], budget=20).evict
    assert gone == {1: 2 * 0.5 / 10}
    # The pose turns back: without the eviction the chunk would be fetched at once.
    back = [1.0, 1.9, 0.001, 0.001]
    assert 1 in decide(back, present=[0, 3], budget=20).fetch
    assert decide(back, present=[0, 3], budget=20, evicted=gone).fetch == [2, 6]
    assert 1 in decide([1.0, 2.0, 0.001, 0.001], present=[0, 3], budget=20, evicted=gone).fetch


def test_a_lowered_budget_is_kept_by_evicting_the_least_valuable_chunks():
    # Chunk 3 is the last of the file and no parent; chunk 2 follows.
    decision = decide(EQUAL, present=range(7), budget=25)
    assert list(decision.evict) == [3, 2]
    assert decision.fetch == []
    # A parent is evicted after its children.
    assert list(decide([1.0, 0.1, 9.0, 1.0], present=range(7), budget=20).evict) == [3, 1]


def test_nothing_is_evicted_for_a_chunk_that_still_would_not_fit():
    units = [*UNITS[:2], unit_at(400, 2, True, (0,))]
    scheduler = Scheduler(units, [10, 10, 50], [1.0, 0.5, 0.5])
    decision = scheduler.decide(np.array([1.0, 0.001, 9.0]), client(present=[0, 1], budget=40))
    assert list(decision.evict) == []
    assert decision.fetch == []


@pytest.mark.parametrize("rate", [1.0, 4000.0])
@pytest.mark.parametrize("number", range(len(VECTORS["scenes"])))
def test_fetching_at_a_fixed_pose_ends_under_any_budget(number, rate):
    scene = VECTORS["scenes"][number]
    units = [Unit(c, bool(head), gain, size, tuple(a)) for c, head, gain, size, a in scene["units"]]
    scheduler = Scheduler(units, scene["splats"], scene["contribution"])
    rng = np.random.default_rng(number)
    for share in (0.3, 0.5, 0.7, 0.9):
        ratios = np.exp(rng.normal(0.0, 2.0, len(scene["splats"])))
        budget = int(share * sum(scene["splats"]))
        there = set()
        decision = None
        # Requested units arrive at once. An evicted unit may be fetched again.
        for _ in range(4 * len(units)):
            decision = scheduler.decide(ratios, client(there, budget=budget, rate=rate))
            there -= {at for at, unit in enumerate(units) if unit.row in decision.evict}
            there |= set(decision.fetch)
            if not decision.fetch:
                break
        assert not decision.fetch
        assert not decision.evict


@pytest.mark.parametrize("number", range(len(VECTORS["scenes"])))
def test_fetching_at_a_fixed_pose_ends_though_requests_wait(number):
    scene = VECTORS["scenes"][number]
    units = [Unit(c, bool(head), gain, size, tuple(a)) for c, head, gain, size, a in scene["units"]]
    scheduler = Scheduler(units, scene["splats"], scene["contribution"])
    rng = np.random.default_rng(number)
    for share in np.linspace(0.2, 0.9, 15):
        ratios = np.exp(rng.normal(0.0, 2.0, len(scene["splats"])))
        budget = int(share * sum(scene["splats"]))
        # These units are in the first bytes of the file and arrive at once; others are requested
        # one at a time, as the connection has room.
        first_bytes = {at for at in range(len(units)) if rng.random() < 0.5}
        there, coming = set(), set()
        for _ in range(8 * len(units)):
            decision = scheduler.decide(ratios, client(there, coming, budget=budget, rate=4000.0))
            gone = {at for at, unit in enumerate(units) if unit.row in decision.evict}
            there -= gone
            coming -= gone | set(decision.abort)
            found = first_bytes & set(decision.fetch)
            there |= found
            if not found and decision.fetch and not coming:
                coming.add(next(unit for unit in decision.fetch))
            elif not found and coming:
                there.add(coming.pop())
            elif not found:
                break
        else:
            pytest.fail(f"no end within a budget of {budget} splats")


def test_evicted_units_in_flight_are_aborted():
    decision = decide([1.0, 0.001, 9.0, 0.001], present=[0], in_flight=[1], budget=20, latency=9.0)
    assert (list(decision.evict), decision.abort) == ([1], [1])


@pytest.mark.parametrize("number", range(0, 1200, 13))
def test_decisions_keep_dependencies_and_budget(number):
    state = VECTORS["states"][number]
    scene = VECTORS["scenes"][state["scene"]]
    units = scene["units"]
    stop, evict, fetch = state["decision"]
    gone = {unit for unit, row in enumerate(units) if row[0] in evict}
    there = set(state["there"]) - gone
    coming = set(state["under_way"]) - set(stop) - gone
    for unit in fetch:
        assert unit not in there | coming | gone | set(stop)
        assert set(units[unit][4]) <= there | coming
        coming.add(unit)
    # Units that stay have their dependencies.
    assert all(set(units[unit][4]) <= there | coming | gone for unit in there)
    heads = {units[unit][0] for unit in there | coming if units[unit][1]}
    used = sum(scene["splats"][chunk] for chunk in heads)
    new = any(units[unit][1] for unit in fetch)
    assert not new or not state["budget_splats"] or used <= state["budget_splats"]
