"""JSON output of all commands has exactly the keys of docs/reference/json.md."""

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from fault_server import FaultServer, serving
from running import ROOT, Run, SmallScene, all_commands, broken_decoder, program

import cogsplat
from cogsplat.codec.order.objects import with_labels
from cogsplat.tools.lab.cli import demonstration
from cogsplat.tools.lab.synthetic import terrace as synthetic

PAGE = (ROOT / "docs/reference/json.md").read_text(encoding="utf-8")

# Below these, keys are names of stages, attributes, reasons and so on.
NAMED = {
    "seconds",
    "cpu_seconds",
    "counts",
    "statistics.values",
    "mean_over_log",
    "mean_over_log.*",
    "left_out",
    "share_of_splats_holding",
    "clauses",
    "verdicts",
}


def paths(value: object, at: str = "") -> Iterator[str]:
    """Yield the keys of a JSON value: ``points[].name``, with ``*`` for names of things."""
    if at == "description":
        # Its keys are those of SPEC 5.13.
        yield at
    elif isinstance(value, dict):
        for key, inner in value.items():
            shown = "*" if at in NAMED else key
            yield from paths(inner, f"{at}.{shown}".lstrip("."))
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for inner in value:
            yield from paths(inner, f"{at}[]")
    else:
        yield at


def documented() -> dict[str, set[str]]:
    """Return the keys that the page lists for each command."""
    sections = re.split(r"^### `(.+)`$", PAGE, flags=re.MULTILINE)[1:]
    return {
        command: set(re.findall(r"`([^`]+)`", text.partition("\n## ")[0]))
        for command, text in zip(sections[::2], sections[1::2], strict=True)
    }


def glossary() -> list[str]:
    """Return the keys that the page explains, in its order."""
    table = PAGE.partition("## Keys")[2].partition("## Commands")[0]
    return [
        key
        for row in re.findall(r"^\| (`.+?) \|", table, flags=re.MULTILINE)
        for key in re.findall(r"`([^`]+)`", row)
    ]


@pytest.fixture
def labelled(small: SmallScene, tmp_path: Path) -> Path:
    splats = cogsplat.read(small.ply)
    path = tmp_path / "labelled.ply"
    cogsplat.write(with_labels(splats, 1 + (splats.means[:, 0] > 0)), path)
    return path


def arguments(command: str, small: SmallScene, labelled: Path, out: Path) -> list[object]:
    """Return the arguments of a command, with every option that adds keys."""
    cameras = ["--cameras", small.cameras]
    given: dict[str, list[object]] = {
        "encode": [
            labelled, out / "a.cogs", *cameras, "--preset", "fast", "--measure", "--eval-every", 4,
        ],
        "decode": [small.cogs, out / "a.ply"],
        "merge": [small.ply, small.ply, out / "a.ply"],
        "filter": [small.ply, out / "a.ply", "--min-opacity", 0.1, "--keep", "50%", *cameras],
        "export-html": [small.cogs, out / "a.html"],
        "info": [small.cogs, "--statistics"],
        "describe": [small.cogs, out / "a.cogs", "--title", "Garden"],
        "lab score": [small.ply, out / "a.npy", *cameras],
        "lab order": [labelled, out / "a.npy", "--order", "antimatter", "--objects", *cameras],
        "lab views": [small.ply, out / "a.json"],
        "render": [small.cogs, out / "a.png", *cameras],
        "compare": [labelled, small.cogs, *cameras, "--by-object", "--difference", out / "a.png"],
        "lab evaluate": [
            labelled, *cameras, "--eval-every", 4, "--orders", "source", "--shares", "10",
            "--sizes", "none", "--codecs", "splat", "--by-object", "all",
        ],
        "lab bench": [small.ply, *cameras, "--qualities", "35"],
        "lab simulate": [small.cogs, *cameras, "--policy", "file", "--moments", 1, "--wait"],
        "lab synth": [out / "a.ply", "--splats", 1000],
        "demo": ["--out", out / "demo", "--splats", 1000],
        "lab warm": [],
        "split": [small.ply, out / "parts", *cameras, "--splats", 1000],
        "batch": [out / "scenes.jsonl"],
        "tune": [
            small.ply, out / "a.cogs", *cameras, "--minutes", "0.01", "--target-size", "20KB",
            "--keep", 0.9,
        ],
        "layers": [
            small.ply, out / "b.cogs", *cameras, "--scales", "2,1", "--shares", "40%,100%",
            "--steps", 2,
        ],
    }  # fmt: skip
    return [command, *given[command], "--json"]


# These do not end by themselves, or take a server or a decoder: they have tests of their own.
APART = {
    *("convert", "view", "serve", "check", "upload"),
    *("lab conformance run", "lab conformance fuzz"),
}


@pytest.mark.slow
@pytest.mark.parametrize("command", sorted(all_commands().keys() - APART))
def test_a_command_has_the_keys_of_the_page(
    run: Run,
    small: SmallScene,
    labelled: Path,
    tmp_path: Path,
    command: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cameras = synthetic.synth_cameras(48, 64, 48)
    for module in (synthetic, demonstration):
        monkeypatch.setattr(module, "synth_cameras", lambda: cameras)
    entry = {"input": str(small.ply), "output": "b.cogs", "options": {"preset": "fast"}}
    (tmp_path / "scenes.jsonl").write_text(json.dumps(entry) + "\n")
    told = run(*arguments(command, small, labelled, tmp_path))
    assert told.code == 0, told.out
    assert set(paths(told.json)) - {"warnings"} == documented()[command]


@pytest.mark.parametrize("server", ["view --no-open", "serve"])
def test_a_server_says_its_address_first(server: str, small: SmallScene) -> None:
    name, *options = server.split()
    words = [name, small.cogs, *options, "--json"]
    with subprocess.Popen(program(words), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        keys = set(re.findall(r'"(\w+)":', "".join(process.stdout.readline() for _ in range(5))))
        process.terminate()
    assert keys == documented()[name]


def test_a_file_and_a_folder_have_the_keys_of_the_page(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    of_file = set(paths(run("convert", small.ply, tmp_path / "a.spz", "--json").json))
    of_folder = set(paths(run("convert", small.cogs, f"{tmp_path}/folder/", "--json").json))
    assert of_file | of_folder == documented()["convert"]


def test_a_host_and_a_file_have_the_keys_of_the_page(run: Run, small: SmallScene) -> None:
    with serving(FaultServer(small.cogs.read_bytes())) as server:
        of_url = set(paths(run("check", server.url(), "--json").json))
    assert of_url | set(paths(run("check", small.cogs, "--json").json)) == documented()["check"]


@pytest.mark.parametrize("command", ["run", "fuzz"])
def test_a_decoder_with_a_fault_shows_all_keys_of_conformance(
    run: Run, few_vectors: Path, tmp_path: Path, command: str
) -> None:
    ours = shlex.join([sys.executable, "-m", "cogsplat.tools.lab.conformance.decoder", "numpy"])
    worse = broken_decoder(tmp_path, "answer.update(code='not-cogs') if 'code' in answer else None")
    words: list[object] = ["lab conformance", command, "--vectors", few_vectors, "--decoder", worse]
    if command == "fuzz":
        words += ["--decoder", ours, "--count", 10]
    told = run(*words, "--json")
    assert told.code == 3, told.out
    assert set(paths(told.json)) == documented()[f"lab conformance {command}"]


def test_every_command_and_key_is_explained_once() -> None:
    explained = documented()
    assert set(explained) == all_commands().keys()
    keys = glossary()
    assert len(keys) == len(set(keys))
    used = {
        part.removesuffix("[]")
        for listed in explained.values()
        for path in listed
        for part in path.split(".")
    }
    assert used - {"*"} == set(keys)
