"""Generate the test vectors of docs/streaming.md: decisions, and what makes splats grow.

Run ``python -m cogsplat.tools.lab.make_decisions`` after every change of docs/streaming.md, and
commit the file it writes. The Python and TypeScript implementations are both tested against it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final, TypedDict

import numpy as np

from cogsplat.codec.geometry.rotations import matrices
from cogsplat.codec.partition.nested_cells import parents
from cogsplat.codec.segments.view_shares import ViewTable
from cogsplat.tools.lab.scheduling import chunk_ratios
from cogsplat.tools.lab.scheduling.growth import growth, missing_splats
from cogsplat.tools.lab.scheduling.poses import Pose, predicted_poses
from cogsplat.tools.lab.scheduling.scheduler import ClientState, Decision, Scheduler, Unit

DECISIONS: Final = (
    Path(__file__).resolve().parents[2]
    / "tests"
    / "tools"
    / "lab"
    / "scheduling"
    / "decisions.json"
)
RULES: Final = ("views", "boxes", "sgss")
_SCENES: Final = 30
_STATES: Final = 40
_TREES: Final = 30


class Scene(TypedDict):
    """Scene of the test vectors.

    A unit is a tuple of chunk, head flag, gain, size in bytes and dependencies.
    """

    boxes: list[list[float]]
    contribution: list[float]
    splats: list[int]
    units: list[tuple[int, int, float, int, list[int]]]
    positions: list[list[float]]
    codes: list[list[int]]


class State(TypedDict):
    """State of a client, its poses and the expected decision.

    A pose is a position, a rotation in row-major order and two tangents. A decision is the lists of
    aborted units, evicted chunks and fetched units; `worths` are those of the evicted chunks.
    """

    scene: int
    rule: str
    now: list[float]
    before: list[float]
    elapsed: float
    there: list[int]
    under_way: list[int]
    received: list[tuple[int, int]]
    budget_splats: int
    bytes_per_second: float
    latency: float
    evicted: list[tuple[int, float]]
    decision: list[list[int]]
    worths: list[float]


class Tree(TypedDict):
    """Rows held of a tree, what is missing at each row, and the growth of splats of row 0.

    `boxes` are those of the children of row 0.
    """

    held: list[int]
    parents: list[int]
    splats: list[int]
    missing: list[int]
    boxes: list[list[float]]
    means: list[list[float]]
    growth: list[float]


def ratios_of(scene: Scene, rule: str) -> chunk_ratios.PoseValues:
    """Return the ratio function of a scene for a rule of `RULES`."""
    boxes = np.array(scene["boxes"], np.float64)
    contribution = np.array(scene["contribution"], np.float64)
    if rule == "sgss":
        return chunk_ratios.sgss_priorities(boxes, np.array(scene["splats"], np.float64))
    if rule == "boxes":
        return chunk_ratios.ratios_from_boxes(boxes, contribution)
    table = ViewTable(np.array(scene["positions"], np.float32), np.array(scene["codes"], np.uint8))
    return chunk_ratios.ratios_from_view_table(table, boxes, contribution)


def decide(scene: Scene, state: State) -> Decision:
    """Return the scheduler's decision in a state."""
    units = [Unit(c, bool(head), gain, size, tuple(a)) for c, head, gain, size, a in scene["units"]]
    client = ClientState(
        frozenset(state["there"]),
        frozenset(state["under_way"]),
        dict(state["received"]),
        state["budget_splats"],
        state["bytes_per_second"],
        state["latency"],
        dict(state["evicted"]),
    )
    poses = predicted_poses(_pose(state["now"]), _pose(state["before"]), state["elapsed"])
    ratios = chunk_ratios.weighted_ratios(ratios_of(scene, state["rule"]), poses)
    return Scheduler(units, scene["splats"], scene["contribution"]).decide(ratios, client)


def grow(tree: Tree) -> tuple[list[int], list[float]]:
    """Return the missing splats at each row of a tree, and the growth of the splats of row 0."""
    above = np.array(tree["parents"], np.int64)
    is_held = np.isin(np.arange(len(above)), tree["held"])
    missing = missing_splats(is_held, above, np.array(tree["splats"], np.int64))
    means = np.array(tree["means"], np.float32)
    boxes = np.array(tree["boxes"], np.float32).astype(np.float64)
    return missing.tolist(), growth(means, boxes, missing[above == 0]).tolist()


def generate() -> tuple[list[Scene], list[State], list[Tree]]:
    """Generate scenes, states and trees from a fixed seed."""
    rng = np.random.default_rng(16)
    scenes = [_scene(rng) for _ in range(_SCENES)]
    states = []
    for number, scene in enumerate(scenes):
        for turn in range(_STATES):
            state = _state(rng, number, scene, RULES[turn % len(RULES)] if turn % 2 else "views")
            decision = decide(scene, state)
            state["decision"] = [decision.abort, list(decision.evict), decision.fetch]
            state["worths"] = list(decision.evict.values())
            states.append(state)
    trees = [_tree(rng) for _ in range(_TREES)]
    for tree in trees:
        tree["missing"], tree["growth"] = grow(tree)
    return scenes, states, trees


def text() -> str:
    """Return the test vectors as JSON, one scene, state or tree per line."""
    parts = []
    scenes, states, trees = generate()
    named: dict[str, list[Scene] | list[State] | list[Tree]] = {
        "scenes": scenes,
        "states": states,
        "trees": trees,
    }
    for name, entries in named.items():
        lines = ",\n".join(json.dumps(entry, separators=(",", ":")) for entry in entries)
        parts.append(f'"{name}": [\n{lines}\n]')
    return "{\n" + ",\n".join(parts) + "\n}\n"


def _pose(numbers: list[float]) -> Pose:
    values = np.array(numbers, np.float64)
    return Pose(values[:3], values[3:12].reshape(3, 3), float(values[12]), float(values[13]))


def _rounded(values: object, digits: int) -> list[float]:
    return [round(float(x), digits) for x in np.asarray(values, np.float64).ravel()]


def _scene(rng: np.random.Generator) -> Scene:
    chunks = int(rng.integers(3, 11))
    low = rng.uniform(-8.0, 8.0, (chunks, 3))
    boxes = np.concatenate([low, low + rng.uniform(0.0, 6.0, (chunks, 3))], axis=1)
    cells = np.concatenate([[1], rng.integers(1, 8, chunks - 1)])
    above = parents(cells)
    shares = _rounded(rng.uniform(0.0, 9.0, chunks) * (rng.random(chunks) > 0.1), 2)
    views = int(rng.integers(1, 6))
    codes = rng.integers(225, 255, (views, chunks)) * (rng.random((views, chunks)) > 0.3)
    return {
        "boxes": [_rounded(box, 2) for box in boxes],
        "contribution": shares,
        "splats": rng.integers(10, 400, chunks).tolist(),
        "units": _units(rng, above.tolist(), shares),
        "positions": [_rounded(position, 2) for position in rng.uniform(-6.0, 6.0, (views, 3))],
        "codes": codes.tolist(),
    }


def _units(
    rng: np.random.Generator, above: list[int], contribution: list[float]
) -> list[tuple[int, int, float, int, list[int]]]:
    """Return units of a file: a codebook, then heads, each followed by refinements of chunks."""
    rows: list[tuple[int, int, list[int]]] = [(-1, 0, [])]
    heads: dict[int, int] = {}
    later: list[int] = []
    for chunk, parent in enumerate(above):
        heads[chunk] = len(rows)
        rows.append((chunk, 1, [] if parent < 0 else [heads[parent]]))
        later += [chunk] * int(rng.integers(0, 3))
        while later and rng.random() < 0.5:
            owner = later.pop(int(rng.integers(len(later))))
            rows.append((owner, 0, [heads[owner], *([0] if rng.random() < 0.4 else [])]))
    gains: dict[int, float] = {}
    units = []
    for chunk, head, dependencies in rows:
        size = int(rng.integers(100, 5000))
        if head:
            gain = gains[chunk] = contribution[chunk]
        else:
            gain = gains.get(chunk, 0.0) * round(float(rng.random()), 3)
        units.append((chunk, head, gain, size, dependencies))
    return units


def _state(rng: np.random.Generator, number: int, scene: Scene, rule: str) -> State:
    units = scene["units"]
    position = rng.uniform(-7.0, 7.0, 3)
    quats = rng.normal(size=(2, 4))
    quats[1] = quats[0] + 0.1 * quats[1]
    quats /= np.sqrt((quats * quats).sum(axis=1, keepdims=True))
    rotations = matrices(quats)
    tangents = rng.uniform(0.3, 1.4, 2)
    moved = position - 0.2 * rng.normal(size=3)
    # Every present unit has its dependencies.
    there: set[int] = set()
    for unit, (_, _, _, _, dependencies) in enumerate(units):
        if rng.random() < 0.55 and there.issuperset(dependencies):
            there.add(unit)
    missing = [unit for unit in range(len(units)) if unit not in there]
    under_way = [unit for unit in missing if rng.random() < 0.3]
    received = [
        (unit, int(rng.integers(0, units[unit][3]))) for unit in missing if rng.random() < 0.4
    ]
    heads = {row[0] for unit, row in enumerate(units) if row[1] and unit in {*there, *under_way}}
    used = sum(scene["splats"][chunk] for chunk in heads)
    budget = 0 if rng.random() < 0.4 else int(used * rng.uniform(0.9, 1.3)) + 1
    evicted = [
        (row[0], float(rng.uniform(0.0, 8.0)) / scene["splats"][row[0]])
        for row in units
        if row[1] and row[0] not in heads and rng.random() < 0.5
    ]
    return {
        "scene": number,
        "rule": rule,
        "now": [*_rounded(position, 3), *_rounded(rotations[0], 4), *_rounded(tangents, 2)],
        "before": [*_rounded(moved, 3), *_rounded(rotations[1], 4), *_rounded(tangents, 2)],
        "elapsed": round(float(rng.uniform(0.0, 1.0)) * float(rng.random() > 0.1), 3),
        "there": sorted(there),
        "under_way": under_way,
        "received": received,
        "budget_splats": budget,
        "bytes_per_second": float(rng.integers(4000, 80000)),
        "latency": round(float(rng.uniform(0.0, 0.2)), 3),
        "evicted": evicted,
        "decision": [],
        "worths": [],
    }


def _tree(rng: np.random.Generator) -> Tree:
    rows = int(rng.integers(3, 9))
    above = [-1, 0, *(int(rng.integers(0, row)) for row in range(2, rows))]
    held = [0]
    held += [row for row in range(1, rows) if above[row] in held and rng.random() < 0.4]
    low = rng.uniform(-4.0, 2.0, (above.count(0), 3))
    high = low + rng.uniform(1.0, 6.0, low.shape)
    return {
        "held": held,
        "parents": above,
        "splats": (rng.integers(0, 3000, rows) * (rng.random(rows) > 0.2)).tolist(),
        "missing": [],
        "boxes": [_rounded(box, 2) for box in np.concatenate([low, high], axis=1)],
        "means": [_rounded(mean, 2) for mean in rng.uniform(-4.0, 6.0, (12, 3))],
        "growth": [],
    }


def main() -> None:
    """Write `DECISIONS`."""
    DECISIONS.write_text(text(), encoding="utf-8")


if __name__ == "__main__":
    main()
