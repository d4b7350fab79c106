"""Streamed SOG's index: what its leaves name, and what is refused."""

import json
from pathlib import Path
from typing import Any

import pytest

from cogsplat.codec.errors import FormatError, LimitError, UnsupportedError
from cogsplat.formats.scenes.sog.lod_meta import read_lod_meta
from cogsplat.formats.storage.limits import Limits

Json = dict[str, Any]


def leaf(low: float, high: float, **lods: list[int]) -> Json:
    runs = {
        name.removeprefix("level"): dict(zip(("file", "offset", "count"), run, strict=True))
        for name, run in lods.items()
    }
    return {"bound": {"min": [low, 0, 0], "max": [high, 1, 2]}, "lods": runs}


def index(**changes: object) -> Json:
    near = leaf(0, 1, level0=[0, 0, 70], level1=[1, 0, 20])
    far = leaf(1, 2, level0=[0, 70, 30], level1=[1, 20, 0])
    inner = {"bound": {"min": [0, 0, 0], "max": [2, 1, 2]}, "children": [near, far]}
    outer = {"bound": {"min": [0, 0, 0], "max": [9, 1, 2]}, "children": [inner, leaf(8, 9)]}
    found = {
        "version": 1,
        "count": 120,
        "counts": [100, 20],
        "lodLevels": 2,
        "filenames": ["0_0/meta.json", "1_0/meta.json"],
        "tree": outer,
    }
    return {**found, **changes}


def written(folder: Path, content: object) -> Path:
    path = folder / "lod-meta.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def test_leaves_name_runs_of_each_level(tmp_path: Path) -> None:
    path = written(tmp_path, index())
    found = read_lod_meta(path)
    assert found.files == [tmp_path / "0_0/meta.json", tmp_path / "1_0/meta.json"]
    assert found.environment is None
    assert found.boxes.tolist() == [[0, 0, 0, 1, 1, 2], [1, 0, 0, 2, 1, 2], [8, 0, 0, 9, 1, 2]]
    # A level without splats, named or not, has no file.
    assert found.file.tolist() == [[0, 1], [0, -1], [-1, -1]]
    assert found.start.tolist() == [[0, 0], [70, 0], [0, 0]]
    assert found.count.tolist() == [[70, 20], [30, 0], [0, 0]]
    assert found.size_bytes == path.stat().st_size


def test_an_environment_is_a_file_of_its_own(tmp_path: Path) -> None:
    found = read_lod_meta(written(tmp_path, index(environment="env/meta.json")))
    assert found.environment == tmp_path / "env/meta.json"


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"version": 2}, "sog-version"),
        ({"lodLevels": 0}, "sog-bad-levels"),
        ({"lodLevels": 65}, "sog-bad-levels"),
        ({"filenames": ["../meta.json", "b"]}, "sog-file-name"),
        ({"environment": "/env/meta.json"}, "sog-file-name"),
        ({"filenames": ["0_0/meta.json"]}, "sog-bad-levels"),
        ({"tree": {"bound": {"min": [0, 0, 0], "max": [1, 1, 1]}}}, "sog-bad-levels"),
        ({"tree": leaf(0, 1, level0=[0, -1, 5])}, "sog-bad-levels"),
        ({"tree": {"lods": {}}}, "sog-bad-levels"),
        ({"tree": {"children": []}}, "sog-bad-levels"),
        ({"filenames": []}, "sog-bad-levels"),
    ],
)
def test_what_no_index_says_is_refused(tmp_path: Path, changes: Json, code: str) -> None:
    path = written(tmp_path, index(**changes))
    with pytest.raises((FormatError, UnsupportedError)) as caught:
        read_lod_meta(path)
    assert caught.value.code == code
    assert "lod-meta.json" in str(caught.value)


def test_invalid_or_long_json_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "lod-meta.json"
    path.write_bytes(b"{")
    with pytest.raises(FormatError) as broken:
        read_lod_meta(path)
    assert broken.value.code == "sog-bad-levels"
    written(tmp_path, index())
    for size, code in ((100, "sog-file-too-large"), (path.stat().st_size, "json-too-long")):
        with pytest.raises(LimitError) as caught:
            read_lod_meta(path, limits=Limits(small_bytes=size))
        assert caught.value.code == code
