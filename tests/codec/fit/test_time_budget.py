import warnings

import pytest

from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.fit.time_budget import TimeBudget


class Clock:
    now = 100.0

    def __call__(self):
        return self.now

    def spend(self, seconds):
        self.now += seconds


def test_without_a_deadline_plans_do_not_change():
    budget = TimeBudget(None, Clock())
    budget.run_timed(lambda: None, 10.0)
    budget.fit_to_deadline(5.0, 1e9)
    assert budget.scaled_steps(150, extend=True) == budget.scaled_steps(150, extend=False) == 150
    assert budget.affordable_count(40, 1e9, 1e9) == 40


def test_before_any_measurement_plans_do_not_change():
    budget = TimeBudget(10.0, Clock())
    budget.fit_to_deadline(1e9, 1e9)
    assert budget.factor == 1.0


def test_steps_are_reduced_to_meet_the_deadline():
    clock = Clock()
    budget = TimeBudget(100.0, clock)
    # 2 s per unit of work: 60 s remain for work of 160 s.
    budget.run_timed(lambda: clock.spend(40.0), 20.0)
    budget.fit_to_deadline(40.0, 40.0)
    assert budget.factor == pytest.approx(60 / 160)
    assert budget.scaled_steps(40, extend=True) == budget.scaled_steps(40, extend=False) == 15


def test_spare_time_extends_scalable_work_only():
    clock = Clock()
    budget = TimeBudget(1000.0, clock)
    budget.run_timed(lambda: clock.spend(100.0), 100.0)
    budget.fit_to_deadline(300.0, 200.0)
    assert budget.factor == pytest.approx((900 - 300) / 200)
    assert budget.scaled_steps(50, extend=True) == 150
    assert budget.scaled_steps(50, extend=False) == 50


def test_the_factor_has_bounds():
    clock = Clock()
    budget = TimeBudget(10.0, clock)
    budget.run_timed(lambda: clock.spend(1.0), 1000.0)
    budget.fit_to_deadline(0.0, 100.0)
    assert budget.scaled_steps(100, extend=True) == 1200
    assert budget.affordable_count(10, 1e-9, 0.0) == 120
    clock.spend(100.0)
    with pytest.warns(CogsplatWarning):
        budget.fit_to_deadline(0.0, 100.0)
    assert budget.scaled_steps(100, extend=True) == 5
    assert budget.scaled_steps(1, extend=True) == 1
    assert budget.affordable_count(100, 1.0, 0.0) == 5
    assert budget.affordable_count(3, 1.0, 0.0) == 1


def test_repetitions_keep_within_a_share_of_the_limit():
    clock = Clock()
    budget = TimeBudget(100.0, clock)
    clock.spend(90.0)
    # A share of the whole limit, not of the time that is left.
    assert budget.count_within(0.2, 2.0, 50) == 10
    assert budget.count_within(0.2, 0.1, 50) == budget.count_within(0.2, 0.0, 50) == 50
    assert budget.count_within(0.2, 1000.0, 50) == 1
    assert TimeBudget(None, clock).count_within(0.2, 1000.0, 50) == 50


def test_repetitions_leave_the_reserved_time():
    clock = Clock()
    budget = TimeBudget(100.0, clock)
    begin = budget.now()
    clock.spend(20.0)
    assert budget.now() - begin == 20.0
    assert budget.affordable_count(20, 2.0, 30.0) == 25
    assert budget.affordable_count(20, 2.0, 30.0, extra=3) == 22
    # What follows gets a fifth at most.
    assert budget.affordable_count(20, 2.0, 30.0, extra=8) == 20


def test_repetitions_made_count_in_a_new_plan():
    clock = Clock()
    budget = TimeBudget(100.0, clock)
    assert budget.affordable_count(20, 2.0, 30.0, extra=3) == 32
    clock.spend(40.0)
    # 20 repetitions in 40 s keep to the plan.
    assert budget.affordable_count(20, 2.0, 30.0, extra=3, done=20) == 32
    # At half the speed, fewer remain; when the time is over, none.
    assert budget.affordable_count(20, 4.0, 30.0, extra=3, done=10) == 14
    clock.spend(40.0)
    assert budget.affordable_count(20, 4.0, 30.0, extra=3, done=15) == 15


def test_a_fixed_factor_ignores_the_clock():
    clock = Clock()
    budget = TimeBudget(10.0, clock)
    budget.fix_factor(2.5)
    budget.run_timed(lambda: clock.spend(50.0), 1.0)
    budget.fit_to_deadline(10.0, 10.0)
    assert budget.scaled_steps(10, extend=True) == 25
    assert budget.affordable_count(7, 100.0, 100.0) == 7


def test_a_step_has_a_fixed_cost_and_one_per_splat():
    assert TimeBudget.work(10, 1.0) == pytest.approx(10.0)
    # Measured with 40 and 10 % of the splats of two scenes.
    assert TimeBudget.work(10, 0.4) == pytest.approx(4.5, abs=0.2)
    assert TimeBudget.work(10, 0.1) == pytest.approx(2.1, abs=0.2)


def test_time_is_left_for_what_is_no_step():
    clock = Clock()
    budget = TimeBudget(100.0, clock)
    assert budget.needs_measurement
    budget.run_timed(lambda: clock.spend(40.0), 20.0)
    assert not budget.needs_measurement
    budget.fit_to_deadline(40.0, 40.0, 20.0)
    assert budget.factor == pytest.approx(40 / 160)


def test_a_limit_that_cannot_be_met_is_told_once_with_the_time_that_is_needed():
    clock = Clock()
    budget = TimeBudget(10.0, clock)
    budget.run_timed(lambda: clock.spend(8.0), 4.0)
    # 2 s remain; 5 % of 1000 units take 100 s, and 12 s are reserved.
    with pytest.warns(CogsplatWarning, match="limit of 10 s, expected about 120 s or more"):
        budget.fit_to_deadline(600.0, 400.0, 12.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        budget.fit_to_deadline(600.0, 400.0, 12.0)


def test_time_remains_until_the_reserve_is_reached():
    clock = Clock()
    budget = TimeBudget(100.0, clock)
    clock.now += 70.0
    assert budget.has_time(20.0)
    assert not budget.has_time(40.0)
    assert TimeBudget(None, clock).has_time(1e9)
