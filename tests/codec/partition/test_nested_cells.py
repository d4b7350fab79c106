"""Nested cells: each splat once, bounded chunk sizes, chunks within cells and after parents."""

import numpy as np
import pytest

from cogsplat.codec.partition.nested_cells import NestedCells, nested_cells, parents


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
