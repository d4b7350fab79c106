"""encode, decode, info, synth: what goes into files and what is told of them."""

from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest
from PIL import Image
from running import SPLATS, VIEWS, Run, SmallScene

import cogsplat
from cogsplat.codec.splats import Splats
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.tools.cli.encode import encode
from cogsplat.tools.lab.cli.evaluate import evaluate
from cogsplat.tools.lab.cli.score import score
from cogsplat.tools.lab.synthetic.rooms import synth_rooms
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")

# A name that fits what each command writes.
OUTPUTS = {
    "encode": "out.cogs",
    "decode": "out.ply",
    "lab synth": "out.ply",
    "lab score": "out.npy",
    "render": "out.png",
    "info": "",
}


def assert_same(first: Splats, second: Splats) -> None:
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), name)


def option(command: click.Command, name: str) -> click.Option:
    (found,) = (p for p in command.params if p.name == name)
    assert isinstance(found, click.Option)
    return found


def test_choices_and_defaults_are_the_encoder_s_own() -> None:
    from cogsplat.codec.encode.config import (
        MAX_QUALITY_DB,
        MIN_QUALITY_DB,
        PROFILE_NAMES,
        EncodeConfig,
    )
    from cogsplat.codec.rate.pruning import PEAK, SPARSE_PEAK, PruneConfig
    from cogsplat.codec.scoring.score_config import LEAST_WEIGHT, ScoreConfig

    config = EncodeConfig()
    profile, order = option(encode, "profile"), option(encode, "order")
    assert isinstance(profile.type, click.Choice)
    assert tuple(profile.type.choices) == tuple(PROFILE_NAMES)
    assert profile.default == config.profile
    assert order.default == config.order
    for command in (encode, evaluate):
        quality = option(command, "quality")
        assert quality.default == config.quality_db
        assert isinstance(quality.type, click.FloatRange)
        assert (quality.type.min, quality.type.max) == (MIN_QUALITY_DB, MAX_QUALITY_DB)
    # No default of click's own: with --cells it is another one.
    chunk_splats = option(encode, "chunk_splats")
    assert not isinstance(chunk_splats.default, int)
    assert f"[default: {config.chunk_splats}, " in (chunk_splats.help or "")
    usual = f"{PEAK}, or {SPARSE_PEAK} where cameras overlap too little"
    assert option(encode, "prune").show_default == usual
    assert config.prune == PruneConfig() == PruneConfig(peak=None)
    assert config.morton
    assert option(score, "top_k").default == ScoreConfig().top_k
    assert option(encode, "top_k").default is None
    assert option(encode, "top_k").show_default == f"all of at least {LEAST_WEIGHT}"
    assert ScoreConfig().jitter


def test_presets_order_by_gain_unless_another_order_is_asked_for(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    def encoded(*options: object) -> bytes:
        out = tmp_path / "out.cogs"
        given = ("encode", small.ply, out, "--cameras", small.cameras, "--force", *options)
        assert run(*given).code == 0
        return out.read_bytes()

    fast = encoded("--preset", "fast")
    plain = ("--order", "contribution", "--no-compensation")
    assert fast == encoded("--preset", "fast", "--order", "gain")
    assert fast != encoded("--preset", "fast", *plain)
    assert fast != encoded()
    assert encoded() == encoded("--order", "gain")
    assert encoded() != encoded(*plain)


def test_encode_then_decode_gives_back_the_scene(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out, back = tmp_path / "out.cogs", tmp_path / "back.ply"
    told = run("encode", small.ply, out, "--cameras", small.cameras, "--no-prune")
    assert told.code == 0, told.err
    assert str(out) in told.out
    assert f"{SPLATS:,} of {SPLATS:,}" in told.out
    assert run("decode", out, back).code == 0
    assert_same(cogsplat.read(back), cogsplat.decode(out))
    assert len(cogsplat.read(back)) == SPLATS


def test_encode_tells_all_in_json(run: Run, small: SmallScene, tmp_path: Path) -> None:
    out = tmp_path / "out.cogs"
    told = run(
        "encode", small.ply, out, "--cameras", small.cameras, "--eval-every", 3, "--no-jitter",
        "--prune", 0.2, "--chunk-splats", 500, "--sh", 1, "--json",
    )  # fmt: skip
    assert (told.code, told.err) == (0, "")
    report = told.json
    with cogsplat.open(out) as file:
        assert report["splats"] == file.root.splats
        assert report["chunks"] == file.num_chunks
        assert report["sh_degree"] == file.root.sh_degree == 1
    assert report["bytes"] == out.stat().st_size
    assert report["source_bytes"] == small.ply.stat().st_size
    assert report["source_splats"] == SPLATS
    assert report["splats_pruned"] == SPLATS - int(str(report["splats"])) > 0
    assert report["splats_dropped"] == 0
    assert report["scored_views"] == VIEWS - 3
    assert isinstance(report["seconds"], dict)
    assert {"read", "score", "chunks", "write"} <= set(report["seconds"])


def test_encode_in_file_order_without_cameras_keeps_rows(
    run: Run, tmp_path: Path, small: SmallScene
) -> None:
    out = tmp_path / "out.cogs"
    told = run(
        "encode", small.ply, out, "--profile", "near-lossless", "--order", "source", "--no-morton",
        "--no-prune", "--top-k", 0, "--no-jitter", "--quiet",
    )  # fmt: skip
    assert (told.code, told.out, told.err) == (0, "", "")
    source, decoded = cogsplat.read(small.ply), cogsplat.decode(out)
    np.testing.assert_allclose(decoded.sh0, source.sh0, atol=0.001)


def test_rows_that_cannot_be_drawn_are_refused_or_left_out(run: Run, tmp_path: Path) -> None:
    scene = synth(300)
    means = scene.means.copy()
    means[[3, 50]] = np.nan
    scene_file, cameras = tmp_path / "scene.ply", tmp_path / "cameras.json"
    cogsplat.write(replace(scene, means=means), scene_file)
    write_cameras_json(synth_cameras(3, 64, 48), cameras)
    arguments = ["encode", scene_file, tmp_path / "out.cogs", "--cameras", cameras, "--no-prune"]
    told = run(*arguments)
    assert told.code == 3
    assert "[invalid-rows]" in told.err
    assert not (tmp_path / "out.cogs").exists()
    told = run(*arguments, "--drop-invalid", "--json")
    assert (told.code, told.err) == (0, "")
    assert (told.json["splats"], told.json["splats_dropped"]) == (298, 2)
    assert "2 of 300 splats" in str(told.json["warnings"])
    told = run(*arguments, "--drop-invalid", "--force", "--quiet")
    assert (told.code, told.out) == (0, "")
    assert told.err.startswith("warning: ")
    assert told.err.count("2 of 300 splats") == 1

    cogsplat.write(replace(scene, means=np.full_like(means, np.nan)), scene_file, force=True)
    told = run(*arguments, "--drop-invalid", "--force")
    assert told.code == 3
    assert "[no-valid-rows]" in told.err


def test_holding_out_every_camera_is_misuse(run: Run, small: SmallScene, tmp_path: Path) -> None:
    told = run(
        "encode", small.ply, tmp_path / "o.cogs", "--cameras", small.cameras, "--eval-every", 1
    )
    assert told.code == 2
    assert "holds out all 9 cameras" in told.err


def test_cameras_too_large_to_draw_are_a_limit(run: Run, small: SmallScene, tmp_path: Path) -> None:
    cameras = tmp_path / "cameras.json"
    write_cameras_json([replace(synth_cameras(1)[0], width=60000, height=60000)], cameras)
    told = run("render", small.ply, tmp_path / "out.png", "--cameras", cameras)
    assert told.code == 5
    assert "[view-size]" in told.err


PARTS = [
    ["--chunks", "1:3"],
    ["--chunks", "2:"],
    ["--chunks", "0:0"],
    ["--splats", "700"],
    ["--bytes", "60%"],
    ["--bytes", "20KiB"],
    ["--sh", "1"],
    ["--splats", "1", "--sh", "0"],
]


@pytest.mark.parametrize("part", PARTS, ids=" ".join)
def test_parts_are_what_the_library_decodes(
    run: Run, small: SmallScene, tmp_path: Path, part: list[str]
) -> None:
    out = tmp_path / "out.ply"
    told = run("decode", small.cogs, out, *part, "--json")
    assert (told.code, told.err) == (0, "")
    wanted = dict(zip(part[::2], part[1::2], strict=True))
    size = small.cogs.stat().st_size
    with cogsplat.open(small.cogs) as file:
        chunks = {"1:3": (1, 3), "2:": (2, file.num_chunks), "0:0": (0, 0)}
    expected = cogsplat.decode(
        small.cogs,
        chunks=chunks.get(wanted.get("--chunks", "")),
        splats=int(wanted["--splats"]) if "--splats" in wanted else None,
        size_bytes={"60%": size * 60 // 100, "20KiB": 20480}.get(wanted.get("--bytes", "")),
        sh_degree=int(wanted["--sh"]) if "--sh" in wanted else None,
    )
    assert_same(cogsplat.read(out), expected)
    assert told.json["splats"] == len(expected)
    assert told.json["sh_degree"] == expected.sh_degree


def test_bytes_are_a_truncated_file(run: Run, small: SmallScene, tmp_path: Path) -> None:
    data = small.cogs.read_bytes()
    half = int(0.5 * len(data))
    cut = tmp_path / "cut.cogs"
    cut.write_bytes(data[:half])
    told = run("decode", cut, tmp_path / "refused.ply")
    assert told.code == 3
    assert "[file-truncated]" in told.err
    told = run("decode", small.cogs, tmp_path / "half.ply", "--bytes", half)
    assert told.code == 0
    assert "in the first" in told.out
    assert run("decode", cut, tmp_path / "cut.ply", "--bytes", "100%").code == 0
    assert (tmp_path / "cut.ply").read_bytes() == (tmp_path / "half.ply").read_bytes()


def test_too_few_bytes_for_a_chunk_are_said(run: Run, small: SmallScene, tmp_path: Path) -> None:
    told = run("decode", small.cogs, tmp_path / "none.ply", "--bytes", "10%")
    assert told.code == 0
    assert "no chunk is complete" in told.err
    told = run("decode", small.cogs, tmp_path / "root.ply", "--bytes", "100")
    assert told.code == 3
    assert "[root-truncated]" in told.err


def test_parts_that_are_not_there_are_misuse(run: Run, small: SmallScene, tmp_path: Path) -> None:
    told = run("decode", small.cogs, tmp_path / "out.ply", "--chunks", "1:99")
    assert told.code == 2
    told = run("render", small.ply, tmp_path / "out.png", "--bytes", "10%")
    assert told.code == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["encode", "decode", "render", "lab score", "lab synth"])
def test_what_exists_is_replaced_with_force_alone(
    run: Run, small: SmallScene, tmp_path: Path, command: str
) -> None:
    out = tmp_path / OUTPUTS[command]
    out.write_text("mine")
    source = small.cogs if command == "decode" else small.ply
    arguments: list[object] = [command, source, out]
    if command == "lab synth":
        arguments = [command, out, "--splats", 20]
    elif command != "decode":
        arguments += ["--cameras", small.cameras]
    told = run(*arguments)
    assert told.code == 2
    assert "[exists]" in told.err
    assert out.read_text() == "mine"
    told = run(*arguments, "--json")
    assert (told.code, told.json["error"]["code"]) == (2, "exists")  # type: ignore[index]
    assert run(*arguments, "--force").code == 0
    assert out.read_bytes() != b"mine"


@pytest.mark.parametrize("command", ["encode", "decode", "info", "render", "lab score"])
def test_hostile_files_are_refused(
    run: Run, small: SmallScene, tmp_path: Path, command: str
) -> None:
    good, ply = small.cogs.read_bytes(), small.ply.read_bytes()
    files = {
        "empty.cogs": b"",
        "noise.cogs": b"\x00" * 500,
        "cut.cogs": good[: len(good) // 2],
        "head.cogs": good[:40],
        "flipped.cogs": good[:200] + bytes([good[200] ^ 0x55]) + good[201:],
        "long.cogs": good + b"more",
        "cut.ply": ply[:5000],
        "count.ply": ply.replace(b"vertex 2000", b"vertex 2000000000000"),
        "property.ply": ply.replace(b"property float opacity", b"property float translucy"),
        "markup.ply": b"<html>404</html>",
        "scene.xyz": b"1 2 3",
    }
    folder = tmp_path / "hostile"
    folder.mkdir()
    outs = tmp_path / "outs"
    outs.mkdir()
    for name, data in files.items():
        path = folder / name
        path.write_bytes(data)
        arguments = [command, path] + ([] if command == "info" else [outs / OUTPUTS[command]])
        told = run(*arguments)
        assert told.code == 3, (name, told)
        assert told.err.startswith("error: ")
        assert told.out == ""
    assert list(outs.iterdir()) == []


def test_folders_and_absent_files_are_faults_of_input(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    assert run("info", tmp_path).code == 4
    assert run("info", tmp_path / "absent.cogs").code == 4
    assert run("decode", small.cogs, tmp_path / "absent" / "out.ply").code == 4
    assert run("encode", small.ply, tmp_path / "o.cogs", "--cameras", tmp_path / "no").code == 4
    assert list(tmp_path.iterdir()) == []


def test_info_accounts_for_every_byte(run: Run, small: SmallScene) -> None:
    told = run("info", small.cogs, "--json")
    assert (told.code, told.err) == (0, "")
    report = told.json
    size = small.cogs.stat().st_size
    attributes, chunks = report["attributes"], report["chunk_table"]
    assert isinstance(attributes, list)
    assert isinstance(chunks, list)
    assert sum(entry["bytes"] for entry in attributes) == report["bytes"] == size
    stray = [e["bytes"] for e in attributes if e["stream"] == "framing of segments"]
    assert sum(stray) <= 4 * int(str(report["segments"]))
    streams = [e for e in attributes if e["segment"] != "index"]
    assert all(entry["bytes"] > 0 for entry in streams)
    assert sum(chunk["splats"] for chunk in chunks) == report["splats"]
    assert chunks[-1]["share_so_far"] == pytest.approx(1.0)
    assert [chunk["number"] for chunk in chunks] == list(range(len(chunks)))
    offsets = [chunk["head_offset"] for chunk in chunks]
    assert offsets == sorted(offsets)
    assert report["decoded_bytes"] == cogsplat.decode(small.cogs).nbytes


def test_info_shows_root_chunks_and_attributes(run: Run, small: SmallScene) -> None:
    told = run("info", small.cogs)
    assert told.code == 0
    for words in ("codebooks", "first view", "contribution", "bits/splat", "total", "100.0%"):
        assert words in told.out
    assert all(len(line) <= 80 for line in told.out.splitlines()[1:])


def test_info_cuts_long_tables_unless_asked(run: Run, tmp_path: Path, small: SmallScene) -> None:
    out = tmp_path / "many.cogs"
    arguments = [
        "--cameras",
        small.cameras,
        "--chunk-splats",
        20,
        "--profile",
        "near-lossless",
        "-q",
    ]
    assert run("encode", small.ply, out, *arguments).code == 0
    short, whole = run("info", out).out, run("info", out, "--all").out
    assert "--all" in short
    assert "--all" not in whole
    assert len(whole.splitlines()) > len(short.splitlines()) + 20


def test_info_of_a_foreign_scene_gives_ranges(run: Run, small: SmallScene, tmp_path: Path) -> None:
    report = run("info", small.ply, "--json").json
    scene = cogsplat.read(small.ply)
    assert (report["splats"], report["sh_degree"]) == (SPLATS, 3)
    ranges = report["ranges"]
    assert isinstance(ranges, dict)
    assert ranges["means"]["min"] == float(scene.means.min())
    assert run("info", small.ply, "--sh", 1).code == 2, "a part without --statistics"

    opacities = scene.opacities.copy()
    opacities[0] = np.inf
    odd = tmp_path / "odd.ply"
    cogsplat.write(replace(scene, opacities=opacities), odd)
    ranges = run("info", odd, "--json").json["ranges"]
    assert isinstance(ranges, dict)
    assert ranges["opacities"]["not_finite"] == 1
    assert "not finite" in run("info", odd).out


def test_empty_scenes_go_through(run: Run, tmp_path: Path) -> None:
    ply, cogs = tmp_path / "none.ply", tmp_path / "none.cogs"
    cogsplat.write(synth(5).take(slice(0, 0)), ply)
    assert run("info", ply).code == 0
    assert run("encode", ply, cogs).code == 0
    assert run("check", cogs).code == 0
    assert run("decode", cogs, tmp_path / "back.ply").code == 0
    assert len(cogsplat.read(tmp_path / "back.ply")) == 0


def test_synth_writes_scene_and_cameras(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "scene.ply"
    told = run("lab synth", out, "--splats", 500, "--seed", 3, "--sh", 2)
    assert told.code == 0
    cameras = tmp_path / "scene.cameras.json"
    assert str(cameras) in told.out
    assert_same(cogsplat.read(out), synth(500, seed=3, sh_degree=2))
    assert len(cogsplat.read_cameras(cameras)) == len(synth_cameras())
    elsewhere = tmp_path / "views.json"
    told = run("lab synth", tmp_path / "b.ply", "--splats", 9, "--cameras", elsewhere, "--json")
    assert told.json["cameras"] == str(elsewhere)
    assert elsewhere.is_file()


def test_synth_touches_nothing_when_one_of_its_files_exists(run: Run, tmp_path: Path) -> None:
    (tmp_path / "scene.cameras.json").write_text("[]")
    assert run("lab synth", tmp_path / "scene.ply", "--splats", 9).code == 2
    assert not (tmp_path / "scene.ply").exists()


def test_synth_makes_a_house_with_a_walk_through_it(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "house.ply"
    told = run("lab synth", out, "--rooms", 3, "--splats", 700, "--seed", 4, "--sh", 1, "--json")
    assert told.code == 0, told.err
    assert_same(cogsplat.read(out), synth_rooms(3, 700, seed=4, sh_degree=1))
    assert (told.json["rooms"], told.json["views"]) == (3, 24)
    assert len(cogsplat.read_cameras(tmp_path / "house.cameras.json")) == 24
    walk = cogsplat.read_cameras(tmp_path / "house.walk.json")
    assert len(walk) == told.json["walk_poses"] > 10
    told = run(
        "lab synth", tmp_path / "b.ply", "--rooms", 1, "--splats", 9, "--walk", tmp_path / "w"
    )
    assert told.code == 0
    assert str(tmp_path / "w") in told.out


@pytest.mark.parametrize("option", [("--objects",), ("--masks", "m"), ("--cameras", "h.walk.json")])
def test_synth_refuses_what_a_house_has_not(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("lab synth", "h.ply", "--rooms", 2, "--splats", 9, *option).code == 2
    assert not (tmp_path / "h.ply").exists()


def test_synth_walks_through_houses_only(run: Run, tmp_path: Path) -> None:
    told = run("lab synth", tmp_path / "a.ply", "--splats", 9, "--walk", tmp_path / "walk.json")
    assert told.code == 2
    assert not (tmp_path / "a.ply").exists()


def test_compare_measures_objects_and_draws_the_difference(run: Run, tmp_path: Path) -> None:
    a, b, cameras, out = (tmp_path / n for n in ("a.ply", "b.ply", "c.json", "d.png"))
    scene = synth(600)
    labels = np.where(scene.means[:, 0] < np.median(scene.means[:, 0]), 1, 4).astype("u1")
    changed = scene.sh0.copy()
    changed[labels == 4] += 0.3
    cogsplat.write(replace(scene, extras={"object": labels}), a)
    cogsplat.write(replace(scene, sh0=changed), b)
    write_cameras_json(synth_cameras(4, 64, 48), cameras)
    common = ["--cameras", cameras, "--eval-every", 2]
    told = run("compare", a, b, *common, "--by-object", "--difference", out, "--json")
    assert (told.code, told.err) == (0, "")
    objects = told.json["by_object"]
    assert isinstance(objects, list)
    assert [one["object"] for one in objects] == [1, 4]
    assert objects[0]["psnr_db"] > objects[1]["psnr_db"] + 3
    with Image.open(out) as picture:
        assert picture.size == (3 * 64, 48)
        pixels = np.asarray(picture)
    assert pixels[:, 128:].any()
    assert run("compare", a, b, *common, "--difference", out).code == 2
    told = run("compare", a, b, *common, "--difference", out, "--by-object", "--force")
    assert told.code == 0, told.err
    assert "object" in told.out
    assert "difference x4" in told.out
    told = run("compare", b, a, *common, "--by-object", "--json")
    assert told.code == 3
    assert run("compare", a, b, *common, "--difference", tmp_path / "d.ply").code == 2


@pytest.mark.parametrize(
    "options",
    [[], ["--chunks", "0:1"], ["--chunks", "1:1"], ["--sh", "0"], ["--absolute"]],
    ids=str,
)
def test_a_ply_written_while_decoding_is_that_of_the_whole(
    run: Run, small: SmallScene, tmp_path: Path, options: list[str]
) -> None:
    shown = run("decode", small.cogs, tmp_path / "out.ply", *options)
    assert shown.code == 0, shown.err
    chunks = {"0:1": (0, 1), "1:1": (1, 1)}.get(options[1] if len(options) > 1 else "")
    splats = cogsplat.decode(small.cogs, chunks=chunks, sh_degree=0 if "--sh" in options else None)
    cogsplat.write(splats, tmp_path / "whole.ply", absolute="--absolute" in options)
    assert (tmp_path / "out.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
    assert f"{len(splats):,} of" in shown.out


def test_a_cap_that_is_too_small_ends_an_encode(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    shown = run("encode", small.ply, tmp_path / "out.cogs", "--memory", "64MiB")
    assert shown.code == 5
    assert "expected at least" in shown.err
    for options in (["--memory", "20%"], ["--memory", "8GiB", "--measure"]):
        assert run("encode", small.ply, tmp_path / "out.cogs", *options).code == 2
    assert list(tmp_path.iterdir()) == []
