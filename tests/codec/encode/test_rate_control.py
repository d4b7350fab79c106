from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import oracle
import pytest

from cogsplat.codec.encode import config
from cogsplat.codec.encode.config import EncodeConfig, Target
from cogsplat.codec.encode.encoder import encode_chunks
from cogsplat.codec.encode.prepared import prepare
from cogsplat.codec.encode.quality_prediction import PrefixEvaluator
from cogsplat.codec.encode.rate_control import (
    MAX_ROUNDS,
    MAX_TRIALS,
    NOMINAL_TOLERANCE_DB,
    NOMINAL_TRIALS,
    search_finished_size,
    search_nominal,
    search_psnr,
    search_size,
)
from cogsplat.codec.errors import Cancelled, DataError
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.score_config import ScoreConfig


@pytest.fixture(scope="module")
def scene():
    return oracle.scene(1, n=400)


@pytest.fixture(scope="module")
def views():
    return [oracle.camera(0.3 * k) for k in range(4)]


@pytest.fixture(scope="module")
def prepared(scene, views):
    scores = score(scene, views, ScoreConfig(sensitivity_every=1))
    return prepare(scene, scores, EncodeConfig(order="contribution", prune=None))


def payload_bytes(encoded):
    parts = [payload for book in encoded.codebooks for payload in book.payloads]
    for chunk in encoded.chunks:
        parts += [chunk.payloads.head, chunk.payloads.tail or b""]
    return sum(len(part) for part in parts)


class Curve:
    """An encoder of which only the quality matters: what is measured is any function of it."""

    def __init__(self, function):
        self.function, self.tried = function, []

    def __call__(self, quality_db):
        self.tried.append(quality_db)
        return self.function(quality_db)


def itself(value):
    return value


def psnr_hit(curve, goal):
    return search_psnr(curve, goal, itself)


def test_a_psnr_is_found_beside_a_finer_setting_that_gives_less():
    # Seen of a scene of 2,000 splats: between 30.8 and 31.0 a codebook takes fewer rows.
    curve = Curve(
        lambda q: float(
            np.interp(
                q, [0, 30.492, 30.771, 30.965, 34.0, 90], [0, 33.562, 34.388, 34.306, 36.807, 80]
            )
        )
    )
    assert abs(psnr_hit(curve, 34.0).value - 34.0) <= 0.05


@pytest.mark.parametrize("goal", [25.0, 33.3, 40.0, 52.0])
@pytest.mark.parametrize(
    "function",
    [
        lambda q: q,
        lambda q: 0.7 * q + 9,
        lambda q: 60 - 80 * np.exp(-q / 25),
        lambda q: q + 0.3 * np.sin(3 * q),
        lambda q: q + (0.4 if q > 36 else 0.0) - 0.02,
    ],
)
def test_a_psnr_is_found_on_curves_of_any_kind(function, goal):
    curve = Curve(function)
    hit = psnr_hit(curve, goal)
    assert hit.trials == len(curve.tried) <= MAX_TRIALS
    assert abs(hit.value - goal) <= 0.1
    assert function(hit.quality_db) == hit.value == hit.encoded


@pytest.mark.parametrize(
    ("function", "most"),
    [
        (lambda q: q + 0.9, 1),
        (lambda q: q + 9.5, 3),
        (lambda q: 0.8 * q - 6.0, 3),
        # Seen of a lamp of 6,000 splats without cameras.
        (lambda q: float(np.interp(q, [0, 26.88, 31.46, 40], [10, 34.37, 43.23, 50.49])), 4),
    ],
)
def test_a_nominal_quality_is_what_is_measured(function, most):
    curve = Curve(function)
    hit = search_nominal(curve, 40.0, itself)
    assert abs(hit.value - 40.0) <= NOMINAL_TOLERANCE_DB
    assert curve.tried[0] == hit.quality_db == 40.0
    assert hit.trials == len(curve.tried) <= most


def test_a_nominal_quality_out_of_reach_is_no_error():
    hit = search_nominal(Curve(lambda q: 60.0), 40.0, itself)
    assert hit.value == hit.encoded == 60.0
    assert hit.trials <= NOMINAL_TRIALS + 1


def test_the_nearest_of_several_qualities_is_encoded_again():
    curve = Curve(lambda q: {0: 44.0, 1: 20.0}.get(len(curve.tried) - 1, 42.0 if q > 36 else 30.0))
    hit = search_nominal(curve, 40.0, itself)
    assert hit.value == 42.0
    assert hit.trials == len(curve.tried)


@pytest.mark.parametrize("each", [3, 6.2, 12, 40])
@pytest.mark.parametrize("overhead", [0, 1500])
def test_a_size_is_found_and_never_exceeded(each, overhead):
    rows = 50_000
    curve = Curve(lambda q: int(rows * 6 * 2 ** ((q - 36) / 11.0)) + overhead)
    size = each * rows
    hit = search_size(curve, rows, size, itself)
    assert 0.99 * size <= hit.encoded <= size
    assert hit.trials == len(curve.tried) <= 6


def test_a_size_that_jumps_stays_below():
    curve = Curve(lambda q: 1000 if q < 41.7 else 5000)
    assert search_size(curve, 500, 3000, itself).encoded == 1000


@dataclass(frozen=True)
class Sized:
    """An encoded scene of so many bytes; finished, it has a number of its own in `prefix_mse`."""

    size: int
    prefix_mse: int | None = None


class Finishing:
    """Finishes scenes, each time adding so many bytes more than was foreseen."""

    def __init__(self, added):
        self.added, self.finished = added, 0

    def __call__(self, encoded):
        self.finished += 1
        return replace(encoded, prefix_mse=self.finished)

    def size_of(self, encoded):
        return encoded.size + (self.added(encoded.prefix_mse) if encoded.prefix_mse else 0)


def finished_hit(curve, finishing, size):
    return search_finished_size(curve, 1000, size, lambda s: s.size, finishing, finishing.size_of)


@pytest.mark.parametrize("added", [-40, 0, 250])
def test_a_finished_scene_is_no_larger_than_the_target(added):
    curve = Curve(lambda q: Sized(int(2000 * 2 ** (q / 12))))
    finishing = Finishing(lambda count: added)
    hit = finished_hit(curve, finishing, 20_000)
    assert hit.value == finishing.size_of(hit.encoded) <= 20_000
    assert hit.value >= 0.98 * 20_000
    assert hit.encoded.prefix_mse == finishing.finished == (1 if added < 250 else 2)
    assert hit.trials == len(curve.tried)


def test_a_finished_scene_that_always_grows_keeps_the_order_that_was_measured():
    curve = Curve(lambda q: Sized(int(2000 * 2 ** (q / 12))))
    finishing = Finishing(lambda count: 4000 * count)
    hit = finished_hit(curve, finishing, 20_000)
    assert finishing.finished == MAX_ROUNDS
    assert hit.encoded.prefix_mse is None
    assert hit.value <= 20_000
    assert len(curve.tried) == hit.trials <= MAX_ROUNDS * MAX_TRIALS


def test_what_is_added_may_leave_no_room():
    finishing = Finishing(lambda count: 30_000)
    with pytest.raises(DataError) as caught:
        finished_hit(Curve(lambda q: Sized(int(100 * q))), finishing, 5000)
    assert caught.value.code == "target-out-of-reach"


def test_what_cannot_be_reached_is_said():
    with pytest.raises(DataError, match=r"finest setting shows 31\.00 dB.*near-lossless") as caught:
        psnr_hit(Curve(lambda q: min(q, 31.0)), 40.0)
    assert caught.value.code == "target-out-of-reach"
    with pytest.raises(
        DataError, match=r"coarsest setting shows 45\.00 dB.*fewer splats"
    ) as caught:
        psnr_hit(Curve(lambda q: max(q, 45.0)), 40.0)
    assert caught.value.code == "target-out-of-reach"
    with pytest.raises(DataError, match="about 302 splats would fit") as caught:
        search_size(Curve(lambda q: 5000 + 10 * int(q - 20)), 1000, 2000, itself)
    assert caught.value.code == "target-out-of-reach"


def test_a_size_is_found_on_a_bent_curve():
    # Seen of a scene of 400 splats: interpolation alone stays above the target.
    curve = Curve(
        lambda q: int(
            np.interp(
                q,
                [28, 33, 34, 34.5, 36, 38, 39.3, 40.5, 46.7, 60],
                [5043, 6229, 6817, 7893, 8592, 9607, 10309, 10408, 15172, 22422],
            )
        )
    )
    hit = search_size(curve, 400, 10_201, itself)
    assert 0.95 * 10_201 < hit.value <= 10_201


def test_more_room_than_a_scene_needs_gives_the_finest():
    hit = search_size(Curve(lambda q: int(100 * q)), 1000, 10**9, itself)
    assert hit.quality_db == 90.0


def test_real_scenes_hit_their_targets(prepared, scene, views):
    evaluator = PrefixEvaluator(scene, views)
    encode_at = partial(encode_chunks, prepared)
    hit = search_psnr(encode_at, 34.0, lambda trial: evaluator.psnr_db(trial.decoded))
    assert evaluator.psnr_db(hit.encoded.decoded) == hit.value
    # In small views of few splats one splat's step is a jump of the curve.
    assert abs(hit.value - 34.0) <= 1.0
    size = payload_bytes(hit.encoded)
    again = search_size(encode_at, len(prepared.rows), size + 300, payload_bytes)
    assert 0.9 * (size + 300) <= payload_bytes(again.encoded) <= size + 300
    assert again.quality_db >= hit.quality_db - 0.1


def test_progress_ends_and_cancels():
    calls = []
    search_psnr(Curve(lambda q: q), 40.0, lambda v: v, progress=lambda *call: calls.append(call))
    assert calls[0] == ("search", 0, MAX_TRIALS)
    assert calls[-1] == ("search", MAX_TRIALS, MAX_TRIALS)

    def stop(*call):
        raise Cancelled

    with pytest.raises(Cancelled):
        search_psnr(Curve(lambda q: q), 40.0, lambda value: value, progress=stop)


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"psnr_db": 40.0, "size_bytes": 1000},
        {"psnr_db": float("nan")},
        {"psnr_db": 4.0},
        {"psnr_db": 91.0},
        {"size_bytes": 0},
    ],
)
def test_targets_are_one_thing_in_reach(fields):
    with pytest.raises(ValueError, match="expected"):
        Target(**fields)


def test_a_search_never_leaves_the_range_of_qualities(prepared):
    curve = Curve(lambda q: 20 + 0.01 * q)
    with pytest.raises(DataError):
        psnr_hit(curve, 60.0)
    assert all(10 <= q <= 90 for q in curve.tried)
    assert len(set(curve.tried)) == len(curve.tried)
    with pytest.raises(ValueError, match="expected"):
        encode_chunks(prepared, config.MAX_QUALITY_DB + 1)
    assert replace(prepared.config, quality_db=90.0).quality_db == 90.0
