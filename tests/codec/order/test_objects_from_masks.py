import numpy as np
import oracle
import pytest

from cogsplat.codec.errors import DataError, LimitError
from cogsplat.codec.order.objects_from_masks import labels_from_masks
from cogsplat.tools.lab.synthetic.object_masks import synth_masks
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras, synth_objects


def test_votes_are_the_weights_of_a_direct_render():
    splats = oracle.scene(7, n=60)
    cameras = [oracle.camera(0.3), oracle.camera(-0.4)]
    rng = np.random.default_rng(1)
    masks = [rng.choice([0, 4, 70_000], (camera.height, camera.width)) for camera in cameras]
    votes = np.zeros((60, 3))
    for camera, mask in zip(cameras, masks, strict=True):
        weights = oracle.view(splats, camera).weights
        for column, label in enumerate((0, 4, 70_000)):
            votes[:, column] += weights[mask.ravel() == label].sum(axis=0)
    labels = labels_from_masks(splats, cameras, masks)
    ranked = np.sort(votes, axis=1)
    clear = ranked[:, 2] - ranked[:, 1] > 1e-4
    assert clear.sum() > 30
    expected = np.array([0, 4, 70_000])[votes.argmax(axis=1)]
    assert labels.dtype == np.uint32
    np.testing.assert_array_equal(labels[clear], expected[clear])


def test_unseen_splats_get_the_label_of_their_neighbours():
    splats = oracle.scene(8, n=200)
    camera = oracle.camera(width=30, height=30)
    left = np.zeros((30, 30), np.uint8)
    left[:, :15] = 9
    labels = labels_from_masks(splats, [camera], [left])
    seen = oracle.view(splats, camera).weights.max(axis=0) > 0
    assert 0 < (~seen).sum() < 200
    means = splats.means.astype(np.float64)
    for row in np.flatnonzero(~seen):
        nearest = np.argsort(np.linalg.norm(means[seen] - means[row], axis=1))[:5]
        around = labels[seen][nearest].tolist()
        assert labels[row] == max(set(around), key=around.count)


@pytest.mark.parametrize("threads", [1, 3])
def test_masks_of_two_objects_recover_their_labels(threads):
    splats, truth, cameras = synth(4000), synth_objects(4000), synth_cameras(12, 160, 120)
    truth = np.where(truth <= 2, truth, 0)
    labels = labels_from_masks(
        splats, cameras, synth_masks(splats, truth, cameras), threads=threads
    )
    assert (labels == truth).mean() >= 0.98
    for label in (1, 2):
        assert (labels[truth == label] == label).mean() >= 0.98


def test_invalid_masks_are_refused():
    splats, camera = oracle.scene(7, n=5), oracle.camera()
    mask = np.zeros((camera.height, camera.width), np.uint8)
    with pytest.raises(DataError) as caught:
        labels_from_masks(splats, [], [])
    assert caught.value.code == "no-cameras"
    with pytest.raises(DataError) as caught:
        labels_from_masks(splats, [oracle.camera(distance=-1e6)], [mask])
    assert caught.value.code == "cameras-see-nothing"
    with pytest.raises(ValueError, match="expected"):
        labels_from_masks(splats, [camera], [mask[1:]])
    many = synth(600_000 // 100)
    wide = oracle.camera(width=600, height=600)
    with pytest.raises(LimitError) as limited:
        labels_from_masks(many, [wide], [np.arange(360_000).reshape(600, 600)])
    assert limited.value.code == "mask-labels"
