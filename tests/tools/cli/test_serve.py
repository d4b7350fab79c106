import json
import os
import signal
import subprocess

import httpx
import pytest
from running import program

from cogsplat.tools.cli.serve import BitRate
from cogsplat.tools.delivery.file_server import FileServer


@pytest.mark.parametrize(
    ("text", "rate"),
    [("10M", 10e6), ("500k", 5e5), ("1.5mbit/s", 1.5e6), ("8000", 8000.0), ("1Gbps", 1e9)],
)
def test_rates(text, rate):
    assert BitRate().convert(text, None, None) == rate


@pytest.mark.parametrize("text", ["0", "fast", "-1M", "10MB", "1e6"])
def test_rates_that_are_none(run, text):
    assert run("serve", ".", "--throttle", text).code == 2


def test_what_is_not_there_is_told(run, tmp_path):
    told = run("serve", tmp_path / "no.cogs", "--json")
    assert told.code == 4
    assert told.json["error"]["code"] == "not-found"


def test_urls_are_percent_encoded(run, tmp_path, monkeypatch):
    monkeypatch.setattr(FileServer, "serve_forever", lambda self: None)
    path = tmp_path / "50% #1?.txt"
    path.write_text("text")
    told = run("serve", path, "--json").json
    assert told["url"] == told["scene_url"]
    assert str(told["url"]).endswith("/50%25%20%231%3F.txt")


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C as a signal")
@pytest.mark.parametrize("what", ["file", "folder"])
def test_a_scene_is_served_until_it_is_stopped(small, what):
    path = small.cogs if what == "file" else small.cogs.parent
    command = program(["serve", path, "--json", "--latency", "1", "--throttle", "100M"])
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            assert process.stderr is not None
            told = b""
            while not told.endswith(b"}\n"):
                line = process.stdout.readline()
                assert line, process.stderr.read()
                told += line
            url = json.loads(told)["url"]
            # A connection that stays open does not hold the server up.
            with httpx.Client() as client:
                answer = client.get(f"{url}{small.cogs.name}", headers={"Range": "bytes=0-9"})
                assert (answer.status_code, answer.content) == (206, small.cogs.read_bytes()[:10])
                page = client.get(url)
                assert page.status_code == (200 if what == "file" else 404)
                process.send_signal(signal.SIGINT if what == "file" else signal.SIGTERM)
                assert process.wait(60) == 0
            assert process.stderr.read() == b""
        finally:
            process.kill()
