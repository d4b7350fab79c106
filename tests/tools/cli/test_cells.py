"""Chunks cut by cells of space: what encode writes, info shows and others read."""

from pathlib import Path

import numpy as np
import pytest
from running import Run, SmallScene

import cogsplat
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.partition.nested_cells import parents


@pytest.fixture(scope="module")
def cells(small: SmallScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("cells") / "cells.cogs"
    config = EncodeConfig(cells=True, chunk_splats=64, prune=None)
    cameras = cogsplat.read_cameras(small.cameras)
    cogsplat.encode(cogsplat.read(small.ply), out, cameras=cameras, config=config, preset="fast")
    return out


def test_cells_stand_in_the_chunk_table(run: Run, cells: Path, small: SmallScene) -> None:
    chunks = run("info", cells, "--json").json["chunk_table"]
    assert isinstance(chunks, list)
    numbers = np.array([chunk["cell"] for chunk in chunks])
    assert numbers[0] == 1
    assert len(set(numbers.tolist())) > 3
    assert (parents(numbers)[1:] >= 0).all()
    assert max(chunk["splats"] for chunk in chunks) <= 64
    assert run("check", cells).code == 0
    assert " cell" in run("info", cells).out
    assert " cell" not in run("info", small.cogs).out


def test_info_tells_of_the_view_table(
    run: Run, cells: Path, small: SmallScene, tmp_path: Path
) -> None:
    with cogsplat.open(cells) as file:
        table = file.view_table()
    viewpoints = run("info", cells, "--json").json["viewpoints"]
    assert viewpoints == (0 if table is None else len(table.positions))
    assert run("info", small.cogs, "--json").json["viewpoints"] == 0
    assert "view table" not in run("info", small.cogs).out
    # A table takes half a percent at most: of few splats there is none. Views tell rooms apart.
    scene, cameras = tmp_path / "scene.ply", tmp_path / "scene.cameras.json"
    assert run("lab synth", scene, "--rooms", 4, "--splats", 8000).code == 0
    options = ["--cameras", cameras, "--cells", "--chunk-splats", 256, "--no-prune"]
    options += ["--preset", "fast"]
    with_table, without = tmp_path / "with.cogs", tmp_path / "without.cogs"
    assert run("encode", scene, with_table, *options).code == 0
    assert run("encode", scene, without, *options, "--no-view-table").code == 0
    assert run("info", with_table, "--json").json["viewpoints"] >= 4
    assert "viewpoints, " in run("info", with_table).out
    assert run("info", without, "--json").json["viewpoints"] == 0
    assert without.stat().st_size < with_table.stat().st_size
    assert run("check", with_table).code == 0


def test_the_command_writes_the_same_file_of_all_splats(
    run: Run, cells: Path, small: SmallScene, tmp_path: Path
) -> None:
    same = tmp_path / "same.cogs"
    options = ["--cameras", small.cameras, "--cells", "--chunk-splats", 64, "--no-prune"]
    assert run("encode", small.ply, same, *options, "--preset", "fast").code == 0
    assert same.read_bytes() == cells.read_bytes()
    one, other = cogsplat.decode(cells), cogsplat.read(small.ply)
    assert len(one) == len(other)
    for axis in range(3):
        close = np.sort(one.means[:, axis]) - np.sort(other.means[:, axis])
        assert np.abs(close).max() < 0.05 * np.ptp(one.means[:, axis])


def test_every_set_of_chunks_with_their_parents_decodes(cells: Path) -> None:
    with cogsplat.open(cells) as file:
        above = parents(file.chunks.cell)
        last = file.num_chunks - 1
        chain = [last]
        while above[chain[-1]] >= 0:
            chain.append(int(above[chain[-1]]))
        splats = file.decode(sorted(chain))
        assert len(splats) == int(file.chunks.splats[chain].sum())
        box = file.chunks.box[last]
        part = file.decode([last])
        assert (part.means >= box[:3]).all()
        assert (part.means <= box[3:]).all()


@pytest.mark.parametrize("more", [["--objects"], ["--chunk-splats", 1]])
def test_what_cells_do_not_go_with_is_misuse(
    run: Run, small: SmallScene, tmp_path: Path, more: list[object]
) -> None:
    out = tmp_path / "out.cogs"
    told = run("encode", small.ply, out, "--cameras", small.cameras, "--cells", *more)
    assert told.code == 2
    assert "cell" in told.err
    assert not out.exists()
