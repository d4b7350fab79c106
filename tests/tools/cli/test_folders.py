"""COGS folders: `convert` from a file and back, and other commands on them."""

import json
from pathlib import Path

import pytest
from running import Run, SmallScene


@pytest.fixture
def folder(run: Run, small: SmallScene, tmp_path: Path) -> Path:
    assert run("convert", small.cogs, f"{tmp_path}/scene/").code == 0
    return tmp_path / "scene"


def test_a_file_goes_and_comes_back(
    run: Run, small: SmallScene, folder: Path, tmp_path: Path
) -> None:
    again = run("convert", small.cogs, folder / "second.cogsm", "--json").json
    count = len(list((folder / "segments").iterdir()))
    assert (again["objects_written"], again["objects_shared"]) == (0, count)
    assert again["bytes"] == (folder / "second.cogsm").stat().st_size
    assert again["segments"] > count
    packed = run("convert", folder, tmp_path / "back.cogs", "--json").json
    assert packed["bytes"] == small.cogs.stat().st_size
    assert (tmp_path / "back.cogs").read_bytes() == small.cogs.read_bytes()
    assert "there already" in run("convert", small.cogs, folder, "--force").out


def test_other_commands_read_folders(
    run: Run, small: SmallScene, folder: Path, tmp_path: Path
) -> None:
    out = [tmp_path / "a.ply", tmp_path / "b.ply"]
    assert run("decode", small.cogs, out[0]).code == 0
    assert run("decode", folder, out[1]).code == 0
    assert out[0].read_bytes() == out[1].read_bytes()
    told = run("info", folder, "--json").json
    assert told["bytes"] == small.cogs.stat().st_size
    assert run("check", folder / "manifest.cogsm").code == 0
    assert run("info", folder, "--statistics").code == 0
    assert run("convert", folder, tmp_path / "c.spz").code == 0
    page = run("export-html", folder, tmp_path / "page", "--json").json
    assert page["encoded"] is False


def test_faults_of_folders_are_findings(run: Run, folder: Path) -> None:
    largest = max((folder / "segments").iterdir(), key=lambda path: path.stat().st_size)
    content = largest.read_bytes()
    largest.unlink()
    refused = run("info", folder)
    assert refused.code == 3
    assert refused.err.splitlines()[-2].endswith("[segment-missing]")
    assert refused.err.splitlines()[-1].startswith("--partial reads")
    assert run("info", folder, "--partial").code == 0
    largest.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    found = run("check", folder, "--json")
    assert found.code == 3
    assert [x["code"] for x in json.loads(found.out)["findings"]] == ["segment-crc"]
    manifest = folder / "manifest.cogsm"
    manifest.write_bytes(manifest.read_bytes()[:-1])
    found = run("check", folder, "--json")
    assert found.code == 3
    assert [x["code"] for x in json.loads(found.out)["findings"]] == ["file-truncated"]


@pytest.mark.parametrize("named", ["", "manifest.cogsm"])
def test_a_folder_is_not_packed_over_its_own_objects(run: Run, folder: Path, named: str) -> None:
    inner = sorted((folder / "segments").iterdir())[0]
    before = inner.read_bytes()
    told = run("convert", folder / named, inner, "--format", "cogs", "--force")
    assert told.code == 2
    assert "[output-is-input]" in told.err
    assert inner.read_bytes() == before


def test_misuse_is_told(run: Run, small: SmallScene, folder: Path, tmp_path: Path) -> None:
    assert run("convert", small.cogs, folder).code == 2
    refused = run("convert", small.cogs, folder / "*.cogsm")
    assert refused.code == 2
    assert "expected a file name" in refused.err
    assert run("convert", folder, small.cogs).code == 2
    assert run("convert", folder, folder / "new.cogsm", "--format", "ply").code == 2
    assert run("convert", tmp_path / "nothing", tmp_path / "out.cogs").code == 4


@pytest.mark.usefixtures("few_planned_views")
def test_files_are_copied_unless_something_changes_them(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    copy, edited = tmp_path / "copy.cogs", tmp_path / "edited.cogs"
    assert run("convert", small.cogs, copy).code == 0
    assert copy.read_bytes() == small.cogs.read_bytes()
    assert run("convert", small.cogs, edited, "--sh", 0, "--json").json["sh_degree"] == 0


def test_scenes_of_other_formats_are_encoded_into_folders(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    told = run("convert", small.ply, f"{tmp_path}/new/", "--cameras", small.cameras, "--json")
    assert told.code == 0, told.err
    assert told.json["output"] == str(tmp_path / "new" / "manifest.cogsm")
    assert run("check", tmp_path / "new").code == 0
    refused = run("convert", small.ply, "s3://bucket/scene/")
    assert (refused.code, "cogsplat upload" in refused.err) == (2, True)
