"""Partial rendering compared with decoding the same chunks."""

from pathlib import Path

import numpy as np
import pytest

import cogsplat
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.metrics import PSNR_CAP_DB, psnr
from cogsplat.codec.partition.nested_cells import parents
from cogsplat.codec.render.rasteriser import render
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.lab.conformance import compensation_vectors
from cogsplat.tools.lab.scheduling.chunk_ratios import MIN_RATIO
from cogsplat.tools.lab.scheduling.growth import growth, missing_splats
from cogsplat.tools.lab.streaming.client import PAGE, units_of
from cogsplat.tools.lab.streaming.partial_renderer import PartialRenderer
from cogsplat.tools.lab.synthetic.rooms import rooms_cameras, synth_rooms

CAMERA = rooms_cameras(4)[3]


@pytest.fixture
def renderer(house_file: CogsFile) -> PartialRenderer:
    return PartialRenderer(house_file, threads=1)


def test_all_units_give_the_full_picture(house_file: CogsFile, renderer: PartialRenderer) -> None:
    units = units_of(house_file)
    whole = renderer.picture(CAMERA)
    drawn = renderer.splats_of_units(units, range(len(units)))
    assert psnr(renderer.picture(CAMERA, drawn), whole) == PSNR_CAP_DB
    assert not len(renderer.splats_of_units(units, []))


def test_heads_alone_are_drawn_coarse_and_without_tails(
    house_file: CogsFile, renderer: PartialRenderer
) -> None:
    units = units_of(house_file)
    heads = np.flatnonzero(units.kind == SegmentKind.HEAD).tolist()
    whole = renderer.picture(CAMERA)
    coarse = house_file.decode(sh_degree=0, refine=False)
    expected = np.clip(render(coarse, CAMERA), 0.0, 1.0)
    found = renderer.picture(CAMERA, renderer.splats_of_units(units, heads))
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert psnr(found, whole) < PSNR_CAP_DB


def test_missing_chunks_are_compensated(tmp_path: Path) -> None:
    path = tmp_path / "compensated.cogs"
    cameras = rooms_cameras(2, views=2)
    config = EncodeConfig(cells=True, chunk_splats=256, order="contribution")
    cogsplat.encode(synth_rooms(2, 3000, sh_degree=0), path, cameras=cameras, config=config)
    with cogsplat.open(path) as file:
        units = units_of(file)
        renderer = PartialRenderer(file, threads=1, compensate=True)
        # The last chunk with all its ancestors.
        above = parents(file.chunks.cell)
        held = [file.num_chunks - 1]
        while above[held[0]] >= 0:
            held.insert(0, int(above[held[0]]))
        assert held != list(range(len(held)))
        there = [u for u in range(len(units)) if units.row[u] in held]
        expected = file.decode(held, compensate=True)
        found = renderer.splats_of_units(units, there)
        np.testing.assert_array_equal(found.scales, expected.scales)
        np.testing.assert_array_equal(found.opacities, expected.opacities)
        stored = file.decode(held)
        assert not np.array_equal(found.scales, stored.scales)
        # Missing chunks are invisible at this pose, so compensation is weaker.
        ratios = np.where(np.isin(np.arange(file.num_chunks), held), 1.0, MIN_RATIO)
        hidden = renderer.splats_of_units(units, there, ratios)
        change, whole = np.abs(hidden.scales - stored.scales), np.abs(found.scales - stored.scales)
        assert change.mean() < 0.5 * whole.mean()
        # Chunks without their parents are not compensated.
        alone = [u for u in there if units.row[u] == held[-1]]
        np.testing.assert_array_equal(
            renderer.splats_of_units(units, alone).scales, file.decode(held[-1:]).scales
        )


def test_without_layers_all_splats_of_a_file_of_cells_may_grow(house_file: CogsFile) -> None:
    renderer = PartialRenderer(house_file, threads=1, compensate=True)
    units = units_of(house_file)
    heads = np.flatnonzero(units.kind == SegmentKind.HEAD).tolist()[:1]
    coarse = house_file.decode([0], sh_degree=0, refine=False)
    assert not house_file.compensation().layers
    grown = renderer.splats_of_units(units, heads).scales - coarse.scales
    assert grown.min() >= 0.0
    assert grown.max() > 0.25


def test_behind_the_layers_splats_grow_where_chunks_below_are_missing(tmp_path: Path) -> None:
    path = tmp_path / "grown.cogs"
    config = EncodeConfig(cells=True, chunk_splats=64, order="contribution")
    scene = synth_rooms(2, 12000, sh_degree=0)
    cogsplat.encode(scene, path, cameras=rooms_cameras(2, views=2), config=config)
    with cogsplat.open(path) as file:
        above, last = file.parents(), file.compensation().last_chunks
        chunk = int(above[above >= last].max())
        held = [chunk]
        while above[held[0]] >= 0:
            held.insert(0, int(above[held[0]]))
        units = units_of(file)
        is_there = (units.kind == PAGE) | np.isin(units.row, held)
        there = np.flatnonzero(is_there).tolist()
        renderer = PartialRenderer(file, threads=1, compensate=True)
        grown = renderer.splats_of_units(units, there)
        expected = file.decode(held, compensate=True)
        own = slice(-int(file.chunks.splats[chunk]), None)
        is_held = np.isin(np.arange(file.num_chunks), held)
        missing = missing_splats(is_held, above, file.chunks.splats)
        below = np.flatnonzero(above == chunk)
        added = growth(expected.means[own], file.chunks.box[below], missing[below])
        assert added.max() >= 0.25
        np.testing.assert_array_equal(grown.scales[own], expected.scales[own] + added[:, None])
        in_layers = np.repeat(np.array(held) < last, file.chunks.splats[held])
        assert in_layers.any()
        np.testing.assert_array_equal(grown.scales[in_layers], expected.scales[in_layers])
        np.testing.assert_array_equal(grown.opacities, expected.opacities)
        # Nothing grows for what the pose does not show.
        ratios = np.where(is_held, 1.0, MIN_RATIO)
        hidden = renderer.splats_of_units(units, there, ratios)
        np.testing.assert_array_equal(hidden.scales[own], file.decode(held).scales[own])


@pytest.mark.parametrize("name", ["compensation-pages", "compensation-cells-pages"])
def test_layers_of_chunks_in_unread_pages_do_not_count(name: str) -> None:
    data = next(v.data for v in compensation_vectors.valid() if v.name == name)
    with cogsplat.open(data) as file:
        units = units_of(file)
        renderer = PartialRenderer(file, threads=1, compensate=True)
        for page in file.indices[0].pages():
            with cogsplat.open(data[: page.start], partial=True) as part:
                chunks = part.num_chunks
                expected = part.decode(range(chunks), compensate=True)
            is_there = (units.kind == PAGE) & (units.end <= page.start)
            is_there |= (units.kind != PAGE) & (units.row < chunks)
            found = renderer.splats_of_units(units, np.flatnonzero(is_there).tolist())
            # In a file of cells, chunks after those of the layers grow; all others are as decoded.
            is_as_decoded = np.arange(chunks) < part.compensation().last_chunks
            is_as_decoded |= not file.chunks.cell.all()
            rows = np.repeat(is_as_decoded, part.chunks.splats[:chunks])
            np.testing.assert_array_equal(found.scales[rows], expected.scales[rows])
            assert (found.scales >= expected.scales).all()
            np.testing.assert_array_equal(found.opacities, expected.opacities)


def test_chunk_contributions_cover_each_pixel_about_once(
    house_file: CogsFile, renderer: PartialRenderer
) -> None:
    found = renderer.chunk_contributions(CAMERA)
    assert found.shape == (house_file.num_chunks,)
    assert found.min() >= 0.0
    assert 0.5 < found.sum() / (CAMERA.width * CAMERA.height) < 1.01
    assert (found < 0.01 * found.max()).any(), "a view does not see all rooms"
