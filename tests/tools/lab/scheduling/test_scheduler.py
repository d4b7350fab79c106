import json
from pathlib import Path

import numpy as np
import pytest

from cogsplat.tools.lab import make_decisions
from cogsplat.tools.lab.scheduling.scheduler import Holdings, Scheduler, Unit

VECTORS = json.loads((Path(__file__).parent / "decisions.json").read_text(encoding="utf-8"))

# Chunk 0 is the parent of 1 and 2, chunk 1 that of 3; each has a head and a refinement.
UNITS = [
    Unit(0, True, 100, 100, ()),
    Unit(1, True, 200, 100, (0,)),
    Unit(0, False, 300, 100, (0,)),
    Unit(2, True, 400, 100, (0,)),
    Unit(1, False, 500, 100, (1,)),
    Unit(3, True, 600, 100, (1,)),
    Unit(2, False, 700, 100, (3,)),
]
SPLATS = [10, 10, 10, 10]
SAME = np.ones(4)


def held(there=(), under_way=(), received=None, budget=0, rate=400.0, latency=0.25):
    return Holdings(frozenset(there), frozenset(under_way), received or {}, budget, rate, latency)


def decide(ratios, **state):
    return Scheduler(UNITS, SPLATS).decide(np.array(ratios), held(**state))


def test_the_shared_vectors_are_what_the_generator_makes():
    assert make_decisions.text() == (Path(__file__).parent / "decisions.json").read_text(
        encoding="utf-8"
    )
    states = VECTORS["states"]
    assert len(states) >= 1000
    for place in range(3):
        assert sum(bool(state["decision"][place]) for state in states) >= 100


def test_where_all_is_as_usual_the_order_is_that_of_the_file():
    assert decide(SAME).fetch == [0, 1]
    assert decide(SAME, rate=4000.0).fetch == list(range(7))
    assert decide(SAME, there=[0, 1], under_way=[2]).fetch == [3]
    assert decide(SAME, there=range(7)).fetch == []


def test_what_is_shown_comes_first_behind_what_it_needs():
    assert decide([1.0, 0.01, 0.01, 9.0], rate=600.0).fetch == [0, 1, 5]
    assert decide([0.01, 0.01, 9.0, 0.01], there=[0]).fetch == [3, 6]


def test_of_a_chain_one_unit_is_asked_for_at_a_time():
    # Chunk 3 is what the pose shows; it needs chunks 0 and 1, of which it shows nothing.
    ratios = [0.01, 0.01, 0.02, 90.0]
    assert decide(ratios, rate=1.0).fetch == [0]
    assert decide(ratios, rate=1.0, there=[0]).fetch == [1]
    # The visitor turns around meanwhile: the rest of the chain is not asked for.
    assert decide([0.01, 0.01, 90.0, 0.02], rate=1.0, there=[0]).fetch == [3]
    # What the chain needs is not stopped for the sake of what it leads to.
    slow = {"rate": 100.0, "latency": 0.1}
    assert decide(ratios, there=[0], under_way=[1], **slow).stop == []


def test_a_long_chain_is_worth_what_all_of_it_brings():
    units = [Unit(0, True, 100, 100, ()), *(Unit(k, True, 200, 100, (k - 1,)) for k in (1, 2, 3))]
    units.append(Unit(4, True, 200, 100, (0,)))
    scheduler = Scheduler(units, [10] * 5)
    state = held(there=[0], rate=1.0)
    # 3 alone would be worth more than 4, but 1 and 2 come with it.
    assert scheduler.decide(np.array([1.0, 0.0, 0.0, 2.9, 1.0]), state).fetch == [4]
    assert scheduler.decide(np.array([1.0, 0.0, 0.0, 3.1, 1.0]), state).fetch == [1]


def test_one_unit_is_under_way_however_slow_the_connection():
    assert decide(SAME, rate=1.0, latency=0.0).fetch == [0]
    assert decide(SAME, rate=1.0, latency=0.0, under_way=[0]).fetch == []


def test_what_came_before_counts():
    # Of unit 1 ten bytes are left, so that there is room for another.
    assert decide(SAME, there=[0], received={1: 90}).fetch == [1, 2, 3]


def test_what_waits_far_behind_is_stopped():
    slow = {"rate": 100.0, "latency": 0.1}
    ratios = [1.0, 0.01, 9.0, 0.01]
    decision = decide(ratios, there=[0, 1, 2, 3], under_way=[4], **slow)
    assert decision.stop == [4]
    assert decision.fetch == [6]
    # What would be here within a round trip is let come, and so is what something else needs.
    nearly = {"received": {4: 95}, **slow}
    assert decide(ratios, there=[0, 1, 2, 3], under_way=[4], **nearly).stop == []
    assert decide([1.0, 0.01, 9.0, 5.0], there=[0, 2], under_way=[1, 5], **slow).stop == []
    assert decide(ratios, there=[0, 2], under_way=[1, 5], **slow).stop == [5, 1]


def test_a_budget_is_kept_by_throwing_away_what_is_worth_least():
    ratios = [1.0, 0.001, 9.0, 0.001]
    decision = decide(ratios, there=[0, 1, 5], budget=30)
    assert decision.evict == [3]
    assert decision.fetch[0] == 3
    # Chunk 1 is the parent of 3: it goes when that has gone.
    tight = decide(ratios, there=[0, 1, 5], budget=20)
    assert tight.evict == [3, 1]
    # Chunks of nearly one worth do not take turns.
    assert decide([1.0, 1.0, 1.5, 1.0], there=[0, 1], budget=20).evict == []
    assert decide([1.0, 1.0, 1.5, 1.0], there=[0, 1], budget=20).fetch == [2, 4]


def test_a_budget_that_was_lowered_is_kept_by_throwing_away_what_is_worth_least():
    # Chunk 3 is the last of the file, and nobody's parent; chunk 2 is the next.
    decision = decide(SAME, there=range(7), budget=25)
    assert decision.evict == [3, 2]
    assert decision.fetch == []
    # A parent goes when its children have gone.
    assert decide([1.0, 0.1, 9.0, 1.0], there=range(7), budget=20).evict == [3, 1]


def test_nothing_is_thrown_away_for_what_does_not_fit_all_the_same():
    units = [*UNITS[:2], Unit(2, True, 400, 100, (0,))]
    scheduler = Scheduler(units, [10, 10, 50])
    decision = scheduler.decide(np.array([1.0, 0.001, 9.0]), held(there=[0, 1], budget=40))
    assert decision.evict == []
    assert decision.fetch == []


@pytest.mark.parametrize("rate", [1.0, 4000.0])
@pytest.mark.parametrize("number", range(len(VECTORS["scenes"])))
def test_a_visitor_who_stands_still_is_done_whatever_the_budget(number, rate):
    scene = VECTORS["scenes"][number]
    units = [Unit(c, bool(head), end, size, tuple(a)) for c, head, end, size, a in scene["units"]]
    scheduler = Scheduler(units, scene["splats"])
    rng = np.random.default_rng(number)
    for share in (0.3, 0.5, 0.7, 0.9):
        ratios = np.exp(rng.normal(0.0, 2.0, len(scene["splats"])))
        budget = int(share * sum(scene["splats"]))
        there = set()
        decision = None
        # All that is asked for comes at once. A unit may come again where others needed its room.
        for _ in range(4 * len(units)):
            decision = scheduler.decide(ratios, held(there, budget=budget, rate=rate))
            there -= {at for at, unit in enumerate(units) if unit.chunk in decision.evict}
            there |= set(decision.fetch)
            if not decision.fetch:
                break
        assert not decision.fetch
        assert not decision.evict


def test_what_is_thrown_away_on_its_way_is_stopped():
    decision = decide([1.0, 0.001, 9.0, 0.001], there=[0], under_way=[1], budget=20, latency=9.0)
    assert (decision.evict, decision.stop) == ([1], [1])


@pytest.mark.parametrize("number", range(0, 1200, 13))
def test_decisions_keep_what_they_promise(number):
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
    # Nothing that stays lacks what it needs.
    assert all(set(units[unit][4]) <= there | coming | gone for unit in there)
    heads = {units[unit][0] for unit in there | coming if units[unit][1]}
    used = sum(scene["splats"][chunk] for chunk in heads)
    new = any(units[unit][1] for unit in fetch)
    assert not new or not state["budget_splats"] or used <= state["budget_splats"]
