import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.clustering import kmeans
from cogsplat.codec.clustering.kmeans import TrainingConfig

ROOT = Path(__file__).resolve().parents[3]


def cloud(seed, n=3000, d=6, centres=40):
    rng = np.random.default_rng(seed)
    middle = rng.normal(size=(centres, d)) * 3
    return (middle[rng.integers(0, centres, n)] + 0.3 * rng.normal(size=(n, d))).astype(np.float32)


def brute(vectors, rows):
    wide = np.square(vectors[:, None].astype(np.float64) - rows[None].astype(np.float64))
    distances = wide.sum(axis=2)
    return distances, distances.argmin(axis=1)


def check(rows, vectors, most):
    assert rows.dtype == np.float32
    assert rows.flags.c_contiguous
    assert 1 <= len(rows) <= most
    assert rows.shape[1] == vectors.shape[1]
    assert np.isfinite(rows).all()
    assert len(np.unique(rows, axis=0)) == len(rows)
    _, owners = brute(vectors, rows)
    assert len(np.unique(owners)) == len(rows), "rows that no vector uses"


@pytest.mark.parametrize("rows", [1, 2, 16, 128, 1024])
def test_all_rows_are_used_and_limited(rows):
    vectors = cloud(1)
    out = kmeans.train(vectors, np.ones(len(vectors)), rows)
    check(out, vectors, rows)
    assert len(out) >= 0.99 * rows


def test_all_rows_are_used_under_weights_of_many_magnitudes():
    vectors = cloud(2)
    weights = np.random.default_rng(3).lognormal(0, 4, len(vectors))
    check(kmeans.train(vectors, weights, 200), vectors, 200)


def test_rows_beat_random_vectors():
    vectors = cloud(4)
    out = kmeans.train(vectors, np.ones(len(vectors)), 64)
    drawn = vectors[np.random.default_rng(5).choice(len(vectors), 64, replace=False)]
    assert (
        brute(vectors, out)[0].min(axis=1).sum() < 0.5 * brute(vectors, drawn)[0].min(axis=1).sum()
    )


def test_one_row_is_the_weighted_mean():
    vectors = cloud(6, n=500)
    weights = np.random.default_rng(7).uniform(0.1, 5, 500)
    out = kmeans.train(vectors, weights, 1)
    np.testing.assert_allclose(out[0], np.average(vectors, axis=0, weights=weights), atol=1e-5)


def test_heavy_vectors_get_closer_rows():
    vectors = cloud(8)
    heavy = np.arange(len(vectors)) % 10 == 0
    weights = np.where(heavy, 1e4, 1.0)
    plain = brute(vectors, kmeans.train(vectors, np.ones(len(vectors)), 100))[0].min(axis=1)
    drawn = brute(vectors, kmeans.train(vectors, weights, 100))[0].min(axis=1)
    assert drawn[heavy].sum() < 0.7 * plain[heavy].sum()


def test_weights_count_by_their_ratios_only():
    vectors = cloud(9, n=800)
    weights = np.random.default_rng(10).lognormal(0, 1, 800)
    expected = kmeans.train(vectors, weights, 32)
    for scale in (2.0**-900, 2.0**900):
        np.testing.assert_array_equal(kmeans.train(vectors, weights * scale, 32), expected)


@pytest.mark.parametrize(
    "weights",
    [
        np.zeros(600),
        np.full(600, 1e-60),
        np.full(600, 5e-324),
        np.full(600, 1e300),
        np.append(np.full(599, 1e-320), 1e10),
        np.append(np.full(595, 1e-60), np.ones(5)),
        np.append(np.zeros(590), np.ones(10)),
    ],
)
def test_extreme_weights_are_accepted(weights):
    vectors = cloud(11, n=600)
    check(kmeans.train(vectors, weights, 16), vectors, 16)


def test_vectors_without_weight_have_no_row():
    vectors = np.concatenate([cloud(12, n=600), np.full((600, 6), 100, np.float32)])
    weights = np.repeat([1.0, 0.0], 600)
    assert kmeans.train(vectors, weights, 16).max() < 50


@pytest.mark.parametrize("distinct", [1, 2, 5, 15])
@pytest.mark.parametrize("copies", [1, 200])
def test_fewer_distinct_vectors_than_rows_are_the_rows(distinct, copies):
    vectors = np.repeat(cloud(13, n=distinct), copies, axis=0)
    out = kmeans.train(vectors, np.ones(len(vectors)), 16)
    check(out, vectors, 16)
    np.testing.assert_allclose(out, np.unique(vectors, axis=0), rtol=1e-5, atol=1e-6)


def test_no_vectors_give_no_rows():
    assert kmeans.train(np.zeros((0, 6), np.float32), np.zeros(0), 16).shape == (0, 6)


def test_samples_stand_for_all():
    vectors = cloud(14, n=6000)
    weights = np.random.default_rng(15).lognormal(0, 1, 6000)
    config = TrainingConfig(samples=1000)
    out = kmeans.train(vectors, weights, 40, config)
    check(out, vectors, 40)
    full = kmeans.train(vectors, weights, 40)
    error, best = ((weights * brute(vectors, rows)[0].min(axis=1)).sum() for rows in (out, full))
    assert error < 2 * best
    np.testing.assert_array_equal(kmeans.train(vectors, weights, 40, config), out)


def test_the_seed_decides():
    vectors, weights = cloud(16, n=1000), np.ones(1000)
    a, b = (kmeans.train(vectors, weights, 16, TrainingConfig(seed=seed)) for seed in (1, 2))
    assert not np.array_equal(a, b)


def test_inputs_are_not_modified():
    vectors, weights = cloud(17, n=500), np.full(500, 3.0)
    before = vectors.copy()
    kmeans.train(vectors, weights, 8)
    np.testing.assert_array_equal(vectors, before)
    assert (weights == 3.0).all()


# The nearest row.


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    st.integers(0, 700), st.integers(1, 60), st.sampled_from([1, 6, 45]), st.integers(0, 2**32 - 1)
)
def test_the_nearest_row_is_brute_forces(n, count, d, seed):
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(n, d)).astype(np.float32)
    rows = rng.normal(size=(count, d)).astype(np.float32)
    indices, errors = kmeans.nearest(vectors, rows, 2)
    assert (indices.dtype, errors.dtype) == (np.uint32, np.float64)
    distances, expected = brute(vectors, rows)
    chosen = distances[np.arange(n), indices]
    np.testing.assert_allclose(errors, chosen, rtol=1e-12)
    # float32 may choose either of two rows whose distances agree to seven digits.
    slack = 1e-5 * (1 + np.square(vectors).sum(axis=1) + np.square(rows).sum(axis=1).max())
    assert (chosen <= distances[np.arange(n), expected] + slack).all()
    if n:
        assert (indices == expected).mean() > 0.9 or d == 1


def test_rows_find_themselves():
    rows = cloud(18, n=300, d=45)
    indices, errors = kmeans.nearest(rows, rows)
    assert indices.tolist() == list(range(300))
    assert (errors == 0).all()


def test_the_number_of_threads_changes_no_bit():
    vectors, rows = cloud(19, n=5000, d=45), cloud(20, n=333, d=45)
    expected = kmeans.nearest(vectors, rows, 1)
    for threads in (0, 2, 5):
        actual = kmeans.nearest(vectors, rows, threads)
        assert [a.tobytes() for a in actual] == [e.tobytes() for e in expected]
    with pytest.raises(ValueError, match="-1 threads"):
        kmeans.nearest(vectors, rows, -1)


DIGEST = """
import hashlib, sys
import numpy as np
from cogsplat.codec.clustering import kmeans
rng = np.random.default_rng(0)
vectors = rng.normal(size=(4000, 45)).astype(np.float32)
weights = rng.lognormal(0, 2, 4000)
rows = kmeans.train(vectors, weights, 100)
indices, errors = kmeans.nearest(vectors, rows, int(sys.argv[1]))
print(hashlib.sha256(rows.tobytes() + indices.tobytes() + errors.tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_threads_of_blas_and_openmp_and_hash_seeds_change_no_bit():
    digests = set()
    for threads, seed in ((1, "0"), (2, "77")):
        count = str(threads)
        environment = {
            **os.environ,
            "OMP_NUM_THREADS": count,
            "OPENBLAS_NUM_THREADS": count,
            "MKL_NUM_THREADS": count,
            "PYTHONHASHSEED": seed,
        }
        done = subprocess.run(
            [sys.executable, "-c", DIGEST, count],
            env=environment, cwd=ROOT, capture_output=True, text=True, check=True,
        )  # fmt: skip
        digests.add(done.stdout.strip())
    assert len(digests) == 1
    assert len(digests.pop()) == hashlib.sha256().digest_size * 2
