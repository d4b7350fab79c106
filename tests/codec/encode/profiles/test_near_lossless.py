import math
from dataclasses import replace

import decoding
import numpy as np
import oracle
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.encode.profiles.near_lossless import (
    NearLosslessBounds,
    encode_chunk,
    means_bound_of,
)
from cogsplat.codec.splats import empty
from cogsplat.codec.streams import records
from cogsplat.codec.streams.records import Attribute, Kind

# What decoding may add to a measured difference: nothing but this comparison's own rounding.
EXACT = 1 + 1e-9


def quat_error(source, decoded):
    """Largest difference of components, of either sign, from the exact unit quaternion."""
    wide = source.astype(np.float64)
    wide /= np.abs(wide).max(axis=1, keepdims=True)
    wide /= np.linalg.norm(wide, axis=1, keepdims=True)
    plus, minus = (np.abs(decoded - sign * wide).max(axis=1) for sign in (1, -1))
    return np.minimum(plus, minus).max(initial=0)


def check(splats, bounds=None, step=None):
    """Encode one chunk in the given order and compare every attribute with its bound."""
    bounds = bounds or NearLosslessBounds()
    step = means_bound_of(splats.scales, bounds) if step is None else step
    payloads = encode_chunk(splats, step, bounds, False)
    assert (payloads.head_needs, payloads.tail_needs) == ((), ())
    assert (payloads.tail is None) == (splats.sh_degree == 0)
    out = decoding.chunk(payloads, len(splats), splats.sh_degree)
    for name, bound in (
        ("means", step),
        ("scales", bounds.scales),
        ("sh0", bounds.sh0),
        ("shN", bounds.shN),
    ):
        wide = getattr(out, name).astype(np.float64) - getattr(splats, name)
        assert np.abs(wide).max(initial=0) <= bound * EXACT, name
    infinite = np.isinf(splats.opacities)
    np.testing.assert_array_equal(out.opacities[infinite], splats.opacities[infinite])
    wide = out.opacities[~infinite].astype(np.float64) - splats.opacities[~infinite]
    assert np.abs(wide).max(initial=0) <= bounds.opacities * EXACT
    assert quat_error(splats.quats, out.quats) <= bounds.quats
    assert (out.quats[:, 0] >= 0).all()
    return payloads, out


def kinds(payload):
    return {s.attribute: s.kind for s in records.unpack(memoryview(payload), "chunk", 1 << 18)}


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("n", [1, 2, 300])
def test_every_value_stays_within_its_bound(degree, n):
    check(oracle.scene(degree, n=n, degree=degree))


value = st.one_of(
    st.floats(-5, 5, width=32),
    st.floats(-(2.0**99), 2.0**99, width=32),
    st.sampled_from([0.0, -0.0, 1e-45, -1e-38, 1e7, -1e30]),
)
bound = st.floats(1e-7, 1.0)


@pytest.mark.slow
@settings(derandomize=True, deadline=None, max_examples=80)
@given(
    st.data(),
    st.integers(1, 6),
    st.tuples(bound, bound, st.floats(1e-6, 1.0), bound, bound, bound),
)
def test_every_value_stays_within_any_bound(data, n, limits):
    def draw(*shape):
        size = math.prod(shape)
        row = data.draw(st.lists(value, min_size=size, max_size=size))
        return np.array(row, np.float32).reshape(shape)

    quats = draw(n, 4)
    quats[~quats.any(axis=1)] = 1
    splats = replace(
        empty(1, n),
        means=draw(n, 3), scales=draw(n, 3), quats=quats, opacities=draw(n),
        sh0=draw(n, 3), shN=draw(n, 3, 3),
    )  # fmt: skip
    infinite = data.draw(st.lists(st.sampled_from([0, 0, 1, -1]), min_size=n, max_size=n))
    splats.opacities[np.array(infinite) == 1] = np.inf
    splats.opacities[np.array(infinite) == -1] = -np.inf
    check(splats, NearLosslessBounds(*limits), step=limits[0])


@pytest.mark.parametrize("quats", [1.0, 0.3, 0.1, 0.01, 1e-4, 1e-5, 1e-6])
def test_rotations_stay_within_coarse_and_fine_bounds(quats):
    rng = np.random.default_rng(1)
    splats = empty(0, 4000)
    splats.quats[:] = rng.normal(size=(4000, 4))
    # Where the error of the component that is left out is at its worst: all four nearly equal.
    splats.quats[:1000] = rng.choice([-1, 1], (1000, 4)) * rng.uniform(0.9, 1, (1000, 4))
    splats.quats[1000:1100, 0] = 0
    splats.quats[1100:1200, 0] = 1e-9
    check(splats, NearLosslessBounds(quats=quats))


def test_huge_coordinates_of_tiny_splats_are_kept_as_they_are():
    splats = oracle.scene(2, n=100, degree=0)
    splats.means[:] = splats.means * 3 + np.float32(1e7)
    splats.scales[:] = -9
    _, out = check(splats)
    assert out.means.tobytes() == splats.means.tobytes()


def test_scenes_too_wide_for_any_grid_are_kept_as_they_are():
    splats = oracle.scene(3, n=100, degree=0)
    splats.means[0] = [1e7, -1e7, 3]
    payloads, out = check(splats)
    assert kinds(payloads.head)[Attribute.MEANS] == Kind.FLOAT
    assert out.means.tobytes() == splats.means.tobytes()


def test_stray_values_of_one_attribute_cost_that_attribute_only():
    splats = oracle.scene(4, n=100, degree=1)
    splats.shN[7, 1, 2] = 1e20
    payloads, _ = check(splats)
    assert kinds(payloads.tail) == {Attribute.SH1: Kind.FLOAT}
    assert Kind.FLOAT not in kinds(payloads.head).values()


@pytest.mark.parametrize("sort", [True, False])
def test_what_is_constant_costs_no_plane(sort):
    splats = empty(3, 500)
    splats.means[:] = [1.5, 1e7, -3]
    splats.sh0[:] = 0.3
    payloads = encode_chunk(splats, 1e-3, NearLosslessBounds(), sort)
    out = decoding.chunk(payloads, 500, 3)
    assert out.means.tobytes() == splats.means.tobytes()
    assert out.sh0.tobytes() == splats.sh0.tobytes()
    for payload in (payloads.head, payloads.tail):
        for stream in records.unpack(memoryview(payload), "chunk", 500):
            assert len(stream.words) == (3 if stream.kind == Kind.SORTED else 0)


@pytest.mark.parametrize("logits", [[np.inf], [-np.inf], [np.inf, -np.inf], [0.5, np.inf, -12.25]])
def test_infinite_opacities_are_exact(logits):
    splats = empty(0, len(logits))
    splats.opacities[:] = logits
    payloads, _ = check(splats)
    assert kinds(payloads.head)[Attribute.OPACITIES] == Kind.SCALAR


def test_infinite_opacities_beside_stray_ones_are_exact():
    for stray in ([1e25, 0.25, 0.5], [1e25, 0.25]):
        splats = empty(0, 2 + len(stray))
        splats.opacities[:] = [np.inf, *stray, -np.inf]
        payloads, out = check(splats)
        assert kinds(payloads.head)[Attribute.OPACITIES] == Kind.FLOAT
        assert out.opacities.tobytes() == splats.opacities.tobytes()


def test_sorting_moves_rows_whole():
    splats = oracle.scene(5, n=200)
    # A tag per row, steps far above the bound.
    splats.sh0[:, 0] = np.arange(200) / 10
    bounds = NearLosslessBounds()
    plain, ordered = (
        decoding.chunk(encode_chunk(splats, 0.01, bounds, sort), 200, 3) for sort in (False, True)
    )
    rows = np.rint(ordered.sh0[:, 0] * 10).astype(int)
    assert sorted(rows) == list(range(200))
    assert rows.tolist() != list(range(200))
    for name in ("means", "scales", "quats", "opacities", "sh0", "shN"):
        assert getattr(ordered, name).tobytes() == getattr(plain, name)[rows].tobytes(), name


def test_the_bound_of_means_is_relative_to_the_median_size():
    splats = empty(0, 3)
    splats.scales[:] = np.log([[1, 1, 1], [0.5, 0.5, 0.5], [8, 8, 0.5]])
    assert means_bound_of(splats.scales, NearLosslessBounds(means=0.02)) == pytest.approx(0.02)
    assert means_bound_of(empty(0).scales, NearLosslessBounds(means=0.02)) == 0.02


@pytest.mark.parametrize("name", ["means", "scales", "quats", "opacities", "sh0", "shN"])
@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan")])
def test_bounds_that_nothing_meets_are_refused(name, limit):
    message = f"bound {name} {limit}, expected more than 0"
    if math.isnan(limit):
        message = f"{name} nan, expected a finite number"
    with pytest.raises(ValueError, match=f"^{message}$"):
        NearLosslessBounds(**{name: limit})


def test_rotations_finer_than_float32_are_refused():
    with pytest.raises(ValueError, match="expected at least 1e-06"):
        NearLosslessBounds(quats=9e-7)
