from dataclasses import replace

import numpy as np
import oracle
import pytest
from encoding import UNSEEN, encode, unseen

from cogsplat.codec.encode import finishing, pipeline
from cogsplat.codec.encode.config import EncodeConfig, Target
from cogsplat.codec.encode.prepared import prepare
from cogsplat.codec.encode.presets import PRESETS
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.errors import CogsplatWarning, DataError
from cogsplat.codec.scoring.contribution import score, zero_scores
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.views.close_views import view_distances
from cogsplat.codec.views.view_sets import TEST_VIEWS

FAST = PRESETS["fast"]
LITTLE = EncodeConfig(chunk_splats=40, threads=1)
ONCE = ScoreConfig(jitter=False, sensitivity_every=1, threads=1)


@pytest.fixture(scope="module")
def scene():
    return oracle.scene(4, n=600)


@pytest.fixture(scope="module")
def views():
    return [oracle.camera(0.3 * k) for k in range(4)]


def payload_bytes(encoded):
    parts = [payload for book in encoded.codebooks for payload in book.payloads]
    for chunk in encoded.chunks:
        payloads = chunk.payloads
        parts += [payloads.head, payloads.refinement or b"", payloads.tail or b""]
    return sum(len(part) for part in parts)


def encoded(scene, views, config=LITTLE, **options):
    hooks = {name: options.pop(name) for name in ("size_of", "progress") if name in options}
    request = EncodeRequest(cameras=views, config=config, score_config=ONCE, **options)
    return pipeline.encode(scene, request, **hooks)


def test_a_scene_with_cameras_is_compensated_and_predicted(scene, views):
    stages = []
    made = encoded(scene, views, progress=lambda *call: stages.append(call))
    assert made.compensation is not None
    assert made.prefix_mse is not None
    assert len(made.prefix_mse) == len(made.chunks) + 1
    assert all(chunk.quality_db > 10 for chunk in made.chunks)
    assert made.report.scored_views == len(views)
    assert (made.report.quality_db, made.report.trials) == (40.0, 1)
    # Every stage that reported has its time, in the order in which the stages began.
    names = list(dict.fromkeys(name for name, _, _ in stages))
    assert list(made.report.seconds) == names
    ordering = ["score", "reference views", "gain", "order"]
    assert names == [*ordering, "quantisers", "chunks", "compensate", "predict"]
    assert all(seconds >= 0 for seconds in made.report.seconds.values())
    assert list(made.report.cpu_seconds) == names
    assert sum(made.report.cpu_seconds.values()) > 0


def test_test_views_are_where_quality_is_predicted(scene, views):
    config = replace(LITTLE, compensate=False, order="contribution")
    elsewhere = [oracle.camera(0.15)]
    own, given = (encoded(scene, views, config, test_views=tests) for tests in ((), elsewhere))
    assert payload_bytes(own) == payload_bytes(given)
    pairs = zip(own.chunks, given.chunks, strict=True)
    assert all(a.quality_db != b.quality_db for a, b in pairs)


def test_the_report_says_whose_views_were_scored_and_predicted_in(scene, views):
    config = replace(LITTLE, compensate=False, order="contribution")
    report = encoded(scene, views, config).report
    assert (report.views, report.test_views) == ("given", "scored")
    assert report.coverage == (score(scene, views, ONCE).covered > 0).mean()
    assert len(report.test_psnr_db) == len(views)
    report = pipeline.encode(
        scene, EncodeRequest(config=config, score_config=ONCE, preset="fast")
    ).report
    assert (report.views, report.test_views) == ("planned", "planned")
    assert 0.9 <= report.coverage <= 1.0
    assert len(report.test_psnr_db) == TEST_VIEWS


def test_cameras_that_leave_out_much_are_warned_of(scene, views):
    config = replace(LITTLE, compensate=False, order="contribution")
    means = scene.means.copy()
    means[:300, 1] += 500.0
    beyond = replace(scene, means=means)
    with pytest.warns(CogsplatWarning, match="% of the splats lie in a picture of the cameras"):
        made = encoded(beyond, views[:1], config)
    assert made.report.coverage < 0.75


def test_without_views_nothing_is_compensated_nor_predicted(scene):
    made = encode(scene, None, unseen(compensate=True))
    assert (made.report.views, made.report.test_views) == ("none", "none")
    assert made.report.test_psnr_db == ()
    assert made.compensation is None
    assert all(chunk.quality_db == 0 for chunk in made.chunks)
    # And heads are not made for being compensated.
    assert payload_bytes(made) == payload_bytes(encode(scene, None, UNSEEN))


@pytest.mark.parametrize("order", ["gain", "gain+first-view"])
@pytest.mark.parametrize("cameras", [None, []])
def test_an_order_that_renders_takes_cameras(scene, order, cameras):
    ordering = replace(LITTLE.ordering, first_view=oracle.camera(0.0))
    config = EncodeConfig(order=order, ordering=ordering)
    with pytest.raises(ValueError, match="expected the cameras"):
        EncodeRequest(config=config, cameras=cameras, scores=zero_scores(len(scene)))


def test_scores_of_the_cameras_are_not_measured_again(scene, views):
    scores = score(scene, views, ONCE)
    stages = set()
    made = encoded(scene, views, scores=scores, progress=lambda name, *_: stages.add(name))
    assert "score" not in stages
    assert made.report.scored_views == 0
    assert payload_bytes(made) == payload_bytes(encoded(scene, views))


def test_scenes_that_show_nothing_are_archived_and_else_refused(scene):
    hidden = replace(scene, opacities=np.full(len(scene), -20, np.float32))
    archived = pipeline.encode(
        hidden, EncodeRequest(config=EncodeConfig(profile="near-lossless"), preset="fast")
    )
    assert archived.splats == len(scene)
    with pytest.raises(DataError) as caught:
        pipeline.encode(hidden, EncodeRequest(preset="fast"))
    assert caught.value.code == "empty-scene"


@pytest.mark.parametrize(
    ("target", "profile", "words"),
    [
        (Target(psnr_db=30.0), "near-lossless", "profile for viewing"),
        (Target(size_bytes=9000), "near-lossless", "profile for viewing"),
        (Target(size_bytes=9000), "transform", "size_of"),
        (Target(psnr_db=30.0), "transform", "views to see it in"),
    ],
)
def test_targets_that_cannot_be_measured_are_misuse(scene, target, profile, words):
    with pytest.raises(ValueError, match=words):
        encode(scene, None, unseen(profile=profile), target=target)


def test_a_size_is_kept_by_the_finished_scene(scene, views):
    calls = []

    def size_of(made):
        calls.append(made)
        extra = 200 if made.prefix_mse is not None else 0
        return payload_bytes(made) + extra

    whole = payload_bytes(encoded(scene, views))
    target = Target(size_bytes=int(0.7 * whole))
    made = encoded(scene, views, target=target, size_of=size_of)
    assert 0.9 * target.size_bytes <= size_of(made) <= target.size_bytes
    assert made.compensation is not None
    assert 1 < made.report.trials < len(calls)
    assert made.report.quality_db < 40.0


def test_scenes_that_a_size_search_finishes_are_measured_in_one_set_of_close_views(
    scene, views, monkeypatch
):
    measured = []

    def counted(*arguments, **options):
        measured.append(view_distances(*arguments, **options))
        return measured[-1]

    monkeypatch.setattr(finishing, "view_distances", counted)
    finisher = finishing.Finisher(
        prepare(scene, score(scene, views, ONCE), LITTLE), scene, FAST, test_views=views
    )
    first, second = finisher.encode(30.0), finisher.encode(40.0)
    assert len(measured) == 1
    assert first.report.close_distances == second.report.close_distances != ()
    assert first.report.close_psnr_db < second.report.close_psnr_db


def test_objects_that_are_not_there_are_refused_before_splats_are_scored(scene, views):
    stages = set()
    config = replace(LITTLE, ordering=replace(LITTLE.ordering, by_object=True))
    with pytest.raises(DataError) as refused:
        encoded(scene, views, config, progress=lambda name, *_: stages.add(name))
    assert refused.value.code == "no-objects"
    assert stages == set()
