"""The configurations of ``docs/guides/hosting.md``, in the servers they are for."""

import functools
import getpass
import json
import os
import re
import shutil
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from running import ROOT, SmallScene, program

import cogsplat
from cogsplat.formats.cogs.folder_writer import unpack_cogs
from cogsplat.tools.hosting.doctor import Diagnosis, diagnose

PAGE = (ROOT / "docs/guides/hosting.md").read_text(encoding="utf-8")
COMPRESSING = "gzip on; gzip_types application/octet-stream; gzip_proxied any; gzip_min_length 1;"


def needs(program: str) -> pytest.MarkDecorator:
    """Skip where a server is not installed."""
    there = shutil.which(program, path=f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/bin")
    return pytest.mark.skipif(not there, reason=f"needs {program}")


def recipe(heading: str) -> str:
    section = PAGE.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    return re.findall(r"^```text\n(.*?)^```$", section, re.MULTILINE | re.DOTALL)[0]


@functools.cache
def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@contextmanager
def running(words: list[str], folder: Path) -> Iterator[str]:
    port = free_port()
    environment = os.environ | {"HOME": str(folder), "XDG_DATA_HOME": str(folder)}
    environment["PATH"] += ":/usr/sbin"
    with subprocess.Popen(
        words, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as server:
        for _ in range(300):
            try:
                socket.create_connection(("127.0.0.1", port), 1).close()
                break
            except OSError:
                assert server.poll() is None, "the server ended"
                time.sleep(0.1)
        yield f"http://127.0.0.1:{port}/"
        server.terminate()


@pytest.fixture
def www(small: SmallScene, tmp_path: Path) -> Path:
    folder = tmp_path / "www"
    folder.mkdir()
    shutil.copyfile(small.cogs, folder / "scene.cogs")
    with cogsplat.open(small.cogs) as file:
        unpack_cogs(file, folder / "scene")
    return folder


def nginx(www: Path, server: str, http: str = "") -> list[str]:
    base = www.parent
    temporary = "".join(
        f"{kind}_temp_path {base}/{kind};\n"
        for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    # Of its own, nginx run by root serves as a user who may not read folders of tests.
    (base / "nginx.conf").write_text(
        f"user {getpass.getuser()}; daemon off; pid {base}/nginx.pid; error_log {base}/nginx.log;\n"
        f"events {{ }}\nhttp {{ access_log off; {temporary} {http}\n{server}\n}}\n"
    )
    return ["nginx", "-c", str(base / "nginx.conf"), "-e", str(base / "nginx.log")]


def examined(words: list[str], www: Path) -> tuple[Diagnosis, Diagnosis]:
    with running(words, www.parent) as url:
        return diagnose(f"{url}scene.cogs"), diagnose(f"{url}scene/")


def codes(found: Diagnosis) -> set[str]:
    assert found.content == []
    assert found.content_read
    return {finding.code for finding in found.host}


@needs("nginx")
def test_the_documented_nginx_configuration_has_no_findings(www: Path) -> None:
    text = recipe("nginx").replace("listen 80", f"listen 127.0.0.1:{free_port()}")
    file, folder = examined(nginx(www, text.replace("/var/www", str(www))), www)
    assert (codes(file), codes(folder)) == (set(), set())
    assert file.server.startswith("nginx")


@needs("nginx")
def test_nginx_that_compresses_scenes_ignores_ranges(www: Path) -> None:
    plain = f"server {{ listen 127.0.0.1:{free_port()}; root {www}; }}"
    file, folder = examined(
        nginx(www, plain, f"default_type application/octet-stream; {COMPRESSING}"), www
    )
    assert "http-encoding-range" in codes(file)
    assert "http-encoding-whole" in codes(folder)


@needs("caddy")
def test_the_documented_caddy_configuration_has_no_findings(www: Path) -> None:
    text = recipe("Caddy").replace("http://:80", f"http://127.0.0.1:{free_port()}")
    path = www.parent / "Caddyfile"
    path.write_text("{\n admin off\n}\n" + text.replace("/var/www", str(www)))
    words = ["caddy", "run", "--config", str(path), "--adapter", "caddyfile"]
    file, folder = examined(words, www)
    assert (codes(file), codes(folder)) == (set(), set())
    assert file.server == "Caddy"


@needs("caddy")
@pytest.mark.parametrize(
    ("spoken", "version", "found"),
    [("h1 h2", "HTTP/2", set()), ("h1", "HTTP/1.1", {"http-version"})],
    ids=["h2", "h1"],
)
def test_the_protocol_is_what_the_server_speaks(
    www: Path, spoken: str, version: str, found: set[str]
) -> None:
    """Caddy signs its certificate itself; the program is told of its authority as any other is."""
    base, port = www.parent, free_port()
    text = recipe("Caddy").replace("http://:80 {", f"https://127.0.0.1:{port} {{\n tls internal")
    (base / "Caddyfile").write_text(
        "{\n admin off\n skip_install_trust\n auto_https disable_redirects\n"
        f" servers {{\n  protocols {spoken}\n }}\n}}\n" + text.replace("/var/www", str(www))
    )
    authority = base / "caddy" / "pki" / "authorities" / "local" / "root.crt"
    words = ["caddy", "run", "--config", str(base / "Caddyfile"), "--adapter", "caddyfile"]
    with running(words, base):
        wait_for_certificate(authority, port)
        done = subprocess.run(
            program(["check", f"https://127.0.0.1:{port}/scene.cogs", "--json"]),
            env=os.environ | {"SSL_CERT_FILE": str(authority)},
            capture_output=True,
            text=True,
            check=False,
        )
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads(done.stdout)
    assert (report["http_version"], report["server"]) == (version, "Caddy")
    assert {finding["code"] for finding in report["host_findings"]} == found
    assert {remedy["code"] for remedy in report["remedies"]} == found
    assert report["valid"]


def wait_for_certificate(authority: Path, port: int) -> None:
    """Wait until a server that has begun to listen has signed what it shows."""
    for _ in range(100):
        try:
            context = ssl.create_default_context(cafile=authority)
            with (
                socket.create_connection(("127.0.0.1", port), 5) as plain,
                context.wrap_socket(plain, server_hostname="127.0.0.1"),
            ):
                return
        except OSError:
            time.sleep(0.1)
    pytest.fail("the server shows no certificate of its own authority")


def test_pythons_server_has_no_ranges_and_serves_folders(www: Path) -> None:
    words = [sys.executable, "-m", "http.server", "-b", "127.0.0.1", "-d", str(www)]
    file, folder = examined([*words, str(free_port())], www)
    assert codes(file) >= {"http-ranges-ignored", "http-etag-missing", "cors-origin"}
    severities = {x.code: x.severity for x in folder.host}
    assert severities["http-ranges-ignored"] == "note"
    assert "error" not in severities.values()
    assert codes(folder) >= {"http-etag-missing", "cache-immutable"}
