import numpy as np
import oracle
import pytest

from cogsplat.codec.render.projection import project
from cogsplat.codec.render.tiles import TILE, sampled_pixels, sampled_tiles, tile_lists
from cogsplat.codec.splats import empty


def _footprints(splats, camera):
    return project(splats, camera)


@pytest.mark.parametrize("seed", range(4))
def test_every_pixel_a_splat_reaches_is_in_one_of_its_tiles(seed):
    splats, camera = oracle.scene(seed, n=120), oracle.camera(angle=seed)
    footprints = _footprints(splats, camera)
    (lists,) = tile_lists(footprints, camera.width, camera.height)
    tiles_x = -(-camera.width // TILE)
    listed = set()
    for tile in range(lists.last):
        members = lists.members[lists.starts[tile] : lists.starts[tile + 1]]
        assert (np.diff(members) > 0).all(), "not nearest first, or twice"
        listed |= {(tile, int(footprints.index[member])) for member in members}
    seen = oracle.view(splats, camera)
    reached = set()
    for pixel, index in zip(*np.nonzero(seen.weights), strict=True):
        y, x = divmod(int(pixel), camera.width)
        reached.add((y // TILE * tiles_x + x // TILE, int(index)))
    assert reached <= listed


def test_thin_diagonal_splats_skip_the_corners_of_their_box():
    splats = empty(0, 1)
    splats.scales[0] = [0.0, -9.0, -9.0]
    splats.quats[0] = [np.cos(np.pi / 8), 0.0, 0.0, np.sin(np.pi / 8)]
    camera = oracle.camera(angle=0.0, width=160, height=160, focal=120.0)
    (lists,) = tile_lists(_footprints(splats, camera), 160, 160)
    assert 0 < len(lists.members) < 40


@pytest.mark.parametrize("pairs", [1, 7, 50])
def test_bands_list_the_same_as_one_list(pairs):
    splats, camera = oracle.scene(5, n=80), oracle.camera()
    footprints = _footprints(splats, camera)
    (whole,) = tile_lists(footprints, camera.width, camera.height)
    bands = list(tile_lists(footprints, camera.width, camera.height, pairs_at_once=pairs))
    assert len(bands) > 2
    assert [band.first for band in bands[1:]] == [band.last for band in bands[:-1]]
    assert (bands[0].first, bands[-1].last) == (whole.first, whole.last)
    np.testing.assert_array_equal(np.concatenate([band.members for band in bands]), whole.members)
    for band in bands:
        assert len(band.members) <= pairs or band.last == band.first + 1


@pytest.mark.parametrize("parts", [1, 2, 3, 100])
def test_split_covers_every_tile_once(parts):
    splats, camera = oracle.scene(5, n=80), oracle.camera()
    for lists in tile_lists(_footprints(splats, camera), camera.width, camera.height, 60):
        ranges = lists.split(parts)
        assert len(ranges) <= parts
        tiles = [tile for first, last in ranges for tile in range(first, last)]
        assert tiles == list(range(lists.first, lists.last))


def test_no_splats_still_cover_every_tile():
    camera = oracle.camera()
    (lists,) = tile_lists(_footprints(empty(0), camera), camera.width, camera.height)
    assert (lists.first, lists.last, len(lists.members)) == (0, 12, 0)
    assert lists.split(3) == [(0, 12)]


@pytest.mark.parametrize("every", [1, 2, 3, 4, 9])
def test_consecutive_samples_have_each_tile_once(every):
    width, height = 150, 70  # the last tiles are cut
    samples = [sampled_tiles(width, height, every, phase) for phase in range(5, 5 + every)]
    assert (np.sum(samples, axis=0) == 1).all()
    assert sum(sampled_pixels(width, height, sample) for sample in samples) == width * height
    for sample in samples:
        assert sampled_pixels(width, height, sample) <= TILE * TILE * sample.sum()
    assert sampled_tiles(1, 1, every, 0).tolist() == [True]


def test_tile_lists_of_some_pairs():
    splats, camera = oracle.scene(5, n=80), oracle.camera()
    footprints = _footprints(splats, camera)
    tiles = sampled_tiles(camera.width, camera.height, 3, 1)
    places = np.arange(len(footprints), dtype=np.int32)[::-1].copy()
    for band in tile_lists(footprints, camera.width, camera.height, pairs_at_once=50):
        few = band.of_pairs(band.pairs_in(tiles)).renumbered(places)
        assert (few.first, few.last) == (band.first, band.last)
        for tile in range(band.first, band.last):
            whole = band.members[slice(*band.starts[tile - band.first :][:2])]
            found = few.members[slice(*few.starts[tile - band.first :][:2])]
            expected = places[whole] if tiles[tile] else []
            np.testing.assert_array_equal(found, expected)
