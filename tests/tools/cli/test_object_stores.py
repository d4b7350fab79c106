"""Scenes from object stores and into them, on the command line."""

import json
from collections.abc import Iterator
from pathlib import Path

import obstore
import pytest
from obstore.store import ObjectStore, from_url
from running import Run, SmallScene
from s3_server import s3_server

import cogsplat
from cogsplat.formats.network.object_output import ObjectOutput

pytestmark = pytest.mark.slow

FAST = ["--preset", "fast", "--no-jitter"]


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    with s3_server() as url:
        yield url


@pytest.fixture(autouse=True)
def bucket(server: str, monkeypatch: pytest.MonkeyPatch) -> str:
    """The address of a bucket, which the environment leads to."""
    found = {
        "AWS_ENDPOINT": server,
        "AWS_REGION": "us-east-1",
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
    }
    for name, value in found.items():
        monkeypatch.setenv(name, value)
    return "s3://bucket"


def store() -> ObjectStore:
    return from_url("s3://bucket", client_options={"allow_http": True})


def stored(name: str) -> bytes:
    return obstore.get(store(), name).bytes().to_bytes()


def test_a_scene_goes_into_a_store_and_comes_out_of_it(
    run: Run, small: SmallScene, tmp_path: Path, bucket: str
) -> None:
    assert run("convert", small.ply, f"{bucket}/in/scene.ply").code == 0
    told = run("encode", f"{bucket}/in/scene.ply", f"{bucket}/out/scene.cogs",
               "--cameras", small.cameras, *FAST, "--json")  # fmt: skip
    assert told.code == 0, told.out
    assert told.json["output"] == f"{bucket}/out/scene.cogs"
    data = stored("out/scene.cogs")
    assert len(data) == told.json["bytes"]
    headers = obstore.get(store(), "out/scene.cogs").attributes
    assert headers["Cache-Control"] == "no-cache, no-transform"
    here = tmp_path / "here.cogs"
    assert run("encode", small.ply, here, "--cameras", small.cameras, *FAST).code == 0
    assert data == here.read_bytes()
    assert run("info", f"{bucket}/out/scene.cogs", "--json").json["splats"] > 0


def test_what_is_there_is_replaced_only_by_force(run: Run, small: SmallScene, bucket: str) -> None:
    words = ["convert", small.ply, f"{bucket}/scene.splat"]
    assert run(*words).code == 0
    refused = run(*words, "--json")
    assert refused.code == 2
    error = json.loads(refused.out)["error"]
    assert (error["code"], error["message"].partition(":")[0]) == ("exists", "s3")
    assert run("convert", "--force", *words[1:]).code == run(*words, "--force").code == 0
    # Nothing is left of a command that fails.
    assert run("convert", small.ply, f"{bucket}/none.splat", "--crop", "9,9,9,8,8,8").code == 2
    assert ObjectOutput(f"{bucket}/none.splat").size() is None


def test_files_beside_the_named_one_are_sent_too(
    run: Run, small: SmallScene, tmp_path: Path, bucket: str
) -> None:
    assert run("convert", small.ply, f"{bucket}/sog/meta.json").code == 0
    listed = json.loads(stored("sog/meta.json"))
    for name in listed["means"]["files"]:
        path = tmp_path / name
        path.write_bytes(stored(f"sog/{name}"))
        assert path.stat().st_size > 0


def test_web_servers_and_unknown_buckets_are_refused(
    run: Run, small: SmallScene, bucket: str
) -> None:
    told = run("convert", small.ply, "https://example.org/a.splat")
    assert (told.code, "web servers accept no files" in told.err) == (2, True)
    told = run("convert", small.ply, "s3://no-such-bucket/a.splat", "--json")
    assert json.loads(told.out)["error"]["code"] in {"not-found", "store-failed"}


def test_a_batch_from_a_store_into_a_store(
    run: Run, small: SmallScene, tmp_path: Path, bucket: str
) -> None:
    for name in ("a", "b"):
        assert run("convert", small.ply, f"{bucket}/batch/{name}.ply").code == 0
    manifest = tmp_path / "scenes.jsonl"
    options = {"preset": "fast", "no-jitter": True, "cameras": str(small.cameras)}
    manifest.write_text(
        "".join(
            json.dumps(
                {
                    "input": f"{bucket}/batch/{name}.ply",
                    "output": f"{bucket}/batch/{name}.cogs",
                    "options": options,
                }
            )
            + "\n"
            for name in ("a", "b", "missing")
        )
    )
    told = run("batch", manifest, "--json")
    assert (told.code, told.json["counts"]) == (3, {"done": 2, "skipped": 0, "failed": 1})
    failed = told.json["scenes"][2]  # type: ignore[index]
    assert failed["error"]["code"] == "not-found"
    assert stored("batch/a.cogs") == stored("batch/b.cogs")
    (tmp_path / "a.cogs").write_bytes(stored("batch/a.cogs"))
    assert len(cogsplat.decode(tmp_path / "a.cogs"))
    # Another version of one input, and an output that is gone.
    assert run("convert", small.ply, f"{bucket}/batch/a.ply", "--scale", "2", "--force").code == 0
    obstore.delete(store(), "batch/b.cogs")
    assert run("batch", manifest, "--json").json["counts"] == {
        "done": 2, "skipped": 0, "failed": 1,
    }  # fmt: skip
    assert run("batch", manifest, "--json").json["counts"] == {
        "done": 0, "skipped": 2, "failed": 1,
    }  # fmt: skip
