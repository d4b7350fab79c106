import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cogsplat.codec.partition.chunk_tree import ROOT_CHUNKS, chunk_tree, common_cell
from cogsplat.codec.partition.nested_cells import parents


def nodes(tree, path=()):
    yield path, tree
    for row, page in enumerate(tree.pages):
        yield from nodes(page, (*path, row))


def layers_of(depth, each=1):
    """Cells of a whole binary tree, one chunk of each cell of a layer after the other."""
    return np.concatenate(
        [np.repeat(np.arange(1 << level, 2 << level), each) for level in range(depth)]
    )


def test_few_chunks_stay_as_they_are():
    cells = layers_of(6)
    tree = chunk_tree(cells)
    assert not tree.pages
    assert tree.order().tolist() == list(range(len(cells)))


def test_a_deep_tree_has_few_chunks_and_pages_in_each_index():
    cells = layers_of(15)
    tree = chunk_tree(cells)
    assert sorted(tree.order().tolist()) == list(range(len(cells)))
    for path, node in nodes(tree):
        assert len(path) <= 2
        assert len(node.chunks) <= (96 if path else ROOT_CHUNKS)
        assert len(node.pages) <= (96 if path else 32)
    # The chunks below each page are those of one cell, and of no other page.
    around = [common_cell(cells[page.order()]) for page in tree.pages]
    assert len(set(around)) == len(around)
    assert not any(a != b and a >> k == b for a in around for b in around for k in range(20))


def test_an_order_of_the_tree_stays_and_keeps_parents():
    cells = layers_of(12)
    order = chunk_tree(cells).order()
    assert chunk_tree(cells[order]).order().tolist() == list(range(len(cells)))
    found, first = [], 0
    for path, node in nodes(chunk_tree(cells[order])):
        if path:
            found.append((first, first + len(node.order())))
        first += len(node.chunks)
    above = parents(cells[order], found)
    assert (cells[order][above[1:]] == cells[order][1:] // 2).all()


@given(st.lists(st.integers(1, 4000), min_size=1, max_size=400))
def test_every_chunk_is_in_one_index(cells):
    tree = chunk_tree(np.array(cells))
    assert sorted(tree.order().tolist()) == list(range(len(cells)))
    assert chunk_tree(np.array(cells)[tree.order()]).order().tolist() == list(range(len(cells)))


def test_cells_that_cannot_be_told_apart_are_one_page_below_another():
    tree = chunk_tree(np.ones(300, np.int64))
    assert [len(node.chunks) for _, node in nodes(tree)] == [64, 96, 96, 44]


@given(st.lists(st.integers(1, 1 << 20), min_size=1, max_size=9))
def test_the_common_cell_is_the_smallest_around_all(cells):
    around = common_cell(np.array(cells))
    above = [{cell >> k for k in range(cell.bit_length())} for cell in cells]
    assert around == max(set.intersection(*above))
