import pytest

from cogsplat.codec.order.gain_effort import GainEffort

RANGES = "expected ordered_ratio above 0, growth above 0 and at least 1 view$"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"ordered_ratio": 0.0}, RANGES),
        ({"growth": 0.0}, RANGES),
        ({"views": 0}, RANGES),
        ({"ordered_ratio": float("nan")}, "^ordered_ratio nan, expected a finite number$"),
    ],
)
def test_an_effort_that_would_never_end_or_look_at_nothing_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        GainEffort(**wrong)


def test_more_than_the_effective_splats_may_be_ordered_by_gain():
    assert GainEffort(ordered_ratio=2.0, growth=5.0, views=1).ordered_ratio == 2.0
