"""Statistics against plain numpy, and fill ratios that can be counted by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from random_splats import random_splats

from cogsplat.codec.errors import Cancelled
from cogsplat.codec.splats import empty
from cogsplat.tools.evaluation.scene_statistics import BINS, describe, fill_ratio, statistics

floats = st.floats(width=32, allow_nan=True, allow_infinity=True)


@given(arrays.arrays(np.float32, st.integers(0, 60), elements=floats))
def test_finite_values_are_described_and_others_counted(values: np.ndarray) -> None:
    found = describe(values)
    finite = values[np.isfinite(values)].astype(np.float64)
    assert found.count == len(values)
    assert found.num_nan == np.isnan(values).sum()
    assert found.num_infinite == np.isinf(values).sum()
    assert found.histogram.sum() == len(finite)
    if not len(finite):
        assert found.least is found.largest is found.mean is found.std is found.median is None
        assert len(found.edges) == 0
        return
    assert (found.least, found.largest) == (finite.min(), finite.max())
    size = np.abs(finite).max()
    assert found.mean == pytest.approx(finite.mean(), abs=1e-12 * size)
    assert found.std == pytest.approx(finite.std(), rel=1e-9, abs=1e-12 * size)
    assert found.median == pytest.approx(np.median(finite), rel=1e-6, abs=1e-6 * size)
    assert len(found.edges) == BINS + 1
    assert len(found.histogram) == BINS


def test_histogram_is_that_of_numpy_but_for_what_lies_beyond() -> None:
    values = np.random.default_rng(1).normal(size=5000).astype(np.float32)
    values[0] = 1e20
    found = describe(values)
    expected, _ = np.histogram(np.clip(values, found.edges[0], found.edges[-1]), found.edges)
    assert np.abs(found.histogram - expected).max() <= 1
    assert found.edges[-1] < 10


def test_large_inputs_are_summed_in_parts() -> None:
    values = np.random.default_rng(2).normal(3.0, 2.0, size=(1 << 20) + 7).astype(np.float32)
    found = describe(values)
    assert found.std == pytest.approx(values.astype(np.float64).std(), rel=1e-12)
    assert found.histogram.sum() == len(values)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_scene_has_a_row_for_each_component_and_band(degree: int) -> None:
    splats = random_splats(40, (degree + 1) ** 2 - 1)
    found = statistics(splats)
    bands = [f"shN.{band}" for band in range(1, degree + 1)]
    derived = ["opacities_unit", "scales_linear.max", "elongation"]
    assert list(found.values)[-len(bands) - 3 :] == bands + derived
    assert found.values["means.y"].mean == pytest.approx(splats.means[:, 1].mean(), abs=1e-6)
    assert sum(found.values[band].count for band in bands) == splats.shN.size
    assert found.values["opacities_unit"].largest == pytest.approx(
        1 / (1 + math.exp(-splats.opacities.max()))
    )
    assert found.opaque_share == (splats.opacities > 0).mean()
    assert (found.splats, found.sh_degree, found.nbytes) == (40, degree, splats.nbytes)


def test_rows_that_cannot_be_drawn_are_counted() -> None:
    splats = random_splats(10)
    splats.means[2] = np.nan
    splats.scales[3, 1] = np.inf
    splats.quats[4] = 0
    splats.opacities[5] = -np.inf
    found = statistics(splats)
    assert found.num_invalid == 3
    assert found.values["means.x"].num_nan == 1
    assert found.values["scales.1"].num_infinite == 1
    assert found.values["opacities"].num_infinite == 1
    assert found.values["opacities_unit"].least == 0
    assert found.fill_ratio == math.inf


def test_an_empty_array_has_no_figures() -> None:
    found = statistics(empty(1))
    assert (found.opaque_share, found.fill_ratio, found.num_invalid) == (None, None, 0)
    assert all(values.mean is None for values in found.values.values())


def test_fill_ratio_counts_layers() -> None:
    # Flat unit-area ellipses at a cube's corners: 8 of them over a face of about 4.
    corners = np.array([[x, y, z] for x in (0, 2) for y in (0, 2) for z in (0, 2)], np.float32)
    radius = math.log(1 / math.sqrt(math.pi))
    splats = replace(
        empty(0, 8),
        means=corners,
        scales=np.tile(np.array([radius, -20, radius], np.float32), (8, 1)),
    )
    assert fill_ratio(splats) == pytest.approx(8 / 4, rel=1e-6)
    # The figure has no unit.
    grown = replace(splats, means=splats.means * 8, scales=splats.scales + np.float32(math.log(8)))
    assert fill_ratio(grown) == pytest.approx(2, rel=1e-5)


def test_fill_ratio_of_one_place_is_the_number_of_splats() -> None:
    assert fill_ratio(empty(0, 5)) == pytest.approx(5)
    far = replace(empty(0, 1), means=np.full((1, 3), np.nan, np.float32))
    assert fill_ratio(far) is None


def test_progress_may_cancel() -> None:
    def stop(stage: str, done: int, total: int) -> None:
        assert (stage, total) == ("statistics", 20)
        if done == 3:
            raise Cancelled

    with pytest.raises(Cancelled):
        statistics(random_splats(5), stop)
