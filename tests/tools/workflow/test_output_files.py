"""Output files of a command: inputs, links and foreign files are never overwritten."""

import os
import shutil
from pathlib import Path

import click
import pytest
from running import Run, SmallScene, all_commands

from cogsplat.tools.terminal.standard_streams import InputPath, NamedPath, OutputPath
from cogsplat.tools.workflow.output_files import check_distinct

WRITTEN = {
    "encode": {"out", "report"},
    "split": {"folder"},
    "batch": {"log"},
    "tune": {"out", "ply", "checkpoint"},
    "compare": {"difference"},
    "demo": {"out"},
    "lab evaluate": {"out"},
    "lab simulate": {"csv_path", "plot_path", "strip_path"},
    "lab bench": {"out"},
    "lab synth": {"out", "cameras", "walk", "masks"},
    "lab conformance fuzz": {"keep"},
    **{name: {"out"} for name in ("layers", "decode", "convert", "describe", "merge", "filter")},
    **{name: {"out"} for name in ("export-html", "render", "lab score", "lab order", "lab views")},
}


def test_every_path_of_a_command_is_read_or_written() -> None:
    for words, command in all_commands().items():
        paths = [param for param in command.params if isinstance(param.type, click.Path)]
        assert all(isinstance(p.type, InputPath | NamedPath | OutputPath) for p in paths)
        written = {
            param.name
            for param in paths
            if isinstance(param.type, OutputPath) or getattr(param.type, "is_output", False)
        }
        assert written == WRITTEN.get(words, set()), words


def test_outputs_that_are_one_file(tmp_path: Path) -> None:
    check_distinct(tmp_path / "a", tmp_path / "b")
    (tmp_path / "link").symlink_to(tmp_path / "a")
    (tmp_path / "c").write_bytes(b"c")
    os.link(tmp_path / "c", tmp_path / "hard")
    for first, second in (("a", "a"), ("a", "b/../a"), ("a", "link"), ("c", "hard")):
        with pytest.raises(click.UsageError, match="as well, expected two files"):
            check_distinct(tmp_path / first, tmp_path / "d", tmp_path / second)


@pytest.fixture
def files(small: SmallScene, tmp_path: Path) -> Path:
    """Folder of a scene, cameras and a configuration, and hard and symbolic links to each."""
    for path in (small.ply, small.cogs, small.cameras):
        shutil.copy(path, tmp_path / path.name)
    (tmp_path / "options.toml").write_text("quality = 30\n")
    (tmp_path / "notes.txt").write_text("notes")
    for name in ("scene.ply", "cameras.json", "options.toml"):
        os.link(tmp_path / name, tmp_path / f"hard-{name}")
        (tmp_path / f"link-{name}").symlink_to(tmp_path / name)
    os.link(tmp_path / "scene.ply", tmp_path / "hard.png")
    return tmp_path


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("tune scene.ply o.cogs --checkpoint notes.txt", "foreign-file"),
        ("tune scene.ply o.cogs --checkpoint notes.txt --force", "foreign-file"),
        ("tune scene.ply o.cogs --checkpoint scene.ply --force", "output-is-input"),
        ("tune scene.ply o.cogs --checkpoint hard-scene.ply", "output-is-input"),
        ("tune scene.ply o.cogs --checkpoint link-scene.ply", "output-is-input"),
        (
            "tune scene.ply o.cogs --cameras cameras.json --checkpoint hard-cameras.json",
            "output-is-input",
        ),
        ("tune scene.ply o.cogs --checkpoint missing/a.npz", "not-found"),
        ("tune scene.ply o.cogs --checkpoint .", "not-a-file"),
        ("tune scene.ply o.cogs --checkpoint o.cogs", "usage"),
        ("tune scene.ply o.cogs --checkpoint o.npz --ply ./o.npz", "usage"),
        ("tune scene.ply o.cogs --ply hard-scene.ply --force", "output-is-input"),
        ("encode scene.ply hard-scene.ply --format cogs --force", "output-is-input"),
        (
            "encode scene.ply hard-options.toml --config options.toml --format cogs --force",
            "output-is-input",
        ),
        ("encode scene.ply o.cogs --report o.cogs", "usage"),
        ("lab simulate scene.cogs --cameras cameras.json --csv a --plot a", "usage"),
        ("lab simulate scene.cogs --cameras cameras.json --csv cameras.json --force",
         "output-is-input"),
        ("compare scene.ply scene.cogs --cameras cameras.json --difference hard.png --force",
         "output-is-input"),
        ("merge scene.ply scene.cogs hard-scene.ply --force", "output-is-input"),
    ],
)  # fmt: skip
def test_no_command_writes_what_is_not_its_own(
    run: Run, files: Path, monkeypatch: pytest.MonkeyPatch, words: str, code: str
) -> None:
    monkeypatch.chdir(files)
    before = {path.name: path.read_bytes() for path in files.iterdir()}
    first, *others = words.replace("lab simulate", "lab_simulate").split()
    told = run(first.replace("_", " "), *others)
    assert (told.code in (2, 4), f"[{code}]" in told.err) == (True, True), told.err
    assert {path.name: path.read_bytes() for path in files.iterdir()} == before


def test_an_output_in_a_folder_that_is_read_is_none_of_its_files(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    folder = tmp_path / "scene"
    assert run("convert", small.cogs, f"{folder}/").code == 0
    inner = next((folder / "segments").iterdir())
    before = inner.read_bytes()
    told = run("decode", folder, inner, "--format", "ply", "--force")
    assert (told.code, "[output-is-input]" in told.err) == (2, True), told.err
    told = run("decode", folder / "manifest.cogsm", inner, "--format", "ply", "--force")
    assert (told.code, "[output-is-input]" in told.err) == (2, True), told.err
    assert inner.read_bytes() == before


@pytest.mark.parametrize("name", ['"a\\u0000b"', '"\\ud800"'])
def test_names_that_no_file_can_have_are_misuse(
    run: Run, small: SmallScene, tmp_path: Path, name: str
) -> None:
    config = tmp_path / "a.toml"
    config.write_text(f"cameras = {name}")
    told = run("encode", small.ply, tmp_path / "a.cogs", "--config", config)
    assert told.code == 2, told.err
