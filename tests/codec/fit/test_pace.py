import pytest

from cogsplat.codec.fit.pace import Pace


class Clock:
    now = 100.0

    def __call__(self):
        return self.now

    def spend(self, seconds):
        self.now += seconds


def test_without_a_limit_the_plan_stays():
    pace = Pace(None, Clock())
    pace.timed(lambda: None, 10, 1.0)
    assert pace.steps(150, 0.5, 1e9) == 150


def test_steps_become_fewer_or_more_until_the_time_is_over():
    clock = Clock()
    pace = Pace(100.0, clock)
    assert pace.steps(20, 1.0, 80.0) == 20
    # Two seconds a step: 60 seconds are left for work that would take 160.
    pace.timed(lambda: clock.spend(40.0), 20, 1.0)
    steps = pace.steps(40, 1.0, 40.0)
    assert steps == round(40 * 60 / 160)
    pace.timed(lambda: clock.spend(2.0 * steps), steps, 1.0)
    rest = pace.steps(40, 1.0, 0.0)
    assert clock.now + 2.0 * rest == pytest.approx(200.0, abs=1.0)


def test_there_is_always_a_step_and_never_many_times_the_plan():
    clock = Clock()
    pace = Pace(10.0, clock)
    pace.timed(lambda: clock.spend(1.0), 1000, 1.0)
    assert pace.steps(100, 1.0, 0.0) == 400
    clock.spend(100.0)
    assert pace.steps(100, 1.0, 0.0) == 5
    assert pace.steps(1, 1.0, 0.0) == 1


def test_a_step_costs_less_with_fewer_splats_but_never_nothing():
    assert Pace.work(10, 1.0) == pytest.approx(10.0)
    assert 0.5 < Pace.work(10, 0.0) < Pace.work(10, 0.5) < 6.0
