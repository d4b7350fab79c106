from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.views.view_clusters import view_clusters
from cogsplat.tools.lab.synthetic.terrace import synth_cameras

SCENE = np.random.default_rng(3).normal(size=(100, 3))


def moved(camera, by):
    return replace(camera, translation=camera.translation - camera.rotation @ by)


def test_groups_of_cameras_are_found():
    rng = np.random.default_rng(2)
    middles = synth_cameras(5)
    cameras = [moved(middles[k % 5], 0.01 * rng.normal(size=3)) for k in range(40)]
    clusters = view_clusters(cameras, SCENE, 5)
    assert sorted(cluster.tolist() for cluster in clusters) == [
        list(range(k, 40, 5)) for k in range(5)
    ]


@pytest.mark.parametrize("count", [1, 4, 12, 100])
def test_every_camera_is_in_one_cluster(count):
    cameras = synth_cameras(12)
    clusters = view_clusters(cameras, SCENE, count)
    assert len(clusters) == min(count, 12)
    assert sorted(np.concatenate(clusters).tolist()) == list(range(12))


def test_cameras_at_one_position_are_clustered_by_direction():
    camera = synth_cameras(1)[0]
    turn = np.diag([-1.0, 1.0, -1.0])
    back = replace(camera, rotation=turn @ camera.rotation, translation=turn @ camera.translation)
    assert [c.tolist() for c in view_clusters([camera, back, camera], SCENE, 2)] == [[0, 2], [1]]
    # Three equal cameras still make three clusters.
    assert len(view_clusters([camera] * 3, SCENE, 3)) == 3


def test_each_cluster_is_near_the_one_before():
    cameras = [moved(synth_cameras(1)[0], np.array([x, 0.0, 0.0])) for x in (0, 3, 1, 2, 4)]
    clusters = view_clusters(cameras, SCENE, 5)
    assert [c.tolist() for c in clusters] == [[0], [2], [3], [1], [4]]
