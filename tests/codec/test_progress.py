import pytest

from cogsplat.codec import progress
from cogsplat.codec.errors import Cancelled
from cogsplat.codec.progress import TimedProgress


@pytest.fixture
def clock(monkeypatch):
    now = [50.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_seconds_belong_to_the_stage_that_reports_second(clock):
    calls = []
    timed = TimedProgress(lambda *call: calls.append(call))
    for wait, call in ((1, ("score", 0, 2)), (2, ("score", 2, 2)), (4, ("order", 1, 1))):
        clock[0] += wait
        timed(*call)
    clock[0] += 8
    timed.restart()
    clock[0] += 16
    timed("score", 3, 3)
    assert timed.seconds == {"score": 19.0, "order": 4.0}
    assert list(timed.seconds) == ["score", "order"]
    assert timed.totals == {"score": 3, "order": 1}
    assert calls == [("score", 0, 2), ("score", 2, 2), ("order", 1, 1), ("score", 3, 3)]


def test_what_stops_the_work_is_passed_on(clock):
    def stop(*call):
        raise Cancelled

    timed = TimedProgress(stop)
    with pytest.raises(Cancelled):
        timed("score", 0, 1)
    assert timed.totals == {"score": 1}
