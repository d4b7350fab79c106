import pytest

from cogsplat.formats.network.network_options import NetworkOptions


def test_defaults_are_those_of_the_specification():
    options = NetworkOptions()
    assert (options.gap_bytes, options.request_bytes, options.in_flight) == (1 << 16, 1 << 22, 6)


@pytest.mark.parametrize(
    "wrong",
    [
        {"retries": -1},
        {"gap_bytes": -1},
        {"in_flight": 0},
        {"idle_seconds": 0.0},
        {"idle_seconds": float("nan")},
        {"longest_wait_seconds": float("nan")},
        {"connect_seconds": float("inf")},
        {"unstated_bytes": 0},
        {"headers": {"a": "b\r\nc: d"}},
    ],
)
def test_what_cannot_be_is_misuse(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong)).rstrip("s")):
        NetworkOptions(**wrong)
