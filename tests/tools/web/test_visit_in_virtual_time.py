"""A visit flies through a house in virtual time: its budget, its evictions and its memory."""

from __future__ import annotations

import json
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from running import installed

import cogsplat
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.tools.lab.synthetic.rooms import rooms_cameras, rooms_walk, synth_rooms

pytestmark = pytest.mark.slow

ROOMS, SPLATS = 6, 36_000
FLY = Path(__file__).parent / "fly_house.mjs"
POSES_PER_STEP = 4
"""Poses, a tenth of a second apart, from one camera of the walk to the next: 1.25 m/s at most."""


def poses() -> list[dict[str, object]]:
    """Return the walk through the house, one pose per tenth of a second."""
    cameras = rooms_walk(ROOMS)
    found: list[dict[str, object]] = []
    for camera, following in pairwise(cameras):
        for share in np.arange(POSES_PER_STEP) / POSES_PER_STEP:
            left, _, right = np.linalg.svd(
                (1 - share) * camera.rotation + share * following.rotation
            )
            places = [-c.rotation.T @ c.translation for c in (camera, following)]
            position = (1 - share) * places[0] + share * places[1]
            found.append(
                {
                    "position": position.tolist(),
                    "rotation": (left @ right).ravel().tolist(),
                    "tanX": camera.width / (2 * camera.fx),
                    "tanY": camera.height / (2 * camera.fy),
                }
            )
    return found


def test_budget_holds_at_every_decision_and_nothing_is_fetched_again_without_need(
    web_package: Path, tmp_path: Path
) -> None:
    path, walk = tmp_path / "house.cogs", tmp_path / "poses.json"
    config = EncodeConfig(cells=True, chunk_splats=512, order="contribution")
    scene = synth_rooms(ROOMS, SPLATS, sh_degree=1)
    cogsplat.encode(scene, path, cameras=rooms_cameras(ROOMS, views=3), config=config)
    walk.write_text(json.dumps(poses()), encoding="utf-8")
    budget = len(cogsplat.decode(path)) // 3
    options = {
        "budget": budget,
        "seconds": 150,
        "bytesPerSecond": 625_000,
        "latency": 0.05,
        "heapSeconds": 30,
    }
    done = subprocess.run(
        [
            *(installed("node"), "--expose-gc", str(FLY), str(web_package / "dist")),
            *(str(path), str(walk), json.dumps(options)),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    found = json.loads(done.stdout)
    assert budget >= found["most"] >= found["mostDrawn"] > 0.9 * budget
    assert found["decisions"] > 1000
    assert found["soonAgain"] > 0
    assert found["unneeded"] == 0
    # The first half minute compiles the program.
    first, *later = found["heapMb"][1:]
    assert len(later) == 3
    assert max(later) < first + 2
