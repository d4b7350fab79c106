import pytest

from cogsplat.codec.fit.time_budget import TimeBudget


class Clock:
    now = 100.0

    def __call__(self):
        return self.now

    def spend(self, seconds):
        self.now += seconds


def test_without_a_limit_the_plan_stays():
    budget = TimeBudget(None, Clock())
    budget.timed(lambda: None, 10.0)
    budget.plan(5.0, 1e9)
    assert budget.steps(150, stretched=True) == budget.steps(150, stretched=False) == 150
    assert budget.fitting(40, 1e9, 1e9) == 40


def test_before_anything_was_timed_the_plan_stays():
    budget = TimeBudget(10.0, Clock())
    budget.plan(1e9, 1e9)
    assert budget.factor == 1.0


def test_steps_become_fewer_until_the_time_is_over():
    clock = Clock()
    budget = TimeBudget(100.0, clock)
    # Two seconds for one of work: 60 seconds are left for work that would take 160.
    budget.timed(lambda: clock.spend(40.0), 20.0)
    budget.plan(40.0, 40.0)
    assert budget.factor == pytest.approx(60 / 160)
    assert budget.steps(40, stretched=True) == budget.steps(40, stretched=False) == 15


def test_time_that_is_left_goes_to_what_may_be_stretched():
    clock = Clock()
    budget = TimeBudget(1000.0, clock)
    budget.timed(lambda: clock.spend(100.0), 100.0)
    budget.plan(300.0, 200.0)
    assert budget.factor == pytest.approx((900 - 300) / 200)
    assert budget.steps(50, stretched=True) == 150
    assert budget.steps(50, stretched=False) == 50


def test_there_is_always_a_step_and_never_many_times_the_plan():
    clock = Clock()
    budget = TimeBudget(10.0, clock)
    budget.timed(lambda: clock.spend(1.0), 1000.0)
    budget.plan(0.0, 100.0)
    assert budget.steps(100, stretched=True) == 1200
    assert budget.fitting(10, 1e-9, 0.0) == 120
    clock.spend(100.0)
    budget.plan(0.0, 100.0)
    assert budget.steps(100, stretched=True) == 5
    assert budget.steps(1, stretched=True) == 1
    assert budget.fitting(100, 1.0, 0.0) == 5
    assert budget.fitting(3, 1.0, 0.0) == 1


def test_as_many_parts_follow_as_fit_before_the_time_that_is_kept():
    clock = Clock()
    budget = TimeBudget(100.0, clock)
    begin = budget.now()
    clock.spend(20.0)
    assert budget.now() - begin == 20.0
    assert budget.fitting(20, 2.0, 30.0) == 25


def test_a_factor_that_is_held_does_not_look_at_the_clock():
    clock = Clock()
    budget = TimeBudget(10.0, clock)
    budget.hold(2.5)
    budget.timed(lambda: clock.spend(50.0), 1.0)
    budget.plan(10.0, 10.0)
    assert budget.steps(10, stretched=True) == 25
    assert budget.fitting(7, 100.0, 100.0) == 7


def test_a_step_costs_less_with_fewer_splats_but_never_nothing():
    assert TimeBudget.work(10, 1.0) == pytest.approx(10.0)
    assert 0.5 < TimeBudget.work(10, 0.0) < TimeBudget.work(10, 0.5) < 6.0
