import itertools

import pytest

from cogsplat.codec.fit.splat_budget import (
    corrected_count,
    count_for_size,
    next_count,
    next_count_for_psnr,
)


@pytest.mark.parametrize(("degree", "count"), [(0, 153), (1, 125), (2, 105), (3, 90)])
def test_a_higher_sh_degree_gives_fewer_splats_for_a_size(degree, count):
    assert count_for_size(1000, degree, 10_000) == count
    assert count_for_size(10_000, degree, 50) == 50
    assert count_for_size(1, degree, 50) == 1


def test_larger_files_spend_more_bytes_per_splat():
    # Of 80,796 splats of degree 3.
    assert count_for_size(129_270, 3, 80_796) == pytest.approx(11_750, abs=20)
    assert count_for_size(307_000, 3, 80_796) == pytest.approx(23_300, rel=0.03)
    counts = [count_for_size(size, 3, 10_000) for size in range(1_000, 300_000, 1_000)]
    assert all(a <= b for a, b in itertools.pairwise(counts))
    assert counts[-1] == 10_000


def test_rounds_end_at_the_final_count():
    counts = [1000]
    while (count := next_count(counts[-1], 300, 0.7)) is not None:
        counts.append(count)
    assert counts == [1000, 700, 489, 342, 300]


def test_rounds_end_when_the_psnr_allows_no_more():
    far = next_count_for_psnr(1000, 45.0, 35.0, 0.8)
    near = next_count_for_psnr(1000, 35.5, 35.0, 0.8)
    assert (far, near) == (800, 900)
    assert next_count_for_psnr(1000, 35.0, 35.0, 0.8) is None
    assert next_count_for_psnr(1, 45.0, 35.0, 0.8) is None


def test_counts_are_corrected_by_the_psnr_per_halving():
    # Storing costs 2 dB; 4 dB beyond that correspond to half of the splats.
    assert corrected_count(1000, 41.0, 35.0, 5000) == 500
    assert corrected_count(1000, 33.0, 35.0, 5000) == 2000
    assert corrected_count(1000, 33.0, 35.0, 1500) == 1500
    assert corrected_count(1000, 37.0, 35.0, 5000) is None
    # A small deficit is accepted, and so is the maximum count.
    assert corrected_count(1000, 36.0, 35.0, 5000) is None
    assert corrected_count(1000, 35.7, 35.0, 5000) == 1253
    assert corrected_count(1000, 33.0, 35.0, 1000) is None
