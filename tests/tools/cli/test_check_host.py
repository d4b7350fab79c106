"""check of a URL: output, JSON and exit status; files and folders beside it."""

from pathlib import Path

import pytest
from fault_server import FaultServer, serving, status
from running import Run, SmallScene


def test_a_url_gets_findings_and_remedies(run: Run, small: SmallScene) -> None:
    with serving(FaultServer(small.cogs.read_bytes())) as server:
        told = run("check", server.url(), "--hosts", "nginx,s3")
        assert told.code == 0
        assert "conforms to SPEC.md" in told.out
        assert "warning  cors-origin" in told.out
        assert "    nginx: add_header Access-Control-Allow-Origin" in told.out
        assert "    S3: aws s3api" in told.out
        assert "Caddy" not in told.out
        assert run("check", server.url(), "-q", "--strict").code == 3
        found = run("check", server.url(), "--json", "--headers-only")
        report = found.json
        assert (found.code, report["valid"], report["content_read"]) == (0, False, False)
        assert {x["host"] for x in report["remedies"]} > {"nginx", "caddy"}


def test_errors_of_host_and_scene_are_status_3_and_no_host_is_4(
    run: Run, small: SmallScene
) -> None:
    data = small.cogs.read_bytes()
    with serving(FaultServer(data[:-1] + bytes([data[-1] ^ 1]))) as server:
        told = run("check", server.url())
        assert told.code == 3
        assert "error    segment-crc              SPEC 5.3" in told.out
        server.always = status(404)
        told = run("check", server.url())
        assert (told.code, "http-status" in told.out) == (3, True)
        assert "was not read" in told.out
        url = server.url()
    assert run("check", url).code == 4


def test_files_and_folders_are_checked_by_the_same_command(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    folder = tmp_path / "scene"
    assert run("convert", small.cogs, f"{folder}/").code == 0
    for path in (small.cogs, folder, folder / "manifest.cogsm"):
        assert run("check", path).code == 0
    report = run("check", folder, "--json").json
    assert report == {"source": str(folder), "valid": True, "findings": []}
    next((folder / "segments").iterdir()).unlink()
    told = run("check", folder)
    assert (told.code, "segment-missing" in told.out) == (3, True)
    (folder / "manifest.cogsm").write_bytes(b"")
    assert "preamble-truncated" in run("check", folder).out
    assert run("check", tmp_path / "nothing.cogs").code == 4


@pytest.mark.parametrize("words", [["--headers-only"], ["--hosts", "iis"]])
def test_misuse(run: Run, small: SmallScene, words: list[str]) -> None:
    assert run("check", small.cogs, *words).code == 2
