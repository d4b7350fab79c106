"""Commands on files with levels and with chunks that end."""

import numpy as np
import pytest
from levelled import levelled_file

import cogsplat


@pytest.fixture
def cogs(tmp_path):
    path = tmp_path / "levels.cogs"
    path.write_bytes(levelled_file())
    return path


@pytest.mark.parametrize("level", ["0", "1", "1.25", "2"])
def test_decode_takes_a_level(run, cogs, level):
    out = cogs.with_suffix(".ply")
    assert run("decode", cogs, out, "--level", level).code == 0
    expected = cogsplat.decode(cogs, level=float(level))
    found = cogsplat.read(out)
    for name in ("means", "scales", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_decode_refuses_levels_that_are_not_there_and_parts_beside_them(run, cogs):
    out = cogs.with_suffix(".ply")
    beyond = run("decode", cogs, out, "--level", "2.5")
    assert beyond.code == 2
    assert "--level 2.5, expected 0 to 2" in beyond.err
    for part in (["--chunks", "0:1"], ["--bytes", "50%"], ["--compensate"]):
        assert run("decode", cogs, out, "--level", "1", *part).code == 2
    with pytest.raises(ValueError, match="level"):
        cogsplat.decode(cogs, level=1, splats=10)


def test_info_tells_levels_and_ends(run, cogs):
    told = run("info", cogs).out
    assert "1/4 of 2 chunks, 1/2 of 4 chunks, 1/1 of 6 chunks" in told
    with cogsplat.open(cogs) as file:
        ended = int(file.chunks.splats[1:3].sum())
    assert f"2 chunks of {ended:,} splats, drawn in prefixes only" in told
    report = run("info", cogs, "--json").json
    assert [level["chunks"] for level in report["levels"]] == [2, 4, 6]
    assert [chunk["until"] for chunk in report["chunk_table"]] == [0, 4, 6, 0, 0, 0]
    assert {"opacities"} <= {size["segment"] for size in report["attributes"]}


def test_a_file_with_levels_is_valid(run, cogs):
    assert run("check", cogs).code == 0
