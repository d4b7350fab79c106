from dataclasses import replace

import decoding
import numpy as np
import oracle
import pytest
from encoding import encode, unseen

from cogsplat.codec.encode.presets import PRESETS
from cogsplat.codec.encode.quality_prediction import PrefixEvaluator, measure_whole, predict_quality
from cogsplat.codec.errors import DataError
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.splats import SceneInfo, concatenate
from cogsplat.codec.views.view_sets import sample_evenly


def views(count):
    return [oracle.camera(0.2 * k) for k in range(count)]


def scene(n=600):
    return replace(oracle.scene(2, n=n), info=SceneInfo(kernel_px=0.1, antialiased=True))


def encoded_in(chunks, profile="transform", n=600, **changes):
    config = unseen(
        profile=profile, prune=None, chunk_splats=n // chunks, order="source", **changes
    )
    return encode(scene(n), None, config)


@pytest.mark.parametrize("profile", ["transform", "vq", "near-lossless"])
def test_decoded_rows_are_what_the_payloads_hold(profile):
    encoded = encoded_in(3, profile, 90)
    expected = concatenate(decoding.chunks(encoded))
    assert len(expected) == 90
    for name in ("means", "scales", "quats", "opacities", "sh0", "shN"):
        found = getattr(encoded.decoded, name)
        assert found.tobytes() == getattr(expected, name).tobytes(), name
    assert encoded.decoded.info == scene(90).info


@pytest.mark.parametrize("profile", ["transform", "vq", "near-lossless"])
def test_every_decoded_row_stands_for_its_row_of_the_source(profile):
    # The order of the source and no sort inside chunks: row for row.
    encoded = encoded_in(3, profile, 90, morton=False, quality_db=60.0)
    found, source = encoded.decoded, scene(90)
    sizes = np.exp(source.scales.astype(np.float64)).mean(axis=1)
    moved = np.linalg.norm(found.means.astype(np.float64) - source.means, axis=1)
    assert (moved < 0.5 * sizes).all()
    others = np.linalg.norm(found.means[:, None] - source.means, axis=2).argmin(axis=1)
    assert (others == np.arange(90)).mean() > 0.9
    assert np.abs(found.sh0 - source.sh0).max() < 0.1


def test_an_empty_scene_has_nothing_to_predict():
    none = encode(scene().take(slice(0, 0)), None)
    assert len(none.decoded) == 0
    assert PrefixEvaluator(scene(), views(1)).prefixes_db(none) == []


def test_quality_is_the_mean_over_the_views():
    source, other = scene(), encoded_in(1).decoded
    each = [psnr(render(source, v), render(other, v)) for v in views(3)]
    evaluator = PrefixEvaluator(source, views(3))
    assert evaluator.psnr_db(other) == pytest.approx(np.mean(each))
    assert evaluator.psnr_db(source) == 100.0
    assert PrefixEvaluator(source, views(3), threads=1).psnr_db(other) == evaluator.psnr_db(other)


def test_no_views_are_refused():
    with pytest.raises(DataError) as caught:
        PrefixEvaluator(scene(), [])
    assert caught.value.code == "no-cameras"


def test_every_chunk_says_what_the_scene_up_to_it_shows():
    encoded = encoded_in(5)
    found = predict_quality(encoded, PrefixEvaluator(scene(), views(3)))
    evaluator, whole = PrefixEvaluator(scene(), views(3)), encoded.decoded
    ends = np.cumsum([chunk.splats for chunk in encoded.chunks])
    for chunk, end in zip(found.chunks, ends, strict=True):
        expected = evaluator.psnr_db(whole.take(slice(0, int(end))))
        assert chunk.quality_db == pytest.approx(expected)
    assert all(chunk.quality_db == 0 for chunk in encoded.chunks)


def test_the_whole_is_measured_in_more_views_than_prefixes():
    encoded = encoded_in(5)
    found = predict_quality(encoded, PrefixEvaluator(scene(), views(6)), most_views=2)
    each = PrefixEvaluator(scene(), views(6)).views_db(encoded.decoded)
    assert sorted(found.report.test_psnr_db) == pytest.approx(sorted(each))
    assert found.chunks[-1].quality_db == pytest.approx(np.mean(each))
    # Prefixes keep what they have less than the whole, where both are measured.
    few = PrefixEvaluator(scene(), sample_evenly(views(6), 2)).prefixes_db(encoded)
    lost = [few[-1] - quality for quality in few]
    assert [found.chunks[-1].quality_db - c.quality_db for c in found.chunks] == pytest.approx(lost)


def test_a_prefix_of_less_than_is_taken_away_predicts_nothing():
    encoded = encoded_in(5)
    # Prefixes are measured in the first and the last view, where the whole is far better.
    whole = (100.0, 1.0, 1.0, 100.0)
    encoded = replace(encoded, report=replace(encoded.report, test_psnr_db=whole))
    found = predict_quality(encoded, PrefixEvaluator(scene(), views(4)), most_views=2)
    assert found.chunks[0].quality_db == 0.0
    assert found.chunks[-1].quality_db == pytest.approx(50.5)


def test_of_many_chunks_some_are_measured():
    encoded = encoded_in(40, n=400)
    calls = []
    evaluator = PrefixEvaluator(scene(400), views(1))
    found = evaluator.prefixes_db(encoded, progress=lambda *call: calls.append(call))
    assert len(found) == len(encoded.chunks) == 40
    assert calls[-1] == ("predict", 8, 8)
    assert found[-1] == evaluator.psnr_db(encoded.decoded)
    assert np.isfinite(found).all()


def test_a_whole_that_is_known_is_not_measured_again():
    encoded = encoded_in(5)
    evaluator = PrefixEvaluator(scene(), views(2))
    known = evaluator.prefixes_db(encoded, whole_db=99.0)
    assert known[-1] == 99.0
    assert known[:-1] == evaluator.prefixes_db(encoded)[:-1]


def test_a_whole_that_was_measured_for_a_target_is_not_drawn_again(monkeypatch):
    encoded = encoded_in(5)
    evaluator = PrefixEvaluator(scene(), views(4))
    once = measure_whole(encoded, evaluator)
    assert once.report.test_psnr_db == tuple(evaluator.views_db(encoded.decoded))
    drawn = []
    draw = evaluator.views_db

    def counted(splats, views=None, first=None):
        drawn.append(len(splats) if first is None else first)
        return draw(splats, views, first=first)

    monkeypatch.setattr(evaluator, "views_db", counted)
    found = predict_quality(once, evaluator)
    assert drawn == [120, 240, 360, 480]
    assert found.chunks[-1].quality_db == pytest.approx(np.mean(once.report.test_psnr_db))


def test_of_large_pictures_some_tiles_tell_what_all_do():
    large = [replace(view, width=1280, height=960) for view in views(2)]
    large = [
        replace(v, fx=v.fx * 1280 / w.width, fy=v.fy * 960 / w.height, cx=640.0, cy=480.0)
        for v, w in zip(large, views(2), strict=True)
    ]
    other = encoded_in(1).decoded
    evaluator = PrefixEvaluator(scene(), large)
    exact = [psnr(render(scene(), v), render(other, v)) for v in large]
    found = evaluator.views_db(other)
    assert found != exact
    np.testing.assert_allclose(found, exact, atol=0.5)


def test_views_are_spread_evenly():
    cameras = list(range(43))
    assert sample_evenly(cameras, 50) == cameras
    for count in range(1, 43):
        # One of each stretch, or the one behind it; none twice.
        chosen = sample_evenly(cameras, count)
        run = 43 / count
        for k, camera in enumerate(chosen):
            assert int(k * run) <= camera <= (k + 1) * run
        assert len(set(chosen)) == count
        assert chosen == sorted(chosen)
    for period in (2, 3):
        kinds = [camera % period for camera in sample_evenly(list(range(48)), 8)]
        assert min(kinds.count(kind) for kind in range(period)) >= 2


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("count", [1, 5, 12, 24, 43, 300])
def test_presets_thin_out_views_but_not_small_sets(name, count):
    preset = PRESETS[name]
    chosen = preset.views(views(count))
    assert len(chosen) >= min(count, 12)
    assert len(chosen) <= -(-count // preset.views_every) or count < 36
    assert len(chosen) <= preset.most_views
    assert len(preset.views(views(3000))) == min(preset.most_views, 3000 // preset.views_every)
    assert preset.score_config("near-lossless").sensitivity_every == 0
    assert preset.score_config("transform").sensitivity_every == preset.sensitivity_every
