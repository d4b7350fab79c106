"""Coarse heads and refinements from the command line."""

from pathlib import Path

import numpy as np
from running import Run, SmallScene

import cogsplat


def test_heads_are_fine_where_asked_and_read_alone_where_asked(
    run: Run, tmp_path: Path, small: SmallScene
) -> None:
    files = {}
    for name, more in (("coarse", []), ("fine", ["--no-refine"])):
        out = files[name] = tmp_path / f"{name}.cogs"
        told = run(
            "encode", small.ply, out, "--cameras", small.cameras, "--order", "contribution",
            "--quality", 45, "--no-compensation", "--quiet", *more,
        )  # fmt: skip
        assert (told.code, told.err) == (0, "")
    kinds = {}
    for name, path in files.items():
        told = run("info", path, "--json")
        assert told.code == 0
        chunks = told.json["chunk_table"]
        assert isinstance(chunks, list)
        kinds[name] = [chunk["refinement_bytes"] for chunk in chunks]
    assert any(kinds["coarse"])
    assert not any(kinds["fine"])
    assert "finer B" in run("info", files["coarse"]).out

    whole = tmp_path / "whole.ply"
    heads = tmp_path / "heads.ply"
    assert run("decode", files["coarse"], whole, "--json").json["chunks_unrefined"] == []
    assert run("decode", files["coarse"], heads, "--no-refine", "--quiet").code == 0
    splats, coarse = cogsplat.read(whole), cogsplat.read(heads)
    assert len(splats) == len(coarse)
    assert not np.array_equal(splats.sh0, coarse.sh0)
    part = run("decode", files["coarse"], tmp_path / "part.ply", "--bytes", "60%", "--json")
    assert part.code == 0
    assert set(part.json) >= {"chunks_unrefined", "chunks_without_tails"}
