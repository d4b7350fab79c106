from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.encode import pipeline, view_table_builder
from cogsplat.codec.encode.config import EncodeConfig, Target
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.formats.cogs.scene_writer import size_bytes
from cogsplat.tools.lab.synthetic.rooms import rooms_cameras, synth_rooms
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

CONFIG = EncodeConfig(order="contribution", cells=True, chunk_splats=256, compensate=False)
CAMERAS = [camera.downscaled(4) for camera in rooms_cameras(4, views=3)]
REQUEST = EncodeRequest(cameras=CAMERAS, config=CONFIG)
HOUSE = synth_rooms(4, 8000, sh_degree=1)


@pytest.fixture(scope="module")
def encoded():
    return pipeline.encode(HOUSE, REQUEST)


def test_a_scene_of_cells_says_what_views_show_of_its_chunks(encoded):
    table = encoded.view_table
    views, chunks = table.codes.shape
    assert views == view_table_builder.count_viewpoints(encoded, len(CAMERAS))
    assert chunks == len(encoded.chunks) > 12
    # Nearly all of each picture is filled by some chunk, and none is filled twice.
    assert (table.shares.sum(axis=1) > 0.3).all()
    assert (table.shares.sum(axis=1) < 1.1).all()
    # What views show on average is what the scene was scored by.
    scored = np.array([chunk.contribution for chunk in encoded.chunks])
    assert np.corrcoef(table.shares.mean(axis=0), scored)[0, 1] > 0.9


def test_the_table_takes_half_a_percent_at_most(encoded):
    without = size_bytes(
        pipeline.encode(HOUSE, replace(REQUEST, config=replace(CONFIG, view_table=False))),
        writer="test",
    )
    # Of the segments; the table of segments has a row more as well.
    assert size_bytes(encoded, writer="test") - without < 0.005 * without + 40


def test_a_scene_that_all_views_see_has_none():
    request = replace(REQUEST, cameras=synth_cameras(10))
    assert pipeline.encode(synth(4000), request).view_table is None


def test_scenes_without_cells_have_none():
    config = EncodeConfig(order="contribution", compensate=False)
    made = pipeline.encode(synth(500), EncodeRequest(config=config, cameras=synth_cameras(4)))
    assert made.view_table is None
    assert view_table_builder.count_viewpoints(made, 3) == 0
    assert view_table_builder.add_view_table(made, synth_cameras(2)) is made
    assert view_table_builder.reserve_view_table(made, 3) is made


def test_a_search_for_a_size_knows_what_the_table_takes(encoded):
    reserved = view_table_builder.reserve_view_table(encoded, len(CAMERAS))
    assert size_bytes(reserved, writer="test") >= size_bytes(encoded, writer="test")

    def size_of(scene):
        return size_bytes(scene, writer="test")

    aim = size_of(encoded) * 3 // 4
    hit = pipeline.encode(HOUSE, replace(REQUEST, target=Target(None, aim)), size_of=size_of)
    assert hit.view_table is not None
    assert 0.95 * aim < size_of(hit) <= aim
