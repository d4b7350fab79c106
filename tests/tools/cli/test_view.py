"""view and export-html."""

import base64
import json
import os
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from urllib.request import ProxyHandler, build_opener

import pytest
from chromium import executable
from running import Run, SmallScene, program

import cogsplat
from cogsplat.codec.errors import StorageError
from cogsplat.formats.storage.images import decode_image
from cogsplat.tools.cli import export_html

BLOCK = re.compile(rb'<script type="application/x-cogs-base64">([^<]*)</script>')


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C as a signal")
def test_view_serves_the_scene_until_it_is_stopped(small: SmallScene) -> None:
    command = program(["view", small.cogs, "--no-open", "--json"])
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            told = b""
            while not told.endswith(b"}\n"):
                line = process.stdout.readline()
                assert line, process.stderr and process.stderr.read()
                told += line
            url = json.loads(told)["url"]
            with build_opener(ProxyHandler({})).open(f"{url}scene.cogs", timeout=30) as answer:
                assert answer.read() == small.cogs.read_bytes()
            process.send_signal(signal.SIGINT)
            assert process.wait(60) == 0
            assert process.stderr is not None
            assert process.stderr.read() == b""
        finally:
            process.kill()


def test_view_refuses_what_it_cannot_read(run: Run, tmp_path: Path) -> None:
    assert run("view", tmp_path / "none.cogs", "--no-open").code == 4
    (tmp_path / "bad.cogs").write_bytes(b"nothing")
    assert run("view", tmp_path / "bad.cogs", "--no-open").code == 3


def test_page_decodes_back_to_the_same_bytes(run: Run, small: SmallScene, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    told = run("export-html", small.cogs, page, "--json")
    assert (told.code, told.err) == (0, "")
    assert told.json["bytes"] == page.stat().st_size
    blocks = BLOCK.findall(page.read_bytes())
    assert b"".join(map(base64.b64decode, blocks)) == small.cogs.read_bytes()
    assert run("export-html", small.cogs, page).code == 2
    assert run("export-html", small.cogs, page, "--force").code == 0
    assert list(tmp_path.iterdir()) == [page]


def test_folder_holds_page_and_scene(run: Run, small: SmallScene, tmp_path: Path) -> None:
    folder = tmp_path / "site"
    told = run("export-html", small.cogs, folder, "--folder")
    assert told.code == 0, told.err
    names = {path.name for path in folder.iterdir()}
    programs = {"viewer.js", "viewer_extras.js", "worker.js", "viewer_worker.js"}
    assert names == {"index.html", "viewer.css", "scene.cogs"} | programs
    assert (folder / "scene.cogs").read_bytes() == small.cogs.read_bytes()
    assert run("export-html", small.cogs, folder, "--folder").code == 2
    refused = run("export-html", folder / "scene.cogs", folder, "--folder", "--force")
    assert refused.code == 2
    assert "output-is-input" in refused.err


KILLED_AT_A_RENAME = """
import os, signal
link, left = os.link, [{renames}]
def kill_after(*names):
    link(*names)
    left[0] -= 1
    if not left[0]:
        os.kill(os.getpid(), signal.SIGKILL)
os.link = kill_after
"""


@pytest.mark.skipif(os.name != "posix", reason="kills by a signal")
@pytest.mark.parametrize("renames", [1, 6, 7])
def test_a_folder_whose_export_was_killed_is_written_by_the_same_command(
    run: Run, small: SmallScene, tmp_path: Path, renames: int
) -> None:
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    words = ["export-html", small.cogs, folder, "--folder"]
    killed = subprocess.run(
        program(words, before=KILLED_AT_A_RENAME.format(renames=renames)), check=False
    )
    assert killed.returncode == -signal.SIGKILL
    left = {path.name for path in folder.iterdir()}
    assert ("scene.cogs" in left, "index.html" in left) == (True, renames == 7)
    (folder / "notes.txt").write_text("mine, still")
    told = run(*words)
    assert told.code == 0, told.err
    assert {path.name for path in folder.iterdir()} == {
        *("notes.txt", "index.html", "scene.cogs", "viewer.css"),
        *("viewer.js", "viewer_extras.js", "worker.js", "viewer_worker.js"),
    }
    assert (folder / "scene.cogs").read_bytes() == small.cogs.read_bytes()
    assert (folder / "notes.txt").read_text() == "mine, still"
    assert run(*words).code == 2


def test_a_marker_of_another_program_is_kept(run: Run, small: SmallScene, tmp_path: Path) -> None:
    marker = tmp_path / ".cogsplat-export"
    marker.write_text("mine")
    told = run("export-html", small.cogs, tmp_path, "--folder")
    assert told.code == 2
    assert "[foreign-file]" in told.err
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"]


def test_outputs_that_are_refused_leave_nothing(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    assert run("export-html", small.cogs, tmp_path / "page.png").code == 2
    (tmp_path / "bad.cogs").write_bytes(b"nothing")
    assert run("export-html", tmp_path / "bad.cogs", tmp_path / "site", "--folder").code == 3
    assert [path.name for path in tmp_path.iterdir()] == ["bad.cogs"]


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C as a signal")
def test_view_gives_other_formats_as_a_ply_and_compares(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    spz = tmp_path / "scene.spz"
    assert run("convert", small.ply, spz).code == 0
    command = program(["view", spz, "--against", small.cogs, "--no-open", "--quiet"])
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            url = process.stdout.readline().decode().strip()
            opener = build_opener(ProxyHandler({}))
            with opener.open(f"{url}scene.ply", timeout=30) as answer:
                (tmp_path / "got.ply").write_bytes(answer.read())
            with opener.open(f"{url}against.cogs", timeout=30) as answer:
                assert answer.read() == small.cogs.read_bytes()
            got, given = cogsplat.read(tmp_path / "got.ply"), cogsplat.read(spz)
            assert (got.means == given.means).all()
            assert (got.shN == given.shN).all()
            process.send_signal(signal.SIGINT)
            assert process.wait(60) == 0
        finally:
            process.kill()


@pytest.mark.slow
def test_other_formats_are_encoded_first(run: Run, small: SmallScene, tmp_path: Path) -> None:
    told = run("export-html", small.ply, tmp_path / "site", "--folder")
    assert told.code == 0, told.err
    assert "encoding it first" in told.err
    assert len(cogsplat.decode(tmp_path / "site" / "scene.cogs")) > 0


def test_the_chunks_that_have_arrived_are_shown(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    data = small.cogs.read_bytes()
    cut = tmp_path / "cut.cogs"
    cut.write_bytes(data[: len(data) * 6 // 10])
    refused = run("export-html", cut, tmp_path / "site", "--folder")
    assert (refused.code, "--partial" in refused.err) == (3, True)
    told = run("export-html", cut, tmp_path / "site", "--folder", "--partial")
    assert told.code == 0, told.err
    assert "is truncated" in told.err
    shown = cogsplat.decode(tmp_path / "site" / "scene.cogs")
    assert 0 < len(shown) <= len(cogsplat.decode(cut, size_bytes=len(data) * 6 // 10))


@pytest.mark.slow
def test_a_browser_draws_the_page(run: Run, small: SmallScene, tmp_path: Path) -> None:
    page, picture = tmp_path / "page.html", tmp_path / "picture.png"
    assert run("export-html", small.cogs, page).code == 0
    command = [
        executable(), "--headless", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader", "--window-size=320,240", "--virtual-time-budget=20000",
        f"--user-data-dir={tmp_path / 'profile'}", f"--screenshot={picture}", page.as_uri(),
    ]  # fmt: skip
    subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=120, check=True)
    # Above the line of text at the bottom.
    pixels = decode_image(picture.read_bytes(), "PNG")[:190, :, :3]
    assert len({tuple(pixel) for row in pixels[::4, ::4].tolist() for pixel in row}) > 20


def test_a_folder_of_a_page_that_fails_keeps_the_files_of_others(
    run: Run, small: SmallScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = tmp_path / "site"

    def fail(*_: object) -> Iterator[bytes]:
        (site / "notes.txt").write_text("mine")
        raise StorageError("io", "fails")

    monkeypatch.setattr(export_html, "_blocks", fail)
    assert run("export-html", small.cogs, site, "--folder").code == 4
    assert [path.name for path in site.iterdir()] == ["notes.txt"]
