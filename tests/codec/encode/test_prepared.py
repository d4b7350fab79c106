from dataclasses import replace

import numpy as np
import oracle
from encoding import unseen

from cogsplat.codec.encode.prepared import prepare
from cogsplat.codec.order.chunk_plan import plan_chunks
from cogsplat.codec.partition.nested_cells import WHOLE_SCENE, parents
from cogsplat.codec.rate.pruning import PruneConfig
from cogsplat.codec.scoring.contribution import zero_scores
from cogsplat.codec.scoring.splat_groups import measure_shares
from cogsplat.tools.lab.synthetic.rooms import rooms_cameras, synth_rooms


def test_a_scene_is_laid_out_once_while_the_same_splats_stay():
    scene = oracle.scene(4, n=600)
    rng = np.random.default_rng(3)
    scores = replace(
        zero_scores(len(scene)),
        energy=rng.lognormal(-9, 2, len(scene)),
        peak=rng.uniform(0, 0.1, len(scene)).astype(np.float32),
        covered=np.full(len(scene), 9, np.int32),
    )
    kept = prepare(scene, scores, unseen(prune=None))
    coarse, fine = kept.lay_out(30.0), kept.lay_out(50.0)
    assert fine.slices is coarse.slices
    assert fine.rows is coarse.rows
    assert 0 < fine.lagrangian < coarse.lagrangian
    pruned = prepare(scene, scores, unseen(prune=PruneConfig()))
    few, more = pruned.lay_out(12.0), pruned.lay_out(40.0)
    assert 0 < len(few.rows) < len(more.rows) < len(scene)
    assert pruned.lay_out(40.0).slices is more.slices
    np.testing.assert_array_equal(pruned.lay_out(12.0).rows, few.rows)
    for layout in (few, more):
        part = layout.part(layout.slices[0])
        np.testing.assert_array_equal(part.means, scene.means[layout.rows[layout.slices[0]]])
        assert layout.slices[-1].stop == len(layout.rows)


def test_another_configuration_of_the_same_order_is_laid_out_anew():
    scene = oracle.scene(4, n=600)
    prepared = prepare(scene, zero_scores(600), unseen(prune=None, chunk_splats=100))
    layout = prepared.lay_out(40.0)
    other = replace(prepared, config=unseen(prune=None, chunk_splats=60)).lay_out(40.0)
    assert layout.slices == plan_chunks(600, 100)
    assert other.slices == plan_chunks(600, 60)
    np.testing.assert_array_equal(layout.rows, other.rows)
    assert prepared.lay_out(40.0).slices is layout.slices


def test_cells_have_chunks_of_their_own_in_the_order_of_their_layers():
    scene = oracle.scene(4, n=3000)
    config = unseen(prune=None, chunk_splats=100, cells=True)
    prepared = prepare(scene, zero_scores(3000), config)
    layout = prepared.lay_out(40.0)
    assert sorted(layout.rows.tolist()) == list(range(3000))
    assert max(run.stop - run.start for run in layout.slices) <= 100
    assert layout.cells.dtype == np.uint32
    assert layout.cells[0] == 1
    assert len(set(layout.cells.tolist())) > 20
    np.testing.assert_array_equal(layout.rows[:100], prepared.rows[:100])
    above = parents(layout.cells)
    assert (above[1:] >= 0).all()
    # Halves of the whole are apart: no splat of one lies among those of the other.
    sides = []
    for half in (2, 3):
        own = [
            layout.rows[run]
            for run, cell in zip(layout.slices, layout.cells.tolist(), strict=True)
            if cell > 1 and int(f"{cell:b}"[:2], 2) == half
        ]
        sides.append(scene.means[np.concatenate(own)])
    assert (sides[0].max(axis=0) < sides[1].min(axis=0)).any()


def test_chunks_that_are_not_cut_by_cell_have_none():
    layout = prepare(oracle.scene(4, n=300), zero_scores(300), unseen(prune=None)).lay_out(40.0)
    assert layout.cells.tolist() == [0] * len(layout.slices)


def test_objects_have_chunks_of_their_own():
    labels = np.random.default_rng(5).integers(0, 3, 600).astype(np.uint8)
    scene = replace(oracle.scene(4, n=600), extras={"object": labels})
    config = unseen(prune=None, chunk_splats=80)
    config = replace(config, ordering=replace(config.ordering, by_object=True))
    layout = prepare(scene, zero_scores(600), config).lay_out(40.0)
    assert sorted(layout.rows.tolist()) == list(range(600))
    for run, label in zip(layout.slices, layout.objects, strict=True):
        assert (labels[layout.rows[run]] == label).all()


def test_rooms_are_cut_apart_before_they_are_cut_into_layers():
    scene = synth_rooms(4, 8000, sh_degree=0)
    views = [camera.downscaled(8) for camera in rooms_cameras(4, views=4)]
    config = unseen(prune=None, cells=True, chunk_splats=1024)
    shares = measure_shares(scene, views)
    prepared = prepare(scene, zero_scores(8000), config, group_shares=shares)
    assert prepared.regions.halves is not None
    layout = prepared.lay_out(40.0)
    np.testing.assert_array_equal(np.sort(layout.rows), np.arange(8000))
    assert (parents(layout.cells)[1:] >= 0).all()
    # All chunks but the first lie on one side of the first plane.
    axis, plane = prepared.regions.axis, prepared.regions.plane
    for run in layout.slices[1:]:
        is_low = layout.part(run).means[:, axis] < plane
        assert is_low.all() or not is_low.any()
    # Without shares nothing tells rooms apart.
    assert prepare(scene, zero_scores(8000), config).regions is WHOLE_SCENE


def test_the_sky_is_cut_apart_from_the_rooms_below_it():
    scene = synth_rooms(2, 8000, sh_degree=0)
    means = scene.means.copy()
    means[::20] = 900.0 * means[::20] / np.linalg.norm(means[::20], axis=1)[:, None]
    config = unseen(prune=None, cells=True, chunk_splats=1024)
    prepared = prepare(replace(scene, means=means), zero_scores(8000), config)
    box = prepared.regions.box
    assert box is not None
    assert max(box[3:]) - min(box[:3]) < 100.0
    layout = prepared.lay_out(40.0)
    for run in layout.slices[1:]:
        sizes = np.linalg.norm(layout.part(run).means, axis=1)
        assert (sizes > 800.0).all() or not (sizes > 800.0).any()
