import pytest

from cogsplat.codec.order.gain_effort import GainEffort


@pytest.mark.parametrize(
    "wrong",
    [{"until": 0.0}, {"until": 1.1}, {"growth": 0.0}, {"views": 0}, {"until": float("nan")}],
)
def test_an_effort_that_would_never_end_or_look_at_nothing_is_refused(wrong):
    with pytest.raises(ValueError, match="until"):
        GainEffort(**wrong)


def test_all_of_a_scene_may_be_ordered_by_gain():
    assert GainEffort(until=1.0, growth=5.0, views=1).until == 1.0
