import numpy as np
import pytest

from cogsplat.codec.encode.prefix_sampling import choose_prefixes, interpolate_prefixes


@pytest.mark.parametrize("chunks", range(9))
def test_few_prefixes_are_all_measured(chunks):
    counts = [1 + 100 * (k % 3) for k in range(chunks)]
    assert choose_prefixes(counts, 8).tolist() == list(range(1, chunks + 1))


@pytest.mark.parametrize("most", [2, 3, 8, 10])
@pytest.mark.parametrize("chunks", [11, 40, 70, 2000])
def test_of_many_the_first_the_whole_and_some_between_are_measured(most, chunks):
    counts = np.random.default_rng(chunks).integers(1, 16384, chunks)
    found = choose_prefixes(counts, most)
    assert len(found) <= most
    assert (np.diff(found) > 0).all()
    assert found[0] == 1
    assert found[-1] == chunks


def test_prefixes_are_closer_where_they_are_short():
    counts = [1000] * 1000
    found = choose_prefixes(counts, 8)
    assert (np.diff(np.diff(found)) >= 0).all()
    # All of them together take little longer to draw than three times the whole.
    assert found.sum() < 3.3 * len(counts)


def test_what_was_measured_stays_and_the_rest_lies_between():
    counts = [1024, 1536, 2304, 3456, 5184] + [16384] * 20
    measured = choose_prefixes(counts, 6)
    values = np.linspace(12.0, 40.0, len(measured))
    found = interpolate_prefixes(counts, measured, values)
    assert len(found) == len(counts)
    np.testing.assert_allclose(found[measured - 1], values)
    assert (np.diff(found) > 0).all()


def test_a_curve_that_rises_with_the_logarithm_is_met():
    counts = [1000] * 300
    curve = 3.0 * np.log(np.cumsum(counts))
    measured = choose_prefixes(counts, 4)
    np.testing.assert_allclose(interpolate_prefixes(counts, measured, curve[measured - 1]), curve)


def test_without_chunks_there_is_nothing():
    assert interpolate_prefixes([], choose_prefixes([], 8), np.zeros(0)).tolist() == []
