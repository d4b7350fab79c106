"""`describe`: shown and changed descriptions, and descriptions kept by later commands."""

import json
from pathlib import Path

import pytest
from pictures import picture
from running import Run, SmallScene

import cogsplat

pytestmark = pytest.mark.usefixtures("few_planned_views")


@pytest.fixture
def described(run: Run, small: SmallScene, tmp_path: Path) -> Path:
    out = tmp_path / "described.cogs"
    done = run(
        "describe", small.cogs, out, "--title", "Garden", "--licence", "CC-BY-4.0",
        "--background", "#ff8000", "--metres-per-unit", "0.5", "--unit", "ft", "--date", "2026-05",
        "--up", "-y", "--view", "0,0,-4,0,0,0,45", "--add-view", "Door=1,0,-4,0,0,0,45",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert "Garden" in done.out
    return out


def test_a_description_is_shown(run: Run, small: SmallScene, described: Path) -> None:
    assert "no description" in run("describe", small.cogs).out
    assert run("describe", small.cogs, "--json").json["description"] == {}
    shown = run("describe", described).out
    for text in ("Garden", "CC-BY-4.0", "#ff8000", "0.5 m", "1: Door"):
        assert text in shown
        assert text in run("info", described).out
    value = run("describe", described, "--json").json["description"]
    assert value["title"] == "Garden"
    assert run("info", described, "--json").json["description"] == value
    assert run("check", described).code == 0


def test_keys_are_set_and_cleared(run: Run, described: Path, tmp_path: Path) -> None:
    (tmp_path / "p.webp").write_bytes(picture("WEBP", (40, 30)))
    (tmp_path / "d.json").write_text(
        json.dumps({"description": {"title": "Park", "poster": "p.webp"}}), encoding="utf-8"
    )
    done = run("describe", described, "--from", tmp_path / "d.json", "--force", "--json").json
    told = done["description"]
    assert told["title"] == "Park"
    assert told["licence"] == "CC-BY-4.0"
    assert told["poster"] == {"type": "image/webp", "width": 40, "height": 30}
    again = run("describe", described, "--title", "New", "--clear", "licence", "--force", "--json")
    assert "licence" not in again.json["description"]
    with cogsplat.open(described) as file:
        assert file.description(pictures=True).poster.data == picture("WEBP", (40, 30))
    assert (
        run("describe", described, "--clear", "all", "--force", "--json").json["description"] == {}
    )


def test_the_first_view_becomes_the_poster(run: Run, described: Path, tmp_path: Path) -> None:
    out = tmp_path / "new.cogs"
    told = run("describe", described, out, "--poster", "first-view", "--json").json
    assert told["description"]["poster"] == {"type": "image/webp", "width": 1280, "height": 720}
    assert run("check", out).code == 0


def test_a_scene_is_replaced_with_force_only(run: Run, described: Path, tmp_path: Path) -> None:
    before = described.read_bytes()
    refused = run("describe", described, "--title", "New")
    assert (refused.code, described.read_bytes()) == (2, before)
    assert "exists" in refused.err
    assert run("describe", described, described, "--title", "New", "--force").code == 2
    assert run("describe", described, "--title", "x" * 300, "--force").code == 3
    assert run("describe", described, "--add-view", "0,0,1", "--force").code == 2
    assert run("describe", described, "--view", "1,2", "--force").code == 3
    assert described.read_bytes() == before


def test_a_folder_gets_a_new_manifest_alone(run: Run, described: Path, tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    assert run("convert", described, f"{folder}/").code == 0
    count = len(list((folder / "segments").iterdir()))
    told = run("describe", folder, "--title", "New", "--force", "--json").json
    assert len(list((folder / "segments").iterdir())) == count
    assert told["bytes_written"] < 20_000
    assert run("check", folder).code == 0


def test_other_commands_keep_it(
    run: Run, small: SmallScene, described: Path, tmp_path: Path
) -> None:
    title = {"title": "Garden"}
    (tmp_path / "d.json").write_text(json.dumps({"title": "Encoded"}), encoding="utf-8")
    outputs = {
        "convert": ["convert", described, tmp_path / "a.cogs", "--scale", "2"],
        "filter": ["filter", described, tmp_path / "c.cogs", "--keep", "50%", "--by", "antimatter"],
        "merge": ["merge", described, small.ply, tmp_path / "d.cogs", "--translate", "1:1,0,0"],
    }  # fmt: skip
    for name, arguments in outputs.items():
        assert run(*arguments).code == 0, name
        out = next(a for a in arguments[2:] if str(a).endswith(".cogs"))
        told = run("describe", out, "--json").json["description"]
        assert told["title"] == title["title"], name
        # Up and the first view stay as well, and move with the scene.
        with cogsplat.open(out) as file:
            view, up = file.root.first_view, file.root.up
        shift = {"convert": [0, 0, -8], "merge": [1, 0, -4]}.get(name, [0, 0, -4])
        assert view.position == pytest.approx(shift), name
        assert up == pytest.approx([0, -1, 0]), name
        if name == "convert":
            assert told["metres_per_unit"] == 0.25
    encoded = run("encode", described, tmp_path / "e.cogs", "--preset", "fast", "--describe",
                  tmp_path / "d.json")  # fmt: skip
    assert encoded.code == 0
    told = run("describe", tmp_path / "e.cogs", "--json").json["description"]
    assert (told["title"], told["licence"]) == ("Encoded", "CC-BY-4.0")
    assert "the description is left out" in run("convert", described, tmp_path / "x.ply").err
    merged = run("merge", described, described, tmp_path / "m.cogs")
    assert "the description is left out" in merged.err


def test_settings_of_supersplat_go_both_ways(run: Run, described: Path, tmp_path: Path) -> None:
    settings = tmp_path / "settings.json"
    assert run("describe", described, settings).code == 0
    value = json.loads(settings.read_text(encoding="utf-8"))
    assert value["cameras"][0]["initial"]["position"] == pytest.approx([0, 0, -4])
    value["background"]["color"] = [0, 0, 1]
    settings.write_text(json.dumps(value), encoding="utf-8")
    told = run("describe", described, "--from", settings, "--force", "--json").json
    assert told["description"]["background"] == [0.0, 0.0, 1.0]
    assert told["description"]["title"] == "Garden"


def test_the_copyright_of_a_gltf_becomes_the_credits(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    model = tmp_path / "scene.gltf"
    assert run("convert", small.ply, tmp_path / "scene.glb").code == 0
    data = (tmp_path / "scene.glb").read_bytes()
    length = int.from_bytes(data[12:16], "little")
    value = json.loads(data[20 : 20 + length])
    value["asset"]["copyright"] = "2026 The maintainers\n"
    value["buffers"][0]["uri"] = "scene.bin"
    (tmp_path / "scene.bin").write_bytes(data[28 + length :])
    model.write_text(json.dumps(value), encoding="utf-8")
    assert run("convert", model, tmp_path / "new.cogs").code == 0
    told = run("describe", tmp_path / "new.cogs", "--json").json["description"]
    assert told == {"credits": "2026 The maintainers"}
