"""Preview training: the first bytes show the whole scene, and the rest of it is unchanged."""

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

CONFIG = PreviewConfig(share=0.06, round_steps=25, quantised_steps=10, threads=1)


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
def with_preview(scene):
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


def test_the_first_bytes_show_more_and_the_whole_is_unchanged(scene, plain, with_preview):
    own = [chunk for chunk in with_preview.chunks if chunk.until]
    books = sum(len(payload) for book in plain.codebooks for payload in book.payloads)
    assert 0 < heads(own) <= 0.06 * (payloads(plain.chunks) + books)
    assert with_preview.chunks[len(own) :][0].payloads.head == plain.chunks[0].payloads.head
    first = with_preview.compensation.apply(with_preview.prefix_splats(len(own)), len(own))
    # A prefix without preview of at least the same size.
    chunks = 1
    while heads(plain.chunks[:chunks]) < heads(own):
        chunks += 1
    without = plain.compensation.apply(plain.prefix_splats(chunks), chunks)
    assert shown_db(scene, first) > shown_db(scene, without) + 0.3
    for name in ("means", "scales", "quats", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(
            getattr(with_preview.prefix_splats(len(with_preview.chunks)), name),
            getattr(plain.decoded, name),
        )


def test_the_preview_ends_at_a_compensation_layer(with_preview):
    (until,) = {chunk.until for chunk in with_preview.chunks if chunk.until}
    layers = [layer.chunks for layer in with_preview.compensation.layers]
    assert until in {*layers, len(with_preview.chunks)}


@pytest.mark.slow
def test_the_preview_does_not_depend_on_threads(scene, with_preview):
    again = encoded(scene, TrainedPreview(replace(CONFIG, threads=3)), threads=2)
    assert [chunk.payloads.head for chunk in again.chunks] == [
        chunk.payloads.head for chunk in with_preview.chunks
    ]


def test_small_and_empty_scenes_get_no_preview(scene):
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
def test_invalid_settings_are_refused(settings, said):
    with pytest.raises(ValueError, match=said):
        PreviewConfig(**settings)
