"""Tuning of a small scene: targets, smaller files, checkpoints, time limits and threads."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.capture import capture_of_cameras
from cogsplat.codec.encode.config import EncodeConfig, Target
from cogsplat.codec.encode.pipeline import encode
from cogsplat.codec.encode.prepared import prepare
from cogsplat.codec.encode.presets import PRESETS
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.errors import CogsplatWarning, DataError
from cogsplat.codec.fit import quantised_training, tuning
from cogsplat.codec.fit.differentiable_rendering import Gradients
from cogsplat.codec.fit.quantised_training import QuantisedTraining
from cogsplat.codec.fit.time_budget import TimeBudget
from cogsplat.codec.fit.train_config import TrainConfig
from cogsplat.codec.fit.tune_config import TuneConfig, TuneRequest
from cogsplat.codec.fit.tuning import tune
from cogsplat.codec.fit.tuning_views import TuningViews, choose_tuning_views
from cogsplat.codec.metrics import psnr
from cogsplat.codec.progress import silent
from cogsplat.codec.render.rasteriser import render
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

SHORT = TuneConfig(round_steps=20, recovery_steps=80, quantised_steps=60)


def size_of(encoded):
    parts = [chunk.payloads for chunk in encoded.chunks]
    return sum(
        len(payload)
        for part in parts
        for payload in (part.head, part.refinement or b"", part.tail or b"")
    )


def size_of_all(encoded):
    """Return the bytes of all payloads and codebooks."""
    return size_of(encoded) + sum(
        len(payload) for book in encoded.codebooks for payload in book.payloads
    )


@pytest.fixture(scope="module")
def scene():
    return synth(700, seed=1), synth_cameras(6, 64, 48)


def run_tune(scene, target, config=SHORT, size_of=size_of, **arguments):
    splats, cameras = scene
    request = TuneRequest(TuningViews(cameras), target, config)
    return tune(splats, request, size_of=size_of, **arguments)


@pytest.mark.slow
def test_a_target_psnr_is_met_in_fewer_bytes(scene):
    splats, cameras = scene
    milestones = []
    made = run_tune(scene, Target(psnr_db=31.0), notify=milestones.append)
    assert np.mean(made.encoded.report.test_psnr_db) == pytest.approx(31.0, abs=0.5)
    request = EncodeRequest(cameras=cameras, preset="fast", target=Target(psnr_db=31.0))
    plain = encode(splats, request, size_of=size_of)
    assert size_of(made.encoded) < 0.9 * size_of(plain)
    assert made.encoded.splats < len(splats)
    assert made.encoded.splats == milestones[-1].splats <= len(made.splats)
    assert {each.stage for each in milestones} == {"trained", "stored"}
    assert all(milestone.worst_db <= milestone.psnr_db for milestone in milestones)
    assert made.encoded.chunks[-1].quality_db > 28.0


@pytest.mark.parametrize("profile", ["transform", "vq"])
@pytest.mark.parametrize("corrects", [False, True])
def test_a_target_psnr_never_takes_more_bytes_than_without_tuning(
    scene, profile, corrects, monkeypatch
):
    splats, cameras = scene
    if not corrects:
        monkeypatch.setattr(tuning, "corrected_count", lambda *_: None)
    # This learning rate ruins the scene: no quantiser is fine enough for the target.
    train = TrainConfig(rates={"means": 20.0})
    config = TuneConfig(
        round_steps=1, recovery_steps=1, quantised_steps=10, profile=profile, train=train
    )
    milestones = []
    made = run_tune(scene, Target(psnr_db=33.0), config, size_of_all, notify=milestones.append)
    request = EncodeRequest(
        cameras=cameras,
        config=EncodeConfig(profile=profile),
        preset="fast",
        target=Target(psnr_db=33.0),
    )
    plain = encode(splats, request)
    assert size_of_all(made.encoded) == size_of_all(plain)
    assert made.splats is splats
    # All splats are restored where their number is corrected, and are not trained again.
    before, last = milestones[-2:]
    assert (before.stage, last.stage) == ("trained" if corrects else "stored", "untuned")
    assert before.splats < len(splats)
    assert corrects or last.size_bytes < before.size_bytes
    assert last.psnr_db == pytest.approx(np.mean(plain.report.test_psnr_db))


def test_a_psnr_out_of_reach_has_no_untrained_encode(scene):
    splats, cameras = scene
    config = replace(SHORT, profile="vq")
    request = TuneRequest(TuningViews(cameras), Target(psnr_db=90.0), config)
    training = QuantisedTraining(splats, splats, request, size_of, silent)
    assert training.encode_untrained(splats) is None


def test_a_trained_scene_is_ordered_for_its_first_bytes_and_the_source_as_without_tuning(
    scene, monkeypatch
):
    splats, cameras = scene
    found = []

    def record(source, scores, config, **named):
        found.append((named["effort"], config.ordering.run_chunks))
        return prepare(source, scores, config, **named)

    monkeypatch.setattr(quantised_training, "prepare", record)
    request = TuneRequest(TuningViews(cameras), Target(psnr_db=33.0), SHORT)
    for base in (splats, replace(splats)):
        QuantisedTraining(splats, base, request, size_of, silent)
    assert found == [(PRESETS["fast"].gain, 3), (PRESETS["best"].gain, 2)]


@pytest.mark.slow
def test_a_target_size_is_nearly_used_and_never_exceeded(scene):
    made = run_tune(scene, Target(size_bytes=6000))
    assert 0.95 * 6000 < size_of(made.encoded) <= 6000


@pytest.mark.slow
def test_the_result_does_not_depend_on_threads_or_on_resuming(scene):
    states = []
    target = Target(size_bytes=5000)

    def keep(state):
        states.append({name: np.array(values) for name, values in state.items()})

    whole = run_tune(scene, target, checkpoint=keep)
    config = replace(SHORT, train=TrainConfig(threads=3))
    # Checkpoints before a pruning round, and in the middle of quantised training.
    for state in (states[0], states[-1]):
        again = run_tune(scene, target, config, resume=state)
        assert [chunk.payloads.head for chunk in again.encoded.chunks] == [
            chunk.payloads.head for chunk in whole.encoded.chunks
        ]
        for name in Gradients.names():
            np.testing.assert_array_equal(getattr(again.splats, name), getattr(whole.splats, name))
    assert any("base.means" in state for state in states)


@pytest.mark.slow
def test_codebooks_train_with_the_splats(scene):
    splats, cameras = scene
    # Little training before the quantisers: the gain comes from quantised training.
    config = replace(SHORT, profile="vq", keep=0.7, recovery_steps=30, quantised_steps=100)
    states = []

    def keep(state):
        states.append({name: np.array(values) for name, values in state.items()})

    made = run_tune(scene, Target(size_bytes=9000), config, size_of_all, checkpoint=keep)
    assert {book.attribute for book in made.encoded.codebooks} == {"colour"}
    untrained = encode(
        made.splats,
        EncodeRequest(
            cameras=cameras,
            config=EncodeConfig(profile="vq", order="contribution", compensate=False, prune=None),
            target=Target(size_bytes=9000),
        ),
        size_of=size_of_all,
    )
    views = synth_cameras(6, 64, 48)
    trained_db, untrained_db = (
        np.mean([psnr(render(splats, view), render(one.decoded, view)) for view in views])
        for one in (made.encoded, untrained)
    )
    assert trained_db > untrained_db + 1.0
    # Checkpoints include the codebooks.
    again = run_tune(scene, Target(size_bytes=9000), config, size_of_all, resume=states[-1])
    assert again.encoded.codebooks == made.encoded.codebooks
    assert [chunk.payloads.head for chunk in again.encoded.chunks] == [
        chunk.payloads.head for chunk in made.encoded.chunks
    ]


@pytest.mark.slow
def test_a_resumed_run_makes_the_planned_steps_whatever_their_duration(scene, monkeypatch):
    class Ticking(TimeBudget):
        """Time that passes when it is read, whatever else runs on the machine."""

        def __init__(self, seconds: float | None) -> None:
            ticks = itertools.count()
            super().__init__(seconds, lambda: 0.02 * next(ticks))

    monkeypatch.setattr(tuning, "TimeBudget", Ticking)
    states = []
    target = Target(size_bytes=5000)

    def keep(state):
        states.append({name: np.array(values) for name, values in state.items()})

    config = replace(SHORT, seconds=1.0)
    run_tune(scene, target, config, checkpoint=keep)
    assert int(states[-1]["stored"][1]) != SHORT.quantised_steps
    # Checkpoints before the recovery, and in the middle of quantised training.
    for state in (states[0], states[-1]):
        first, second = (run_tune(scene, target, config, resume=state) for _ in range(2))
        assert [chunk.payloads.head for chunk in first.encoded.chunks] == [
            chunk.payloads.head for chunk in second.encoded.chunks
        ]


@pytest.mark.slow
def test_an_earlier_round_is_restored_if_too_many_splats_were_pruned(scene):
    milestones = []
    config = replace(SHORT, round_keep=0.25)
    made = run_tune(scene, Target(psnr_db=30.0), config, notify=milestones.append)
    counts = [milestone.splats for milestone in milestones if milestone.stage == "trained"]
    assert counts[0] == min(counts) == 175
    assert 175 < counts[-1] < 700
    assert np.mean(made.encoded.report.test_psnr_db) == pytest.approx(30.0, abs=0.5)
    # A higher target needs the splats of before the first round: all.
    made = run_tune(scene, Target(psnr_db=35.0), config, notify=milestones.append)
    assert milestones[-1].stage == "untuned"
    assert milestones[-1].splats > counts[-1]
    assert np.mean(made.encoded.report.test_psnr_db) == pytest.approx(35.0, abs=0.5)


@pytest.mark.slow
def test_a_given_share_of_splats_is_kept(scene):
    config = replace(SHORT, keep=0.5, preset="balanced")
    made = run_tune(scene, Target(psnr_db=30.0), config)
    assert len(made.splats) == 350
    assert np.mean(made.encoded.report.test_psnr_db) == pytest.approx(30.0, abs=0.5)


def test_a_short_time_limit_reduces_steps(scene):
    config = replace(SHORT, seconds=0.01)
    done = []
    with pytest.warns(CogsplatWarning, match="a time limit of 0 s, expected about"):
        run_tune(scene, Target(size_bytes=6000), config, progress=lambda *step: done.append(step))
    totals = [total for stage, step, total in done if stage == "train" and step == 0]
    # The first steps are timed, and the first round has all of them behind it.
    assert totals[0] == 1
    assert totals[-1] == 0.05 * SHORT.recovery_steps
    # Of the 128 views for deletion errors, eight are timed, and there is time for one more.
    views = [total for stage, step, total in done if stage == "deletions" and step == 0]
    assert views[:2] == [8, 1]
    assert done[-1][0] == "predict"


def test_a_size_out_of_reach_is_refused(scene):
    config = replace(SHORT, keep=0.9, round_steps=1, recovery_steps=1, quantised_steps=10)
    with pytest.raises(DataError, match="expected a larger target") as caught:
        run_tune(scene, Target(size_bytes=300), config)
    assert caught.value.code == "target-out-of-reach"


def test_a_tuned_scene_gets_the_viewpoints_of_the_full_pictures():
    splats, cameras = synth(200, seed=1), synth_cameras(3, 64, 48)
    views = choose_tuning_views(splats, cameras, shown_at=32)
    assert views.cameras[0].width == 32
    config = TuneConfig(keep=0.9, round_steps=1, recovery_steps=1, quantised_steps=1)
    request = TuneRequest(views, Target(psnr_db=30.0), config)
    made = tune(splats, request, size_of=size_of)
    expected = capture_of_cameras(cameras)
    assert made.encoded.scene.info.capture == made.splats.info.capture == expected
    assert choose_tuning_views(splats, None, shown_at=32).capture == ()
