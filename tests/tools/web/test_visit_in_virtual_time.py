"""A visit flies through a house in virtual time: its budget, its evictions and its memory."""

from __future__ import annotations

import json
import subprocess
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from running import installed

import cogsplat
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.lab.scheduling.chunk_ratios import weighted_ratios
from cogsplat.tools.lab.scheduling.index_ratios import IndexRatios
from cogsplat.tools.lab.scheduling.poses import Pose, predicted_poses
from cogsplat.tools.lab.scheduling.scene_rows import pages_in_file_order, scene_rows
from cogsplat.tools.lab.scheduling.scheduler import ClientState, Decision, Scheduler
from cogsplat.tools.lab.streaming.client import units_of
from cogsplat.tools.lab.streaming.visit_client import scheduled_units
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


def fly(package: Path, scene: Path, walk: Path, options: dict[str, object]) -> dict[str, Any]:
    """Return what a flight with the built npm package recorded."""
    done = subprocess.run(
        [
            *(installed("node"), "--expose-gc", str(FLY), str(package / "dist")),
            *(str(scene), str(walk), json.dumps(options)),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    found: dict[str, Any] = json.loads(done.stdout)
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
    found = fly(web_package, path, walk, options)
    assert budget >= found["most"] >= found["mostDrawn"] > 0.9 * budget
    assert found["decisions"] > 1000
    assert found["soonAgain"] > 0
    assert found["unneeded"] == 0
    # The first half minute compiles the program.
    first, *later = found["heapMb"][1:]
    assert len(later) == 3
    assert max(later) < first + 2


class Reference:
    """Units, ratios and decisions of the Python reference for a client of a file."""

    def __init__(self, file: CogsFile, pose: Pose, budget: int) -> None:
        self._units = units_of(file)
        self._budget, self._poses = budget, predicted_poses(pose, pose, 0.1)
        starts = (self._units.end - self._units.size_bytes).tolist()
        self._unit = {start: unit for unit, start in enumerate(starts)}
        rows = scene_rows(file.indices, file.parents())
        self._splats = rows.budget_splats
        self._contribution = rows.contribution.tolist()
        pages = [place.start for _, place in pages_in_file_order(file.indices)]
        self._row = {
            (start, int(rows.first_chunk[rows.chunks + k])): rows.chunks + k
            for k, start in enumerate(pages)
        }
        self._row |= {(-1, chunk): chunk for chunk in range(rows.chunks)}
        tables = {path: file.view_table(path) for path in file.view_table_rows}
        self._paths = {index.start: index.path for index in file.indices}
        self._ratios = IndexRatios(file.indices, {path: t for path, t in tables.items() if t})

    def row(self, place: list[int] | None) -> int:
        """Return the number of a row that the program recorded; -1 for none."""
        return -1 if place is None else self._row[place[0], place[1]]

    def check_units(self, arrived: list[int], entry: dict[str, Any]) -> None:
        """Compare the units, and what chunks and pages count in a budget."""
        present = [self._unit[start] for start in arrived]
        listed, expected = scheduled_units(self._units, present)
        read = {self._unit[start] for start in arrived} - set(listed)
        found = {self._unit[unit["start"]]: unit for unit in entry["units"]}
        assert set(found) - read == set(listed)
        for number, unit in zip(listed, expected, strict=True):
            dependencies = [self._unit[start] for start in found[number]["dependencies"]]
            assert self.row(found[number]["row"]) == unit.row
            assert found[number]["isHead"] == unit.is_head
            assert found[number]["gain"] == unit.gain
            assert found[number]["size"] == unit.size_bytes
            assert sorted(dependencies) == sorted(listed[k] for k in unit.dependencies)
        for place, splats in entry["splats"]:
            assert splats == self._splats[self.row(place)]

    def ratios(self, starts: list[int], arrived: list[int]) -> NDArray[np.float64]:
        """Return the ratio of each row along the predicted path.

        `starts` are those of the indices whose tables have arrived, `arrived` those of all units.
        """
        tables = {self._paths[start] for start in starts}
        read = {(), *(self._paths[start] for start in arrived if start in self._paths)}
        return weighted_ratios(lambda pose: self._ratios.at(pose, tables, read), self._poses)

    def decide(self, ratios: NDArray[np.float64], entry: dict[str, Any]) -> Decision:
        """Return the decision in a recorded state, for the units of the file."""
        arrived = [self._unit[start] for start in entry["arrived"]]
        listed, rows = scheduled_units(self._units, arrived)
        number = {unit: k for k, unit in enumerate(listed)}
        state = ClientState(
            frozenset(number[unit] for unit in arrived if unit in number),
            frozenset(number[self._unit[start]] for start in entry["inFlight"]),
            {number[self._unit[start]]: size for start, size in entry["received"]},
            self._budget,
            entry["bytesPerSecond"],
            entry["latency"],
            {self.row(place): worth for place, worth in entry["evictedWorths"]},
        )
        found = Scheduler(rows, self._splats, self._contribution).decide(ratios, state)
        stop, fetch = ([listed[k] for k in units] for units in (found.abort, found.fetch))
        return Decision(stop, found.evict, fetch)

    def check_decision(self, ratios: NDArray[np.float64], entry: dict[str, Any]) -> None:
        """Compare a decision."""
        decision = self.decide(ratios, entry)
        assert [self._unit[start] for start in entry["stop"]] == decision.abort
        assert [self._unit[start] for start in entry["fetch"]] == decision.fetch
        assert [self.row(place) for place in entry["evict"]] == list(decision.evict)


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_decisions_in_a_tree_of_pages_are_those_of_the_reference(
    paged_house: Path, web_package: Path, tmp_path: Path, share: float
) -> None:
    stand = poses()[60]
    walk = tmp_path / "poses.json"
    walk.write_text(json.dumps([stand, stand]), encoding="utf-8")
    with cogsplat.open(paged_house) as file:
        budget = int(share * file.root.splats)
        options = {
            "budget": budget,
            "seconds": 20,
            "bytesPerSecond": 50_000,
            "latency": 0.05,
            "heapSeconds": 30,
            "record": True,
        }
        found = fly(web_package, paged_house, walk, options)["recorded"]
        pose = Pose(
            np.array(stand["position"]),
            np.array(stand["rotation"]).reshape(3, 3),
            float(str(stand["tanX"])),
            float(str(stand["tanY"])),
        )
        reference = Reference(file, pose, budget)
        pages = 0
        for entry in found:
            if "units" in entry:
                reference.check_units(entry["arrived"], entry)
                pages += 1
            if "ratios" in entry:
                ratios = reference.ratios(entry["tables"], entry["arrived"])
                for place, ratio in entry["ratios"]:
                    assert ratio == ratios[reference.row(place)]
            reference.check_decision(ratios, entry)
    # The root, and the pages that this place needs.
    assert pages == 3
    assert len(found) > 30
