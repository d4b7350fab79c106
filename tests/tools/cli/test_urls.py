"""Scenes by their URLs, on the command line."""

import json

import pytest
from cogs_samples import file_of, scene
from fault_server import FaultServer, serving, status

import cogsplat
from cogsplat.tools.terminal import progress_bars


@pytest.fixture(scope="module")
def server():
    with serving(FaultServer(file_of("vq", 6000, 3, 500))) as made:
        yield made


@pytest.fixture(autouse=True)
def nothing_asked(server):
    server.asked.clear()


def test_info_reads_the_index_alone(run, server):
    told = run("info", server.url(), "--json").json
    assert told["splats"] == 6000
    assert told["source"] == server.url()
    assert [(asked.first, asked.end) for asked in server.asked] == [(0, 65536)]


def test_decode_reads_what_it_decodes(run, server, tmp_path):
    told = run("decode", server.url(), tmp_path / "a.ply", "--bytes", "30%", "--json").json
    assert told["source"] == server.url()
    assert len(cogsplat.read(tmp_path / "a.ply")) == told["splats"]
    assert max(asked.end for asked in server.asked) <= max(65536, 0.3 * len(server.data))


def test_other_commands_fetch_the_file(run, server, tmp_path):
    assert run("check", server.url()).code == 0
    assert server.url() in run("info", server.url(), "--statistics").out
    assert run("convert", server.url(), tmp_path / "a.splat").code == 0
    assert run("decode", server.url("scene"), tmp_path / "b.ply").code == 0
    assert (tmp_path / "b.ply").stat().st_size > len(server.data)


def test_scenes_of_other_formats_by_their_urls(run, tmp_path):
    cogsplat.write(scene(500), tmp_path / "a.ply")
    with serving(FaultServer((tmp_path / "a.ply").read_bytes())) as server:
        told = run("info", server.url("a.ply?key=secret"), "--json").json
        assert told["splats"] == 500
        assert told["source"] == server.url("a.ply")


@pytest.mark.parametrize("command", ["info", "convert"])
def test_refusals_are_told_with_their_address(run, tmp_path, command):
    with serving(FaultServer(b"", always=status(404))) as server:
        out = [tmp_path / "a.ply"] if command == "convert" else []
        told = run(command, server.url("scene.cogs?key=secret"), *out, "--json")
    assert told.code == 4
    error = json.loads(told.out)["error"]
    assert error["code"] == "not-found"
    assert error["message"].startswith(server.url())
    assert "secret" not in told.out


def test_a_fetch_of_a_whole_file_is_shown(run, server, tmp_path, monkeypatch):
    # Every report is a line, however fast it comes.
    monkeypatch.setattr(progress_bars, "_LINE_EVERY", 0.0)
    parts = 1 + -(-(len(server.data) - 65536) // (1 << 20))
    expected = [f"fetch {part}/{parts}" for part in range(1, parts + 1)]
    assert parts > 1

    def fetch_lines(*arguments):
        done = run(*arguments, "--force")
        assert done.code == 0
        return [line for line in done.err.splitlines() if line.startswith("fetch")]

    out = tmp_path / "a.splat"
    assert fetch_lines("convert", server.url(), out) == expected
    assert fetch_lines("convert", server.url(), out, "--quiet") == []
    assert fetch_lines("convert", server.url(), out, "--json") == []


def test_a_scene_that_turns_out_to_be_fetched_is_shown(run, tmp_path, monkeypatch):
    monkeypatch.setattr(progress_bars, "_LINE_EVERY", 0.0)
    cogsplat.write(scene(2000), tmp_path / "a.ply")
    with serving(FaultServer((tmp_path / "a.ply").read_bytes())) as server:
        assert "fetch 1/2\nfetch 2/2" in run("info", server.url("a.ply")).err
        assert "fetch" not in run("info", server.url("a.ply"), "--json").err
