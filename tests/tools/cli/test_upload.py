"""``cogsplat upload`` to a server that speaks S3."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from running import ROOT, Run, SmallScene
from s3_server import s3_server


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with s3_server() as url:
        yield url


@pytest.mark.slow
def test_a_folder_goes_to_a_bucket(
    run: Run, small: SmallScene, tmp_path: Path, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "key")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    folder = tmp_path / "scene"
    assert run("convert", small.cogs, f"{folder}/").code == 0
    count = len(list((folder / "segments").iterdir()))
    words = ["upload", folder, "s3://bucket/a/scene", "--endpoint", endpoint, "--region", "x"]
    planned = run(*words, "--dry-run", "--json").json
    assert (planned["dry_run"], planned["objects_written"]) == (True, count)
    done = run(*words, "--json").json
    assert (done["objects_written"], done["manifest_written"]) == (count, True)
    again = run(*words, "--json", "--delete", "--yes").json
    assert (again["objects_shared"], again["manifest_written"]) == (count, False)
    page = (ROOT / "docs/reference/json.md").read_text(encoding="utf-8")
    listed = page.partition("### `upload`\n")[2].partition("### ")[0]
    keys = {key.partition(".")[0] for key in re.findall("`([^`]+)`", listed)}
    assert done.keys() == again.keys() == keys
    assert "the same" in run(*words).out
    # A new title is the manifest alone.
    assert run("describe", folder, "--title", "Garden", "--force").code == 0
    titled = run(*words, "--json").json
    assert (titled["objects_written"], titled["manifest_written"]) == (0, True)
    # Asked and not answered, nothing is deleted.
    (folder / "manifest.cogsm").rename(folder / "other.cogsm")
    assert run("upload", folder / "other.cogsm", *words[2:]).code == 0
    assert "0 objects deleted" in run(
        "upload", folder / "other.cogsm", *words[2:], "--delete", "--older-than", "0"
    ).out  # fmt: skip


def test_misuse_is_told(run: Run, small: SmallScene, tmp_path: Path) -> None:
    told = run("upload", small.cogs, "s3://bucket/a")
    assert told.code == 2
    assert "cogsplat convert" in told.err
    assert run("convert", small.cogs, f"{tmp_path}/scene/").code == 0
    assert run("upload", tmp_path / "scene", "s3://bucket/a", "--partial").code == 2
    told = run("upload", tmp_path / "scene", "https://example.org/a")
    assert (told.code, "[bucket-address]" in told.err) == (4, True)
