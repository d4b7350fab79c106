"""First chunks that end: what a scene becomes that has them."""

from dataclasses import replace

import numpy as np
import oracle
import pytest
from encoding import encode, unseen

from cogsplat.codec.encode import pipeline
from cogsplat.codec.encode.compensation_fit import errors_before_fit
from cogsplat.codec.encode.config import EncodeConfig, Target
from cogsplat.codec.encode.partial_prefixes import decode_partial_prefixes
from cogsplat.codec.encode.preview_chunks import prepend_preview
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.order.orders import OrderConfig
from cogsplat.codec.rate.segment_order import OrderedKind
from cogsplat.codec.scoring.contribution import score, zero_scores
from cogsplat.codec.scoring.reference_views import render_references
from cogsplat.codec.segments.attributes import attribute_types, unpack_attributes

UNTIL = 5


@pytest.fixture(scope="module")
def cameras():
    return [oracle.camera(0.3 * k) for k in range(3)]


@pytest.fixture(scope="module")
def parts(cameras):
    extras = {"label": np.arange(1, 601, dtype=np.uint16)}
    splats = replace(oracle.scene(6, n=600), extras=extras)
    made = encode(splats, score(splats, cameras), unseen(chunk_splats=50, quality_db=45.0))
    first = oracle.scene(7, n=60).with_sh_degree(0)
    plain = unseen(chunk_splats=40, quality_db=40.0, refine=False, order="contribution")
    preview = encode(first, zero_scores(60), plain)
    return made, preview, prepend_preview(made, preview, UNTIL)


def test_the_first_chunks_are_drawn_until_they_end(parts):
    made, preview, joined = parts
    own = len(preview.chunks)
    assert own == 2
    assert [chunk.until for chunk in joined.chunks] == [UNTIL] * own + [0] * len(made.chunks)
    assert joined.splats == made.splats + preview.splats == len(joined.decoded)
    for chunks in range(1, len(joined.chunks) + 1):
        drawn = joined.prefix_splats(chunks)
        before = made.prefix_splats(max(chunks - own, 0))
        rest = drawn
        if chunks < UNTIL:
            shown = preview.prefix_splats(min(chunks, own))
            np.testing.assert_array_equal(drawn.means[: len(shown)], shown.means)
            assert not drawn.shN[: len(shown)].any()
            rest = drawn.take(slice(len(shown), None))
        assert len(rest) == len(before)
        for name in ("means", "scales", "quats", "opacities", "sh0", "shN"):
            np.testing.assert_array_equal(getattr(rest, name), getattr(before, name))
    assert len(joined.prefix_splats(0)) == 0


def test_boxes_and_attributes_are_of_all_chunks(parts):
    made, _, joined = parts
    for chunk in joined.chunks:
        assert (joined.box[:3] <= chunk.box[:3]).all()
        assert (joined.box[3:] >= chunk.box[3:]).all()
    kinds = attribute_types(made.scene.extras)
    labels = []
    for chunk in joined.chunks:
        out = {kind.name: kind.allocate(chunk.splats) for kind in kinds}
        unpack_attributes(memoryview(chunk.attributes), kinds, out, "chunk")
        labels.append(out["label"])
    assert not np.concatenate(labels[:2]).any()
    assert np.concatenate(labels[2:]).all()


def test_prefixes_show_nothing_of_chunks_that_have_ended(parts):
    _, preview, joined = parts
    size = preview.splats
    short, long = decode_partial_prefixes(joined, [UNTIL - 1, UNTIL], 10_000)
    assert np.isfinite(short.opacities[:size]).all()
    assert np.isneginf(long.opacities[:size]).all()
    assert np.isfinite(long.opacities[size:]).all()
    # The scene itself is left alone.
    assert np.isfinite(joined.decoded.opacities).all()


def test_the_other_segments_keep_their_order(parts, cameras):
    made, preview, _ = parts
    references = render_references(made.decoded, cameras, jittered=False)
    measured = replace(made, prefix_mse=errors_before_fit(made, references, 300))
    joined = prepend_preview(measured, preview, UNTIL)
    np.testing.assert_allclose(
        errors_before_fit(joined, references, 300), joined.prefix_mse, rtol=1e-6
    )
    own = len(preview.chunks)
    places = joined.ordered_segments()
    assert [(place.kind, place.chunk) for place in places[:own]] == [
        (OrderedKind.HEAD, number) for number in range(own)
    ]
    assert [(place.kind, max(place.chunk - own, -1)) for place in places[own:]] == [
        (place.kind, place.chunk) for place in measured.ordered_segments()
    ]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"compensate": False}, "without compensation"),
        ({"profile": "near-lossless"}, "without compensation"),
        ({"cells": True}, "cells or objects"),
        ({"ordering": OrderConfig(by_object=True)}, "cells or objects"),
    ],
)
def test_what_a_preview_contradicts_is_refused(settings, said):
    with pytest.raises(ValueError, match=said):
        EncodeConfig(preview=0.02, **settings)


def test_a_preview_takes_views_and_memory(cameras):
    request = EncodeRequest(config=EncodeConfig(order="contribution", preview=0.02))
    scene = oracle.scene(4, n=50)
    with pytest.raises(ValueError, match="without its maker"):
        pipeline.encode(scene, replace(request, cameras=cameras))
    with pytest.raises(ValueError, match="no views to compensate in"):
        pipeline.encode(scene, replace(request, scores=zero_scores(50)), preview=Doubled())
    with pytest.raises(ValueError, match="memory limit"):
        replace(request, memory_bytes=1 << 30)


class Doubled:
    """A preview that is the first chunk once more."""

    def add(self, encoded, references, effective_splats, *, progress):
        assert effective_splats > 0
        progress("preview", 1, 1)
        first = encoded.chunks[0]
        again = replace(
            encoded,
            splats=first.splats,
            chunks=[replace(first, payloads=replace(first.payloads, refinement=None, tail=None))],
            decoded=encoded.decoded.take(slice(0, first.splats)).with_sh_degree(0),
        )
        return prepend_preview(encoded, again, 3)

    def reserve(self, encoded):
        return self.add(encoded, None, 1, progress=lambda *_: None)


def test_the_encoder_compensates_and_predicts_with_it(cameras):
    splats = oracle.scene(4, n=600)
    config = EncodeConfig(chunk_splats=40, threads=1)
    plain_request = EncodeRequest(cameras=cameras, config=config, preset="fast")
    request = replace(plain_request, config=replace(config, preview=0.02))
    plain = pipeline.encode(splats, plain_request)
    made = pipeline.encode(splats, request, preview=Doubled())
    assert [chunk.until for chunk in made.chunks[:2]] == [3, 0]
    assert len(made.compensation.chunk_splats) == len(plain.chunks) + 1
    # The whole file shows what it shows without a preview.
    assert made.report.test_psnr_db == plain.report.test_psnr_db
    assert made.chunks[-1].quality_db == pytest.approx(plain.chunks[-1].quality_db)

    def size_of(encoded):
        return sum(
            len(chunk.payloads.head)
            + len(chunk.payloads.refinement or b"")
            + len(chunk.payloads.tail or b"")
            for chunk in encoded.chunks
        )

    target = Target(size_bytes=9000)
    sized = pipeline.encode(
        splats, replace(request, target=target), size_of=size_of, preview=Doubled()
    )
    assert 0.9 * 9000 < size_of(sized) <= 9000
