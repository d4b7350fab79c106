import pytest

from cogsplat.codec import progress
from cogsplat.codec.errors import Cancelled
from cogsplat.codec.progress import OverallProgress, StageCost, TimedProgress


@pytest.fixture
def clock(monkeypatch):
    now = [50.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    # One and a half cores are busy.
    monkeypatch.setattr(progress.time, "process_time", lambda: 1.5 * now[0])
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
    assert timed.cpu_seconds == {"score": 28.5, "order": 6.0}
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


def test_the_whole_is_the_sum_of_its_stages():
    shares, calls = [], []
    costs = [StageCost("score", 0.1, 10), StageCost("chunks", 2.0), StageCost("write", 1.0)]
    whole = OverallProgress(costs, lambda *call: calls.append(call), shares.append)
    reports = [("score", 5, 10), ("other", 1, 2), ("score", 10, 10), ("chunks", 1, 4)]
    for report in [*reports, ("write", 1, 1)]:
        whole(*report)
    assert calls[:4] == reports
    assert shares == pytest.approx([0.125, 0.125, 0.25, 0.375, 1.0])


def test_a_stage_larger_than_expected_slows_the_share_and_turns_nothing_back():
    whole = OverallProgress([StageCost("score", 1.0, 10), StageCost("predict", 1.0, 10)])
    whole("score", 10, 10)
    assert whole.share == 0.5
    whole("predict", 0, 90)
    assert whole.share == 0.5
    whole("predict", 45, 90)
    assert whole.share == pytest.approx(0.75)
    whole("predict", 90, 90)
    assert whole.share == 1.0


def test_stages_that_are_left_out_are_over_once_a_later_one_begins():
    whole = OverallProgress([StageCost("gain", 3.0), StageCost("chunks", 1.0)])
    whole("chunks", 0, 2)
    assert whole.share == 0.75
    whole("gain", 0, 1)
    whole("chunks", 2, 2)
    assert whole.share == 1.0


def test_a_search_comes_nearer_to_its_end_with_each_trial():
    costs = [StageCost("search", 4.0, inner="chunks"), StageCost("write", 1.0)]
    shares = []
    whole = OverallProgress(costs, overall=shares.append)
    whole("search", 0, 8)
    for trial in range(1, 6):
        whole("chunks", 0, 2)
        whole("chunks", 2, 2)
        whole("search", trial, 8)
    assert shares == sorted(shares)
    assert 0.7 < shares[-1] < 0.8
    whole("search", 8, 8)
    assert whole.share == pytest.approx(0.8)


def test_what_the_receiver_of_the_share_raises_stops_the_work():
    def stop(share):
        raise Cancelled

    with pytest.raises(Cancelled):
        OverallProgress([StageCost("score", 1.0)], overall=stop)("score", 0, 1)


def test_a_stage_may_go_through_stages_of_its_own_at_each_step():
    encode = (StageCost("chunks", 3.0), StageCost("measure", 1.0))
    files = StageCost("files", 0.0, parts=(encode, (StageCost("measure", 4.0),), encode))
    assert files.total() == 12.0
    shares = []
    whole = OverallProgress(
        [StageCost("measure", 4.0), files, StageCost("write", 4.0)], overall=shares.append
    )
    reports = [
        ("measure", 1, 1, 0.2),
        ("files", 0, 3, 0.2),
        ("chunks", 1, 3, 0.25),
        ("chunks", 3, 3, 0.35),
        ("measure", 1, 2, 0.375),
        ("other", 1, 1, 0.375),
        ("files", 1, 3, 0.4),
        ("chunks", 3, 3, 0.4),
        ("measure", 1, 4, 0.45),
        # The second file is refused half-way, and the third begins.
        ("files", 2, 3, 0.6),
        ("measure", 2, 2, 0.8),
        ("files", 3, 3, 0.8),
        ("write", 1, 2, 0.9),
        ("write", 2, 2, 1.0),
    ]
    for stage, done, total, share in reports:
        whole(stage, done, total)
        assert whole.share == pytest.approx(share), (stage, done)
    assert shares == sorted(shares)


def test_steps_beyond_those_expected_turn_nothing_back():
    files = StageCost("files", 0.0, parts=((StageCost("measure", 4.0),),))
    whole = OverallProgress([files, StageCost("write", 4.0)])
    for done in range(3):
        whole("files", done, 3)
        whole("measure", 1, 1)
        assert whole.share == 0.5
    whole("files", 3, 3)
    whole("write", 1, 1)
    assert whole.share == 1.0
