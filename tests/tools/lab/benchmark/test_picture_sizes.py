"""Comparison of drawings in pictures of several sizes and distances."""

import sys
from dataclasses import replace

import numpy as np
import pytest

import cogsplat
from cogsplat.codec.capture import capture_of_cameras
from cogsplat.codec.render.visible_depth import visible_depth
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.tools.lab.benchmark.picture_sizes import (
    AS_TRAINED,
    USUAL,
    drawing_rows,
    drawings,
    further_shots,
    main,
    mean_psnr,
    moved_back,
    smaller_shots,
)
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

CAMERAS = synth_cameras(4, 128, 96)


@pytest.fixture(scope="module")
def splats():
    return synth(600)


def test_a_camera_moves_back_from_what_it_shows(splats):
    camera = CAMERAS[0]
    depth = visible_depth(splats, camera)
    ahead = np.array([0.0, 0.0, depth])
    point = camera.rotation.T @ (ahead - camera.translation)
    further = moved_back(camera, 4, depth)
    shown = further.rotation @ point + further.translation
    np.testing.assert_allclose(shown, 4 * ahead, atol=1e-12)
    # Splats beside the picture do not count.
    few = splats.take(slice(0, 3))
    rays = np.array([[0.0, 0.0, 2.0], [0.1, 0.0, 5.0], [90.0, 0.0, 7.0]]) - camera.translation
    means = (rays @ camera.rotation).astype(np.float32)
    assert visible_depth(replace(few, means=means), camera) == pytest.approx(3.5, rel=1e-5)
    assert visible_depth(replace(few, means=means[[2, 2, 2]]), camera) == 0.0


def test_trained_thickness_shows_most_in_small_and_far_pictures(splats):
    capture = capture_of_cameras(CAMERAS)
    ways = drawings(splats.with_capture(capture), capture)
    assert ways[USUAL].info.capture == ()
    found = drawing_rows(splats, capture, CAMERAS[:2])
    rows = {row[0]: [float(cell) for cell in row[1:]] for row in found}
    assert [len(cells) for cells in rows.values()] == [6, 6, 6]
    others = np.max([rows[name] for name in rows if name != AS_TRAINED], axis=0)
    assert (rows[AS_TRAINED] > others).all()


def test_full_pictures_are_the_ground_truth(splats):
    assert mean_psnr(splats, smaller_shots(splats, CAMERAS[:1], 1)) == pytest.approx(100.0)
    assert mean_psnr(splats, further_shots(splats, CAMERAS[:1], 1)) == pytest.approx(100.0)


@pytest.mark.slow
def test_prefixes_are_drawn_both_ways(splats, tmp_path, monkeypatch, capsys):
    scene, cameras = tmp_path / "scene.ply", tmp_path / "cameras.json"
    cogsplat.write(splats, scene)
    write_cameras_json(CAMERAS, cameras)
    words = [scene, "--cameras", cameras, "--eval-every", 0, "--threads", 1]
    monkeypatch.setattr(sys, "argv", ["picture_sizes", *map(str, words)])
    main()
    lines = capsys.readouterr().out.splitlines()
    assert "4 views" in lines[0]
    rows = [line.split() for line in lines[-4:]]
    assert [row[0] for row in rows] == ["5%", "15%", "50%", "100%"]
    # The whole file, drawn as trained, is nearest to the source in smaller pictures.
    usual, trained = ([float(cell) for cell in rows[-1][at::3]] for at in (2, 4))
    assert min(np.subtract(trained, usual)[1:]) > 1
