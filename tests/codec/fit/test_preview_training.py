"""Trained previews: the first bytes show the whole scene, and the whole stays as it is."""

from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.encode import pipeline
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.fit.preview_training import PreviewConfig, TrainedPreview
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.scoring.contribution import zero_scores
from cogsplat.codec.splats import empty
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

CONFIG = PreviewConfig(share=0.05, round_steps=25, quantised_steps=10, threads=1)


@pytest.fixture(scope="module")
def scene():
    return synth(4000, seed=5), synth_cameras(8, 96, 72)


def encoded(scene, preview=None, threads=1):
    splats, cameras = scene
    share = None if preview is None else CONFIG.share
    config = EncodeConfig(chunk_splats=512, preview=share, threads=threads)
    request = EncodeRequest(cameras=cameras, config=config, preset="fast")
    return pipeline.encode(splats, request, preview=preview)


@pytest.fixture(scope="module")
def plain(scene):
    return encoded(scene)


@pytest.fixture(scope="module")
def opened(scene):
    return encoded(scene, TrainedPreview(CONFIG))


def heads(chunks):
    return sum(len(chunk.payloads.head) for chunk in chunks)


def payloads(chunks):
    return sum(
        len(chunk.payloads.refinement or b"") + len(chunk.payloads.tail or b"") for chunk in chunks
    ) + heads(chunks)


def shown_db(scene, splats):
    source, cameras = scene
    return np.mean([psnr(render(source, view), render(splats, view)) for view in cameras])


def test_the_first_bytes_show_more_and_the_whole_is_as_before(scene, plain, opened):
    own = [chunk for chunk in opened.chunks if chunk.until]
    books = sum(len(payload) for book in plain.codebooks for payload in book.payloads)
    assert 0 < heads(own) <= 0.05 * (payloads(plain.chunks) + books)
    assert opened.chunks[len(own) :][0].payloads.head == plain.chunks[0].payloads.head
    first = opened.compensation.apply(opened.drawn(len(own)), len(own))
    # As many bytes of the file without a preview, and more.
    chunks = 1
    while heads(plain.chunks[:chunks]) < heads(own):
        chunks += 1
    usual = plain.compensation.apply(plain.drawn(chunks), chunks)
    assert shown_db(scene, first) > shown_db(scene, usual) + 0.3
    for name in ("means", "scales", "quats", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(
            getattr(opened.drawn(len(opened.chunks)), name), getattr(plain.decoded, name)
        )


def test_it_ends_where_a_layer_of_the_compensation_does(opened):
    (until,) = {chunk.until for chunk in opened.chunks if chunk.until}
    layers = [layer.chunks for layer in opened.compensation.layers]
    assert until in {*layers, len(opened.chunks)}


@pytest.mark.slow
def test_it_is_the_same_for_any_number_of_threads(scene, opened):
    again = encoded(scene, TrainedPreview(replace(CONFIG, threads=3)), threads=2)
    assert [chunk.payloads.head for chunk in again.chunks] == [
        chunk.payloads.head for chunk in opened.chunks
    ]


def test_a_scene_that_is_too_small_has_none(scene):
    splats, cameras = scene
    tiny = splats.take(slice(0, 20)), cameras
    assert not any(chunk.until for chunk in encoded(tiny, TrainedPreview(CONFIG)).chunks)
    config = EncodeConfig(order="source", preview=0.02)
    request = EncodeRequest(config=config, scores=zero_scores(0))
    nothing = pipeline.encode(empty(0, 0), request, preview=TrainedPreview())
    assert nothing.chunks == []


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"share": 0.0}, "share 0.0"),
        ({"share": 1.0}, "share 1.0"),
        ({"round_steps": 0}, "at least 1 each"),
        ({"seed": -1}, "seed -1"),
        ({"threads": -1}, "-1 threads"),
    ],
)
def test_settings_that_mean_nothing_are_refused(settings, said):
    with pytest.raises(ValueError, match=said):
        PreviewConfig(**settings)
