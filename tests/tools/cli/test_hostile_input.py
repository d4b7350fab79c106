"""The command line on files that mean ill, and on outputs that would do harm."""

import json
import os
from pathlib import Path

import hostile_files as hostile
import pytest
from running import Run, SmallScene, all_commands

from cogsplat.codec.errors import CogsplatWarning, FormatError, printable

ESCAPES = "red\x1b[31m \x9b2J \x07 \u202eback\x1b]0;title\x07"


def only_shown(text: str) -> bool:
    return all(line.isprintable() for line in text.splitlines() if line) and "\x1b" not in text


@pytest.mark.parametrize(
    "arguments",
    [
        ["info"],
        ["decode", "{out}.ply"],
        ["convert", "{out}.spz"],
        ["lab score", "{out}.npy"],
        ["lab order", "{out}.npy"],
        ["lab views", "{out}.json"],
        ["render", "{out}.png"],
        ["compare", "{scene}"],
    ],
    ids=lambda arguments: arguments[0],
)
@pytest.mark.parametrize("limits", ["splats=1900", "memory=100kB"])
def test_limits_are_exit_status_5(
    run: Run, small: SmallScene, tmp_path: Path, arguments: list[str], limits: str
) -> None:
    command, *rest = (
        argument.format(out=tmp_path / "out", scene=small.cogs) for argument in arguments
    )
    if command == "info":
        ran = run("info", small.ply, "--limits", limits)
    else:
        ran = run(command, small.cogs, *rest, "--limits", limits)
    assert ran.code == 5, ran.err
    assert "[too-many-splats]" in ran.err or "[decoded-size]" in ran.err
    assert list(tmp_path.iterdir()) == []


def test_every_command_that_reads_takes_limits() -> None:
    without = [
        name
        for name, command in all_commands().items()
        if all("--limits" not in option.opts for option in command.params)
    ]
    # The scenes of a batch take limits among their options, a server decodes nothing, the others
    # make what they read.
    assert without == [
        *("batch", "serve", "demo", "lab synth", "lab conformance run"),
        *("lab conformance fuzz", "lab warm"),
    ]


def test_limits_of_cameras(run: Run, small: SmallScene, tmp_path: Path) -> None:
    ran = run(
        "lab score",
        small.ply,
        tmp_path / "a.npy",
        "--cameras",
        small.cameras,
        "--limits",
        "cameras=8",
    )
    assert (ran.code, ran.out) == (5, "")
    assert "[too-many-cameras]" in ran.err


def test_a_limit_that_is_none_is_misuse(run: Run, small: SmallScene) -> None:
    ran = run("info", small.ply, "--limits", "time=3s")
    assert ran.code == 2
    assert "memory=2GiB" in ran.err


def test_small_files_that_ask_for_much_are_a_limit(run: Run, tmp_path: Path) -> None:
    path = hostile.spz_of_zeros(tmp_path, version=4, splats=300_000)
    assert run("info", path).code == 5
    assert run("info", path, "--limits", "expansion=1000000").code == 0


def test_escape_sequences_do_not_reach_the_terminal(run: Run, tmp_path: Path) -> None:
    root, binary = hostile.gltf_root(2, 1)
    root["extensionsRequired"] = [ESCAPES]
    path = tmp_path / "a.glb"
    path.write_bytes(hostile.glb(root, binary))
    ran = run("info", path)
    assert ran.code == 3
    assert "[gltf-extension]" in ran.err
    assert only_shown(ran.err)
    assert "\\x1b[31m" in ran.err
    ran = run("info", path, "--json")
    assert only_shown(ran.out)
    assert "\\x1b[31m" in ran.json["error"]["message"]  # type: ignore[index]


def test_names_with_escape_sequences(run: Run, small: SmallScene, tmp_path: Path) -> None:
    """Names of files, cameras and attributes are escaped in summaries, tables and warnings."""
    entries = json.loads(small.cameras.read_text())
    for entry in entries:
        entry["img_name"] = ESCAPES
    cameras = tmp_path / "cameras.json"
    cameras.write_text(json.dumps(entries))
    out = tmp_path / "pic\x1b[2Jture.png"
    ran = run("render", small.ply, out, "--cameras", cameras, "--view", 0, "--size", "32x24")
    assert ran.code == 0, ran.err
    assert only_shown(ran.out + ran.err)
    assert "\\x1b[31m" in ran.out
    assert out.exists()


def test_errors_and_warnings_are_one_line_that_can_be_shown() -> None:
    for error in (FormatError("a", f"x\n{ESCAPES}"), CogsplatWarning(f"x\n{ESCAPES}")):
        assert only_shown(str(error))
        assert "\\x0a" in str(error)
    assert printable("größer 漢字 🙂") == "größer 漢字 🙂"


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("encode", "a.ply"),
        ("encode", "a.png"),
        ("render", "r.jpg"),
        ("render", "r.cogs"),
        ("lab score", "a.json"),
        ("lab order", "a.ply"),
    ],
)
def test_names_of_another_format_are_misuse(
    run: Run, small: SmallScene, tmp_path: Path, command: str, name: str
) -> None:
    ran = run(command, small.ply, tmp_path / name, "--force")
    assert ran.code == 2
    assert f"the name ends in {Path(name).suffix}" in ran.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("command", "name", "format_name", "start"),
    [
        ("decode", "a.cogs", "ply", b"ply\n"),
        ("decode", "a", "spz", b"NGSP"),
        ("convert", "a.bin", "ply", b"ply\n"),
        ("render", "a.jpg", "png", b"\x89PNG"),
        ("encode", "a.ply", "cogs", b"\x89COGS"),
    ],
)
def test_who_insists_on_a_format_gets_it(
    run: Run,
    small: SmallScene,
    tmp_path: Path,
    command: str,
    name: str,
    format_name: str,
    start: bytes,
) -> None:
    source = small.cogs if command in ("decode", "render") else small.ply
    more = ["--size", "32x24"] if command == "render" else []
    more += ["--cameras", str(small.cameras)] if command == "encode" else []
    ran = run(command, source, tmp_path / name, "--format", format_name, *more)
    assert ran.code == 0, ran.err
    assert (tmp_path / name).read_bytes().startswith(start)


@pytest.mark.parametrize("link", ["same", "symbolic", "hard"])
@pytest.mark.parametrize("force", [[], ["--force"]])
def test_an_output_that_is_an_input_is_misuse(
    run: Run, small: SmallScene, tmp_path: Path, link: str, force: list[str]
) -> None:
    scene, out = tmp_path / "a.ply", tmp_path / "b.ply"
    scene.write_bytes(small.ply.read_bytes())
    if link == "symbolic":
        out.symlink_to(scene)
    elif link == "hard":
        os.link(scene, out)
    else:
        out = scene
    before = scene.read_bytes()
    ran = run("convert", scene, out, *force)
    assert ran.code == 2
    assert "[output-is-input]" in ran.err
    assert scene.read_bytes() == before


def test_cameras_photos_and_files_beside_a_scene_are_inputs(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    cameras = tmp_path / "cameras.json"
    cameras.write_bytes(small.cameras.read_bytes())
    ran = run("encode", small.ply, cameras, "--cameras", cameras, "--format", "cogs", "--force")
    assert "[output-is-input]" in ran.err
    root, binary = hostile.gltf_root(2, 1)
    root["buffers"] = [{"byteLength": len(binary), "uri": "side.ply"}]
    (tmp_path / "side.ply").write_bytes(binary)
    (tmp_path / "a.gltf").write_text(json.dumps(root))
    ran = run("convert", tmp_path / "a.gltf", tmp_path / "side.ply", "--force")
    assert "[output-is-input]" in ran.err
    assert (tmp_path / "side.ply").read_bytes() == binary


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="no /proc")
def test_a_place_that_takes_no_file_is_found_before_the_work(run: Run, small: SmallScene) -> None:
    ran = run("encode", small.ply, "/proc/a.cogs")
    assert ran.code == 4
    # Nothing was scored before.
    assert "score" not in ran.err
