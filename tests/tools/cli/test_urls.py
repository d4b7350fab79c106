"""Scenes by their URLs, on the command line."""

import json

import pytest
from cogs_samples import file_of, scene
from fault_server import FaultServer, serving, status

import cogsplat


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
    assert run("validate", server.url()).code == 0
    assert server.url() in run("stats", server.url()).out
    assert run("convert", server.url(), tmp_path / "a.splat").code == 0
    assert run("decode", server.url("scene"), tmp_path / "b.ply").code == 0
    assert (tmp_path / "b.ply").stat().st_size > len(server.data)


def test_scenes_of_other_formats_by_their_urls(run, tmp_path):
    cogsplat.write(scene(500), tmp_path / "a.ply")
    with serving(FaultServer((tmp_path / "a.ply").read_bytes())) as server:
        told = run("info", server.url("a.ply?key=secret"), "--json").json
        assert told["splats"] == 500
        assert told["source"] == server.url("a.ply")


@pytest.mark.parametrize("command", ["info", "validate"])
def test_refusals_are_told_with_their_address(run, command):
    with serving(FaultServer(b"", always=status(404))) as server:
        told = run(command, server.url("scene.cogs?key=secret"), "--json")
    assert told.code == 4
    error = json.loads(told.out)["error"]
    assert error["code"] == "not-found"
    assert error["message"].startswith(server.url())
    assert "secret" not in told.out
