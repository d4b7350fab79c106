"""Streamed SOG's client: which files it asks for, in which order, and what it draws of them."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import FormatError
from cogsplat.codec.splats import Splats
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.formats.scenes.sog.sog_scene import write_sog
from cogsplat.tools.lab.streaming.client import Link, simulate_fetch
from cogsplat.tools.lab.streaming.comparison import PEER, Simulation
from cogsplat.tools.lab.streaming.streamed_sog import StreamedSogClient, streamed_sog_client
from cogsplat.tools.lab.streaming.traces import recorded_trace
from cogsplat.tools.lab.synthetic.rooms import rooms_cameras, synth_rooms

# Leaves of a row along z, a unit each, seen from before the first one; each has three levels.
LEAVES = 3
COUNTS = (40, 20, 10)
EYE = Camera(
    width=64,
    height=48,
    fx=40.0,
    fy=40.0,
    cx=32.0,
    cy=24.0,
    rotation=np.eye(3),
    translation=np.zeros(3),
    name="eye",
)


def moved(z: float, *, turned: bool = False) -> Camera:
    rotation = np.diag([-1.0, 1.0, -1.0]) if turned else np.eye(3)
    return replace(EYE, rotation=rotation, translation=-rotation @ np.array([0.0, 0.0, z]))


SOURCE = synth_rooms(1, 20_000, sh_degree=0)


def scene_of(count: int, seed: int) -> Splats:
    return SOURCE.take(np.random.default_rng(seed).choice(20_000, count, replace=False))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a file for each leaf and level, of which a level's first has number
    3 × level."""
    root = tmp_path_factory.mktemp("streamed")
    leaves = []
    names = [f"{level}_{n}/meta.json" for level in range(len(COUNTS)) for n in range(LEAVES)]
    for number, name in enumerate(names):
        (root / name).parent.mkdir()
        write_sog(scene_of(COUNTS[number // LEAVES], number), root / name)
    (root / "env").mkdir()
    write_sog(scene_of(5, 99), root / "env/meta.json")
    for n in range(LEAVES):
        lods = {
            str(level): {"file": LEAVES * level + n, "offset": 0, "count": count}
            for level, count in enumerate(COUNTS)
        }
        bound = {"min": [-1, -1, 10.0 + n], "max": [1, 1, 11.0 + n]}
        leaves.append({"bound": bound, "lods": lods})
    content = {"version": 1, "lodLevels": len(COUNTS), "filenames": names}
    content |= {"tree": {"children": leaves}}
    (root / "lod-meta.json").write_text(json.dumps(content))
    (root / "with-env.json").write_text(json.dumps(content | {"environment": "env/meta.json"}))
    return root


@pytest.fixture(scope="module")
def client(folder: Path) -> StreamedSogClient:
    return streamed_sog_client(folder / "lod-meta.json")


def test_units_are_the_files_with_all_their_bytes(folder: Path, client: StreamedSogClient) -> None:
    sizes = [
        sum(path.stat().st_size for path in (folder / f"{level}_{n}").iterdir())
        for level in range(len(COUNTS))
        for n in range(LEAVES)
    ]
    assert client.units.size_bytes.tolist() == sizes
    assert client.units.index_bytes == (folder / "lod-meta.json").stat().st_size
    assert [len(client.scene.means[rows]) for rows in client.rows] == np.repeat(COUNTS, 3).tolist()


def test_coarsest_files_come_first_then_the_finest_of_what_is_near(
    client: StreamedSogClient,
) -> None:
    trace = recorded_trace([moved(0.0)], 1.0)
    came = simulate_fetch(client.units, trace, Link(1e6, 0.0), client.priorities)
    # The budget allows the finest level everywhere, so level 1 is never fetched.
    assert came.units == [6, 7, 8, 0, 1, 2]


def test_what_is_behind_counts_as_far(client: StreamedSogClient) -> None:
    # Between the second leaf and the third, nearer to the second, looking at the third or back.
    ahead, back = client.priorities(moved(12.4 - 0.5)), client.priorities(moved(11.6, turned=True))
    assert ahead[1] > ahead[2] > ahead[0]
    assert back[1] > back[0] > back[2]


@pytest.mark.parametrize(
    ("budget", "levels"),
    [
        # The coarsest level has 30 splats, each refinement of a leaf 10 more, then 20 more.
        (1, [2, 2, 2]),
        (39, [2, 2, 2]),
        (40, [1, 2, 2]),
        (60, [1, 1, 1]),
        (80, [0, 1, 1]),
        (120, [0, 0, 0]),
    ],
)
def test_a_budget_refines_the_nearest_leaves(folder: Path, budget: int, levels: list[int]) -> None:
    # The far end is 12 away, the near one 10: less than a level's reach apart.
    client = streamed_sog_client(folder / "lod-meta.json", budget)
    requested = client.priorities(moved(0.0)) > 0.0
    expected = {3 * level + n for n, level in enumerate(levels)} | {6, 7, 8}
    assert set(np.flatnonzero(requested).tolist()) == expected


def test_each_leaf_draws_one_level_at_a_time(client: StreamedSogClient) -> None:
    pose = moved(0.0)

    def counts(there: list[int]) -> int:
        return len(client.splats_of(there, pose))

    assert counts([]) == 0
    assert counts([6, 7]) == 20
    assert counts([6, 7, 0]) == 50
    # A leaf without its target level shows the next coarser one.
    assert counts([6, 3]) == 20
    assert counts(list(range(9))) == 120
    splats = client.splats_of([1, 8], pose)
    expected = np.concatenate([client.scene.means[client.rows[k]] for k in (1, 8)])
    np.testing.assert_array_equal(splats.means, expected)


def test_a_finer_level_stays_where_a_coarser_one_would_do(folder: Path) -> None:
    client = streamed_sog_client(folder / "lod-meta.json", 1)
    assert len(client.splats_of([0, 8], moved(0.0))) == COUNTS[0] + COUNTS[2]


def test_an_environment_comes_first_and_is_always_drawn(folder: Path) -> None:
    client = streamed_sog_client(folder / "with-env.json")
    assert int(np.argmax(client.priorities(moved(0.0)))) == len(client.units) - 1
    assert len(client.splats_of([9], moved(0.0))) == 5
    assert len(client.splats_of([9, 6], moved(0.0))) == 15


def test_files_may_have_sh_of_other_degrees(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "env").mkdir()
    for name in ("0_0", "1_0"):
        shutil.copytree(folder / name, tmp_path / name)
    write_sog(synth_rooms(1, 20_000, sh_degree=1).take(slice(0, 5)), tmp_path / "env/meta.json")
    runs = {str(k): {"file": k, "offset": 0, "count": COUNTS[k]} for k in range(2)}
    content = {"version": 1, "lodLevels": 2, "filenames": ["0_0/meta.json", "1_0/meta.json"]}
    content |= {"environment": "env/meta.json"}
    content |= {"tree": {"bound": {"min": [0, 0, 0], "max": [1, 1, 1]}, "lods": runs}}
    path = tmp_path / "lod-meta.json"
    path.write_text(json.dumps(content))
    scene = streamed_sog_client(path).scene
    assert scene.sh_degree == 1
    assert not scene.shN[:60].any()
    assert scene.shN[60:].any()


def test_leaves_that_name_more_than_a_file_has_are_refused(folder: Path) -> None:
    content = json.loads((folder / "lod-meta.json").read_text())
    content["tree"]["children"][1]["lods"]["2"]["offset"] = 1
    (folder / "beyond.json").write_text(json.dumps(content))
    with pytest.raises(FormatError, match="leaf 1 ends at splat 11 of 2_1, expected"):
        streamed_sog_client(folder / "beyond.json")


def test_leaves_without_a_level_take_the_next_finer_or_are_left_out(folder: Path) -> None:
    content = json.loads((folder / "lod-meta.json").read_text())
    first, second, third = content["tree"]["children"]
    del first["lods"]["1"], second["lods"]["2"], third["lods"]["0"]
    (folder / "holes.json").write_text(json.dumps(content))
    client = streamed_sog_client(folder / "holes.json", 60)
    # The second leaf has nothing at the coarsest level, where it is left out: 20 splats. Then come
    # level 1 of the second and the third, 20 and 10 more; the first one's is its finest, 30 more.
    requested = np.flatnonzero(client.priorities(moved(0.0)) > 0.0).tolist()
    assert requested == [0, 6, 8]
    everything = np.flatnonzero(
        streamed_sog_client(folder / "holes.json").priorities(moved(0.0)) > 0.0
    ).tolist()
    assert everything == [0, 1, 5, 6, 8]


def test_a_simulation_compares_it_over_the_same_link(house_file: CogsFile, folder: Path) -> None:
    views = [c.downscaled(8) for c in rooms_cameras(4, views=2)]
    source = synth_rooms(4, 5000, sh_degree=1)
    peer = streamed_sog_client(folder / "lod-meta.json")
    simulation = Simulation(house_file, views, threads=1, source=source, peer=peer)
    trace = recorded_trace(views[:2], 1.0)
    seen = simulation.run_trace(trace, Link(1e6, 0.0), ["file", PEER], 2)
    assert seen[PEER][-1].bytes <= int(peer.units.size_bytes.sum())
    # Of the file, all that is missing is what was lost when it was encoded.
    assert 20.0 < seen["file"][-1].psnr_db < 100.0
    assert seen[PEER][-1].psnr_db < seen["file"][-1].psnr_db
    assert len(simulation.at_rest(views[:1], [PEER])[PEER]) == 4


def test_without_another_file_there_is_no_client_of_it(house_file: CogsFile) -> None:
    views = rooms_cameras(4, views=2)[:2]
    with pytest.raises(ValueError, match="no other file"):
        Simulation(house_file, views, threads=1).client(PEER)
