from itertools import pairwise

import numpy as np
import oracle
import pytest

from cogsplat.codec.encode import compensation_fit
from cogsplat.codec.encode.compensation_fit import (
    errors,
    fit,
    placeholder_compensation,
    plan_layers,
)
from cogsplat.codec.encode.prefix_sampling import choose_prefixes
from cogsplat.codec.encode.shift_optimiser import FitConfig
from cogsplat.codec.errors import Cancelled
from cogsplat.codec.executor import LocalThreads
from cogsplat.codec.metrics import psnr
from cogsplat.codec.order import prefix_inflation
from cogsplat.codec.order.marginal_gain import GainConfig, gain_order
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.reference_views import render_references
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.segments.prefix_compensation import Compensation

_COUNTS = (40, 50, 60, 90, 130, 130)


@pytest.fixture(scope="module")
def scene():
    splats = oracle.scene(5, n=500)
    cameras = [oracle.camera(angle=angle) for angle in (0, 20, 40)]
    scores = score(splats, cameras, ScoreConfig(jitter=False))
    rows = gain_order(splats, scores, cameras, GainConfig(jitter=False))
    references = render_references(splats, cameras, jittered=False)
    return (
        splats.take(rows),
        cameras,
        references,
        prefix_inflation.effective_splats(scores.contribution),
    )


def _same(one, other):
    for a, b in zip(one.layers, other.layers, strict=True):
        for name in ("scales", "opacities", "strengths", "book", "codes"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_prefixes_show_more_and_codes_pay(scene):
    splats, cameras, references, effective_splats = scene
    plain = fit(splats, _COUNTS, references, effective_splats, FitConfig(code_bits=0))
    coded = fit(
        splats, _COUNTS, references, effective_splats, FitConfig(code_bits=4, coded_share=0.65)
    )
    assert [layer.chunks for layer in coded.layers] == [layer.chunks for layer in plain.layers]

    def quality(drawn):
        return np.mean([psnr(render(splats, view), render(drawn, view)) for view in cameras])

    for chunks in (1, 2):
        prefix = splats.take(slice(0, sum(_COUNTS[:chunks])))
        raw = quality(prefix)
        assert quality(plain.apply(prefix, chunks)) > raw + 0.3
        assert quality(coded.apply(prefix, chunks)) > quality(plain.apply(prefix, chunks)) + 0.3


def test_the_fit_does_not_depend_on_threads(scene):
    splats, _, references, effective_splats = scene
    found = [
        fit(
            splats,
            _COUNTS,
            references,
            effective_splats,
            FitConfig(iterations=4, coded_share=0.65, threads=threads),
        )
        for threads in (1, 3)
    ]
    _same(*found)


def test_a_blank_takes_the_same_room(scene):
    splats, _, references, effective_splats = scene
    config = FitConfig(iterations=3, coded_share=0.65)
    found = fit(splats, _COUNTS, references, effective_splats, config)
    empty = placeholder_compensation(_COUNTS, effective_splats, config)
    for a, b in zip(found.layers, empty.layers, strict=True):
        for name in ("scales", "opacities", "strengths", "book", "codes"):
            assert getattr(a, name).shape == getattr(b, name).shape
            assert getattr(a, name).dtype == getattr(b, name).dtype
    assert not empty.shifts_of(np.arange(2), np.full(2, 2)).any()


def test_codes_name_rows_of_the_book(scene):
    splats, _, references, effective_splats = scene
    found = fit(
        splats,
        _COUNTS,
        references,
        effective_splats,
        FitConfig(code_bits=2, iterations=5, coded_share=0.65),
    )
    before = 0
    for layer in found.layers:
        if len(layer.book):
            assert len(layer.book) <= 4
            assert len(layer.codes) == sum(_COUNTS[before : layer.chunks])
            assert layer.codes.max() < len(layer.book)
        before = layer.chunks


def test_layers_grow_and_leave_out_the_whole():
    assert plan_layers([100] * 10, 800) == [1, 2, 3, 5, 7]
    assert plan_layers([100], 800) == []
    assert plan_layers([900, 100], 800) == []
    assert plan_layers([100] * 10, 800, most_chunks=4) == [1, 2, 3]


def test_one_chunk_wants_nothing(scene):
    splats, _, references, effective_splats = scene
    found = fit(splats, (500,), references, effective_splats)
    assert found.layers == ()


def test_long_layers_take_fewer_steps(scene, monkeypatch):
    splats, _, references, effective_splats = scene
    taken = []
    step = compensation_fit.ShiftOptimiser.step

    def counted(self, number, *rest):
        taken.append(number)
        step(self, number, *rest)

    monkeypatch.setattr(compensation_fit, "_LONG_LAYER", 30)
    monkeypatch.setattr(compensation_fit.ShiftOptimiser, "step", counted)
    calls = []
    found = fit(
        splats,
        _COUNTS,
        references,
        effective_splats,
        FitConfig(iterations=12),
        progress=lambda *call: calls.append(call),
    )
    layers = len(plan_layers(_COUNTS, effective_splats))
    # 40 and 90 splats: at every iteration, and at every third.
    assert [taken.count(number) for number in range(layers)] == [12, 4]
    assert calls[-1] == ("compensate", 12 * layers, 12 * layers)
    assert len(found.layers) >= layers


def test_progress_can_cancel(scene):
    splats, _, references, effective_splats = scene

    def stop(stage, done, total):
        assert stage == "compensate"
        if done == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        fit(splats, _COUNTS, references, effective_splats, progress=stop)


@pytest.mark.parametrize("wrong", [{"code_bits": 9}, {"iterations": 0}, {"views": 0}])
def test_config_is_checked(wrong):
    with pytest.raises(ValueError, match="expected"):
        FitConfig(**wrong)


def test_errors_of_prefixes_are_those_of_their_pictures(scene):
    splats, _, references, effective_splats = scene
    found = fit(
        splats, _COUNTS, references, effective_splats, FitConfig(iterations=3, coded_share=0.65)
    )
    prefix_mse = errors(found, splats, references, executor=LocalThreads(2))
    assert len(prefix_mse) == len(_COUNTS) + 1
    assert prefix_mse[0] == pytest.approx(np.mean([np.mean(p**2) for p in references.pictures]))
    assert prefix_mse[-1] < 1e-12
    drawn = found.apply(splats.take(slice(0, 90)), 2)
    pictures = [render(drawn, camera) for camera in references.cameras]
    pairs = zip(pictures, references.pictures, strict=True)
    expected = np.mean([np.mean((np.clip(a, 0, 1) - b) ** 2) for a, b in pairs])
    assert prefix_mse[2] == pytest.approx(expected, rel=1e-4)


def test_of_many_prefixes_some_errors_are_measured(scene):
    splats, _, references, _ = scene
    found = errors(Compensation((), np.full(50, 10)), splats, references)
    assert len(found) == 51
    measured = choose_prefixes([10] * 50, 10)
    for chunks in measured[:-1].tolist():
        two = Compensation((), np.array([10 * chunks, 500 - 10 * chunks]))
        nothing, exact, whole = errors(two, splats, references)
        assert found[[0, chunks, 50]] == pytest.approx([nothing, exact, whole], abs=1e-15)
    # Those between have no more error than the prefix before, and no less than the one behind.
    for before, behind in pairwise(measured.tolist()):
        between = found[before : behind + 1]
        assert (np.diff(between) * (found[behind] - found[before]) >= 0).all()
