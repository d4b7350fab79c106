from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.clustering.kmeans import TrainingConfig
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.encoder import encode_chunks
from cogsplat.codec.encode.prepared import prepare
from cogsplat.codec.fit.round_trip import round_trip
from cogsplat.codec.geometry import rotations
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.scoring.contribution import score
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

QUALITY = 36.0
LONG = TrainingConfig()


@pytest.fixture(scope="module")
def prepared():
    splats, cameras = synth(800, seed=2), synth_cameras(6, 64, 48)
    config = EncodeConfig(order="contribution", compensate=False, chunk_splats=300, threads=1)
    return prepare(splats, score(splats, cameras), config, views=cameras)


def covariances(splats):
    spread = rotations.matrices(rotations.unit(splats.quats)) * np.exp(splats.scales)[:, None, :]
    return spread @ spread.transpose(0, 2, 1)


def test_decoded_values_are_in_the_rows_of_the_source(prepared):
    source = prepared.source
    made = round_trip(prepared, source, QUALITY)
    found, encoded = made.decoded, made.encoded
    expected = encode_chunks(prepared, QUALITY)
    assert [chunk.payloads.head for chunk in encoded.chunks] == [
        chunk.payloads.head for chunk in expected.chunks
    ]
    left = np.isfinite(found.opacities)
    assert left.sum() == encoded.splats
    # Every decoded splat has a row with all its values.
    key = np.lexsort(found.means[left].T)
    other = np.lexsort(encoded.decoded.means.T)
    for name in ("means", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(
            getattr(found, name)[left][key], getattr(encoded.decoded, name)[other]
        )
    np.testing.assert_allclose(
        covariances(found.take(left))[key],
        covariances(encoded.decoded)[other],
        rtol=1e-3,
        atol=2e-6 * np.abs(covariances(encoded.decoded)).max(),
    )
    # It is the row of its source.
    assert np.abs(found.means - source.means)[left].max() < 0.05 * np.abs(source.means).max()
    camera = oracle.camera(distance=6.0)
    assert psnr(render(found, camera), render(encoded.decoded, camera)) > 60.0


def test_axes_are_permuted_to_match_the_source(prepared):
    source = prepared.source
    found = round_trip(prepared, source, 60.0).decoded
    left = np.isfinite(found.opacities)
    turned = np.sum(found.quats * source.quats, axis=1)[left]
    lengths = np.linalg.norm(source.quats, axis=1)[left]
    np.testing.assert_allclose(np.linalg.norm(found.quats, axis=1)[left], lengths, rtol=1e-4)
    assert np.median(turned / lengths**2) > 0.999
    assert np.median(np.abs(found.scales - source.scales)[left]) < 0.05


def test_order_and_count_do_not_follow_the_values(prepared):
    source = prepared.source
    before = round_trip(prepared, source, QUALITY).encoded
    moved = source.take(slice(0, len(source)))
    moved.sh0[:] += np.float32(1e-3)
    after = round_trip(prepared, moved, QUALITY).encoded
    assert after.splats == before.splats
    for one, other in zip(before.chunks, after.chunks, strict=True):
        np.testing.assert_array_equal(one.payloads.order, other.payloads.order)


def test_the_sh_basis_follows_the_values(prepared):
    source = prepared.source
    rng = np.random.default_rng(5)
    # All view-dependent colour now lies along one random axis.
    axis = rng.normal(size=source.shN.shape[1:])
    along = rng.normal(0.0, 0.3, len(source))[:, None, None] * axis / np.linalg.norm(axis)
    moved = replace(source, shN=along.astype(np.float32))
    before, after = (round_trip(prepared, each, QUALITY).encoded for each in (source, moved))
    anew = encode_chunks(replace(prepared, source=moved), QUALITY)
    assert after.codebooks == anew.codebooks
    rows = after.codebooks[0].decode(source.sh_degree).shN
    assert len(rows) < before.codebooks[0].rows
    first = rows[0].ravel() / np.linalg.norm(rows[0])
    assert abs(first @ axis.ravel()) / np.linalg.norm(axis) > 0.99


def test_codebooks_start_from_those_of_the_last_encode():
    splats, cameras = synth(3000, seed=3), synth_cameras(6, 64, 48)
    rng = np.random.default_rng(3)
    colours = rng.normal(0, 0.3, (4, 15, 3))[rng.integers(4, size=len(splats))]
    noise = rng.normal(0, 0.06, colours.shape)
    splats = replace(splats, shN=(colours + noise).astype(np.float32))
    config = EncodeConfig(
        profile="vq",
        order="contribution",
        compensate=False,
        prune=None,
        threads=1,
        training=TrainingConfig(iterations=1),
    )
    prepared = prepare(splats, score(splats, cameras), config, views=cameras)
    first = encode_chunks(replace(prepared, config=replace(config, training=LONG)), QUALITY)
    again = round_trip(prepared, splats, QUALITY, first.codebooks).encoded
    anew = round_trip(prepared, splats, QUALITY).encoded

    def colours_of(encoded):
        return [book for book in encoded.codebooks if book.attribute == "colour"][-1]

    def error(encoded):
        """Return the distances of the colours to the nearest row."""
        rows = colours_of(encoded).decode(splats.sh_degree).shN
        far = np.square(splats.shN[:, None] - rows[None]).sum(axis=(2, 3))
        return far.min(axis=1).mean()

    assert colours_of(again).payloads != colours_of(first).payloads
    assert colours_of(again).rows <= colours_of(first).rows <= colours_of(anew).rows
    assert error(again) < 1.05 * error(first)
