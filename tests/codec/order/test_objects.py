from dataclasses import replace

import numpy as np
import oracle
import pytest
from encoding import encode, unseen

from cogsplat.codec.errors import DataError
from cogsplat.codec.order import chunk_plan, objects
from cogsplat.codec.order.orders import OrderConfig
from cogsplat.codec.scoring.contribution import zero_scores


def labelled(labels, dtype=np.uint8):
    labels = np.asarray(labels)
    splats = oracle.scene(1, n=len(labels), degree=0)
    return replace(splats, extras={"object": labels.astype(dtype)})


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.uint32, np.float32])
def test_labels_come_from_the_attribute(dtype):
    found = objects.labels_of(labelled([0, 3, 7, 3], dtype))
    assert found.dtype == np.uint32
    assert found.tolist() == [0, 3, 7, 3]
    column = objects.labels_of(labelled(np.array([[2], [5]]), dtype))
    assert column.tolist() == [2, 5]


@pytest.mark.parametrize(
    ("labels", "dtype"),
    [([-1, 0], np.int8), ([0.5, 1], np.float32), ([np.nan, 1], np.float32), ([2.0**33], float)],
)
def test_invalid_labels_are_refused(labels, dtype):
    with pytest.raises(DataError) as caught:
        objects.labels_of(labelled(labels, dtype))
    assert caught.value.code == "bad-objects"


def test_scenes_without_labels_are_refused():
    with pytest.raises(DataError) as caught:
        objects.labels_of(oracle.scene(1, n=3))
    assert caught.value.code == "no-objects"
    assert "no extra attributes, expected labels of objects" in caught.value.message
    with pytest.raises(DataError, match="'heat', 'other', expected labels"):
        objects.labels_of(
            replace(oracle.scene(1, n=3), extras={"other": np.zeros(3), "heat": np.zeros(3)})
        )
    with pytest.raises(DataError) as caught:
        objects.labels_of(labelled(np.zeros((3, 2))))
    assert caught.value.code == "bad-objects"


def test_labels_are_kept_in_the_smallest_type():
    splats = oracle.scene(1, n=3)
    for most, dtype in ((3, np.uint8), (300, np.uint16), (1 << 20, np.uint32)):
        kept = objects.with_labels(splats, np.array([0, 1, most]))
        assert kept.extras["object"].dtype == dtype
        assert objects.labels_of(kept).tolist() == [0, 1, most]


def test_objects_rank_by_their_whole_contribution():
    labels = np.array([4, 1, 4, 9, 1, 0], np.uint32)
    values = np.array([1.0, 5.0, 2.0, 3.0, 4.0, 3.0])
    found, total = objects.rank_objects(labels, values)
    assert found.tolist() == [1, 0, 4, 9]
    assert total.tolist() == [9.0, 3.0, 3.0, 3.0]


def mixed(n=3000, seed=2):
    rng = np.random.default_rng(seed)
    return rng.permutation(n), rng.integers(0, 4, n).astype(np.uint32), rng.random(n)


def test_chunks_hold_one_object_each_in_its_order():
    rows, labels, values = mixed()
    found = objects.chunk_by_object(rows, labels, values, 500)
    assert sorted(found.rows.tolist()) == list(range(3000))
    assert [run.start for run in found.slices[1:]] == [run.stop for run in found.slices[:-1]]
    for run, label in zip(found.slices, found.objects, strict=True):
        assert set(labels[found.rows[run]].tolist()) == {label}
        assert run.stop - run.start <= 500
    for label in range(4):
        own = found.rows[labels[found.rows] == label].tolist()
        assert own == [row for row in rows.tolist() if labels[row] == label]
        sizes = [
            r.stop - r.start for r, o in zip(found.slices, found.objects, strict=True) if o == label
        ]
        plan = chunk_plan.plan_chunks(len(own), 500)
        assert sizes == [run.stop - run.start for run in plan]


def test_whole_scene_sharpens_as_without_objects():
    rows, labels, values = mixed()
    found = objects.chunk_by_object(rows, labels, values, 500)
    place = np.empty(3000)
    place[rows] = np.arange(3000)
    means = [place[found.rows[run]].mean() for run in found.slices]
    assert means == sorted(means)


def test_budgets_come_first_object_by_object():
    rows, labels, values = mixed()
    found = objects.chunk_by_object(rows, labels, values, 500, [(None, 0.25), (2, 0.5), (3, 0.0)])
    ranks = [label for label in objects.rank_objects(labels, values)[0].tolist() if label != 3]
    start = 0
    for label in ranks:
        count = int(np.ceil((0.5 if label == 2 else 0.25) * (labels == label).sum()))
        own = [row for row in rows.tolist() if labels[row] == label][:count]
        assert found.rows[start : start + count].tolist() == own
        start += count
    assert sorted(found.rows.tolist()) == list(range(3000))


def test_a_budget_for_a_missing_object_is_refused():
    rows, labels, values = mixed()
    with pytest.raises(DataError, match="a budget for object 77, expected one of") as caught:
        objects.chunk_by_object(rows, labels, values, 500, [(None, 0.25), (77, 0.5)])
    assert caught.value.code == "object-missing"


def test_no_rows_make_no_chunks():
    nothing = np.zeros(0, np.int64)
    found = objects.chunk_by_object(nothing, np.zeros(5, np.uint32), np.zeros(5), 10)
    assert len(found.rows) == len(found.slices) == len(found.objects) == 0


def test_encoded_chunks_name_their_object():
    splats = labelled(np.random.default_rng(3).integers(0, 3, 600))
    scores = replace(zero_scores(600), contribution=np.random.default_rng(4).random(600))
    config = unseen(profile="near-lossless", chunk_splats=128, ordering=OrderConfig(by_object=True))
    encoded = encode(splats, scores, config)
    labels = splats.extras["object"]
    for label in range(3):
        held = sum(chunk.splats for chunk in encoded.chunks if chunk.object == label)
        assert held == (labels == label).sum()
    with pytest.raises(DataError, match="no extra attributes"):
        encode(splats.without_extras(), scores, config)


def test_invalid_budgets_are_refused_before_scoring():
    scene = labelled([0, 2, 2], np.uint8)
    objects.require_objects(scene, ((None, 0.5), (2, 0.1)))
    with pytest.raises(
        DataError, match=r"a budget for object 1, expected one of \[0, 2\]"
    ) as caught:
        objects.require_objects(scene, ((1, 0.1),))
    assert caught.value.code == "object-missing"
    with pytest.raises(DataError) as caught:
        objects.require_objects(oracle.scene(1, n=3))
    assert caught.value.code == "no-objects"
