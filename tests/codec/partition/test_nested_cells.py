"""Nested cells: each splat once, bounded chunk sizes, chunks within cells and after parents."""

import numpy as np
import pytest

from cogsplat.codec.partition.nested_cells import (
    WHOLE_SCENE,
    NestedCells,
    Region,
    box_of_most,
    nested_cells,
    parents,
)


def cut(means: np.ndarray, first: int = 64, least: int = 16, most: int = 128) -> NestedCells:
    weights = np.linspace(1.0, 0.0, len(means))
    return nested_cells(means, weights, first=first, growth=1.5, smallest=least, largest=most)


def scattered(splats: int, seed: int = 0) -> np.ndarray:
    """Return means of uneven density, with floaters far outside."""
    rng = np.random.default_rng(seed)
    means = rng.normal(size=(splats, 3)) * np.array([5.0, 1.0, 3.0])
    means[: splats // 3] *= 0.1
    means[::97] *= 100.0
    return rng.permutation(means)


@pytest.mark.parametrize("splats", [0, 1, 15, 16, 64, 65, 127, 128, 129, 500, 3000, 10_000])
def test_every_splat_is_in_one_chunk_of_a_legal_size(splats: int) -> None:
    found = cut(scattered(splats))
    np.testing.assert_array_equal(np.sort(found.order), np.arange(splats))
    sizes = [run.stop - run.start for run in found.slices]
    assert sum(sizes) == splats
    assert [run.start for run in found.slices] == [0, *np.cumsum(sizes).tolist()][: len(sizes)]
    assert max(sizes, default=0) <= 128
    assert min(sizes, default=16) >= min(16, splats)
    assert (np.diff(found.layers) >= 0).all()


@pytest.mark.parametrize("seed", range(5))
def test_cells_of_a_layer_are_apart_and_halves_refine_the_whole(seed: int) -> None:
    means = scattered(6000, seed)
    found = cut(means)
    cells = found.cells.tolist()
    # Boxes of halves of one cell are apart along an axis: all splats below it, in any layer.
    below: dict[int, list[int]] = {}
    for run, cell in zip(found.slices, cells, strict=True):
        above = cell
        while above:
            below.setdefault(above, []).extend(found.order[run].tolist())
            above >>= 1
    halved = [cell for cell in below if 2 * cell in below and 2 * cell + 1 in below]
    assert len(halved) > 10
    for cell in halved:
        # Chunks of the cell itself were made before it was halved: only its halves are apart.
        low, high = means[below[2 * cell]], means[below[2 * cell + 1]]
        assert (low.max(axis=0) < high.min(axis=0)).any()


@pytest.mark.parametrize("seed", range(5))
def test_parents_come_first_and_hold_the_cell(seed: int) -> None:
    found = cut(scattered(6000, seed))
    cells = found.cells
    above = parents(cells)
    assert above[0] == -1
    assert (above[1:] >= 0).all()
    for chunk, parent in enumerate(above.tolist()):
        if parent < 0:
            continue
        assert parent < chunk
        assert found.layers[parent] < found.layers[chunk]
        halvings = int(cells[chunk]).bit_length() - int(cells[parent]).bit_length()
        assert cells[chunk] >> halvings == cells[parent]


def test_a_scene_without_cells_has_no_parents() -> None:
    assert parents(np.zeros(3, np.uint32)).tolist() == [-1, -1, -1]


def test_early_splats_stay_in_early_layers() -> None:
    found = cut(scattered(5000))
    mean_place = [found.order[run].mean() for run in found.slices]
    by_layer = [
        np.mean([p for p, at in zip(mean_place, found.layers, strict=True) if at == layer])
        for layer in np.unique(found.layers)
    ]
    assert (np.diff(by_layer) > 0).all()


def test_inside_a_layer_the_chunks_that_contribute_most_come_first() -> None:
    means = scattered(4000)
    weights = np.random.default_rng(1).random(4000) * (1.0 + (means[:, 0] > 0.0))
    found = nested_cells(means, weights, first=64, growth=1.5, smallest=16, largest=128)
    for layer in np.unique(found.layers):
        of_layer = [
            weights[found.order[run]].mean()
            for run in np.array(found.slices)[found.layers == layer]
        ]
        assert (np.diff(of_layer) <= 1e-12).all()


def test_splats_in_one_place_make_chunks_of_one_cell() -> None:
    found = cut(np.ones((1000, 3)))
    assert set(found.cells.tolist()) == {1}
    assert max(run.stop - run.start for run in found.slices) <= 128
    assert parents(found.cells).tolist() == list(range(-1, len(found.slices) - 1))


@pytest.mark.parametrize(
    ("first", "growth", "least", "most"),
    [(64, 1.5, 65, 200), (64, 1.5, 10, 60), (64, 1.5, 40, 64), (64, 1.0, 16, 128), (64, 2, 0, 99)],
)
def test_sizes_that_do_not_go_together_are_misuse(
    first: int, growth: float, least: int, most: int
) -> None:
    with pytest.raises(ValueError, match="expected"):
        nested_cells(
            np.zeros((9, 3)), np.zeros(9), first=first, growth=growth, smallest=least, largest=most
        )


def halved(depth: int, axis: int = 0, low: float = -8.0, high: float = 8.0) -> Region:
    """Return regions of equal width along one axis, cut `depth` times."""
    if depth == 0:
        return Region()
    middle = 0.5 * (low + high)
    halves = halved(depth - 1, axis, low, middle), halved(depth - 1, axis, middle, high)
    return Region(axis, middle, halves)


def cut_regions(means: np.ndarray, regions: Region) -> NestedCells:
    weights = np.linspace(1.0, 0.0, len(means))
    return nested_cells(
        means, weights, first=64, growth=1.5, smallest=16, largest=128, regions=regions
    )


@pytest.mark.parametrize("splats", [0, 15, 60, 70, 100, 500, 6000])
@pytest.mark.parametrize("depth", [1, 4, 8])
def test_regions_hold_every_splat_once_in_chunks_with_parents(splats: int, depth: int) -> None:
    means = np.random.default_rng(splats).uniform(-8.0, 8.0, (splats, 3))
    found = cut_regions(means, halved(depth))
    np.testing.assert_array_equal(np.sort(found.order), np.arange(splats))
    sizes = [run.stop - run.start for run in found.slices]
    assert max(sizes, default=0) <= 128
    assert min(sizes, default=16) >= min(16, splats)
    above = parents(found.cells)
    assert (above[1:] >= 0).all()
    assert (found.layers[above[1:]] < found.layers[1:]).all()
    assert (np.diff(found.layers) >= 0).all()


def test_chunks_of_regions_are_apart_and_coarse_chunks_span_them() -> None:
    rng = np.random.default_rng(1)
    means = rng.uniform(-8.0, 8.0, (6000, 3))
    means[:, 0] = rng.permutation(np.linspace(-7.99, 7.99, 6000))
    found = cut_regions(means, halved(4))
    below = {cell: found.order[run] for run, cell in zip(found.slices, found.cells, strict=True)}
    # The scene, its quarters and its sixteenths have chunks, and chunks of sixteenths are halved.
    depths = {int(cell).bit_length() - 1 for cell in found.cells}
    assert depths == {0, 2, *range(4, max(depths) + 1)}
    for cell, rows in below.items():
        depth = int(cell).bit_length() - 1
        number = int(cell) >> max(depth - 4, 0)
        width = 16.0 / 2 ** min(depth, 4)
        low = -8.0 + (number - (1 << min(depth, 4))) * width
        assert ((means[rows, 0] >= low) & (means[rows, 0] < low + width)).all()
    # The coarse chunk of a region holds its first splats.
    quarter = np.flatnonzero((means[:, 0] < -4.0) & (np.arange(6000) >= 64))
    np.testing.assert_array_equal(below[4], quarter[:64])


def test_surroundings_share_no_chunk_but_the_first_with_the_scene() -> None:
    rng = np.random.default_rng(2)
    means = rng.uniform(-8.0, 8.0, (2000, 3))
    is_sky = rng.random(2000) < 0.01
    means[is_sky] *= 1000.0
    assert 16 <= np.count_nonzero(is_sky[64:]) < 128
    box = box_of_most(means)
    found = cut_regions(means, Region(halves=(halved(1), WHOLE_SCENE), box=box))
    np.testing.assert_array_equal(np.sort(found.order), np.arange(2000))
    first, *others = (is_sky[found.order[run]] for run in found.slices)
    assert len(first) == 64
    assert all(of.all() or not of.any() for of in others)
    # The surroundings are the second half of the scene.
    skies = [cell for cell, of in zip(found.cells[1:], others, strict=True) if of.all()]
    assert {int(cell) >> int(cell).bit_length() - 2 for cell in skies} == {3}


def test_a_region_that_pruning_left_empty_is_not_halved() -> None:
    means = np.random.default_rng(1).uniform(1.0, 8.0, (500, 3))
    assert np.array_equal(cut_regions(means, halved(1)).order, cut(means).order)


def test_cell_numbers_of_deep_regions_fit_32_bits() -> None:
    region = Region()
    for depth in range(40):
        region = Region(0, float(depth - 40), (Region(), region))
    # Most splats lie in the deepest region.
    edges = np.repeat(np.arange(-40.0, 0.0), 16) - 0.5
    means = np.zeros((len(edges) + 2000, 3))
    means[::4, 0][: len(edges)] = edges[::-1]
    found = cut_regions(means, region)
    assert int(found.cells.max()) < 1 << 32
    np.testing.assert_array_equal(np.sort(found.order), np.arange(len(means)))
