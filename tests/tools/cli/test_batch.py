"""Batches: what is done is not done again, what fails does not stop the rest."""

import json
import os
import signal
import subprocess
from pathlib import Path

import pytest
from running import Run, SmallScene, program

from cogsplat.codec.errors import CogsplatError
from cogsplat.tools.cli.encode import encode
from cogsplat.tools.terminal.config_file import settable_options
from cogsplat.tools.workflow.batch_manifest import BatchScene, read_manifest

OPTIONS = {
    name: option
    for name, option in settable_options(encode).items()
    if name in {"preset", "quality", "no-jitter", "cameras"}
}


TELL_OF_PROCESSES = """
import subprocess
start = subprocess.Popen.__init__
def told(*args, **options):
    start(*args, **options)
    print("started", flush=True)
subprocess.Popen.__init__ = told
"""


def entry(input: object, output: str, **options: object) -> str:  # noqa: A002 - the key's name
    return json.dumps({"input": str(input), "output": output, "options": options})


def test_both_forms_of_a_manifest_say_the_same(tmp_path: Path) -> None:
    lines, toml = tmp_path / "a.jsonl", tmp_path / "a.toml"
    options = {"preset": "fast", "quality": 38.5, "no-jitter": True}
    lines.write_text(entry("a.ply", "a.cogs", **options) + "\n\n" + entry("b.ply", "b.cogs"))
    toml.write_text(
        '[[scene]]\ninput = "a.ply"\noutput = "a.cogs"\n'
        'options = {preset = "fast", quality = 38.5, no-jitter = true}\n'
        '[[scene]]\ninput = "b.ply"\noutput = "b.cogs"\noptions.no-jitter = false\n'
    )
    expected = [
        BatchScene("a.ply", "a.cogs", ("--preset=fast", "--quality=38.5", "--no-jitter")),
        BatchScene("b.ply", "b.cogs", ()),
    ]
    assert read_manifest(lines, OPTIONS) == read_manifest(toml, OPTIONS) == expected


@pytest.mark.parametrize(
    ("text", "code", "told"),
    [
        ("{", "bad-manifest", "expected JSON lines"),
        ("[1]", "bad-manifest", "line 1: list, expected an object"),
        ('{"input": "a", "output": "b", "size": 1}', "bad-manifest", "key 'size'"),
        ('{"input": "a"}', "bad-manifest", "output None, expected paths"),
        ('{"input": "a", "output": "b", "options": {"json": true}}', "bad-manifest", "'json'"),
        ('{"input": "a", "output": "b", "options": {"quality": [1]}}', "bad-manifest", "[1]"),
        ('{"input": "a", "output": "b"}\n{"input": "c", "output": "b"}', "same-output", "2 scenes"),
    ],
)
def test_manifests_that_are_none_are_refused(
    tmp_path: Path, text: str, code: str, told: str
) -> None:
    path = tmp_path / "a.jsonl"
    path.write_text(text)
    with pytest.raises(CogsplatError) as error:
        read_manifest(path, OPTIONS)
    assert error.value.code == code
    assert told in error.value.message


def test_a_fingerprint_follows_what_the_output_depends_on(small: SmallScene) -> None:
    folder, name = small.ply.parent, small.ply.name
    scene = BatchScene(name, "a.cogs", ("--preset=fast",))
    assert scene.fingerprint(folder) == scene.fingerprint(folder)
    others = [
        BatchScene(name, "b.cogs", scene.words),
        BatchScene(name, "a.cogs", ()),
        BatchScene(small.cogs.name, "a.cogs", scene.words),
    ]
    assert scene.fingerprint(folder) not in [other.fingerprint(folder) for other in others]


@pytest.mark.slow
def test_a_batch_goes_on_where_it_ended(run: Run, small: SmallScene, tmp_path: Path) -> None:
    manifest = tmp_path / "scenes.jsonl"
    good = entry(small.ply, "a.cogs", preset="fast", cameras=str(small.cameras))
    manifest.write_text("\n".join([good, entry("gone.ply", "b.cogs")]))
    first = run("batch", manifest, "--jobs", 2)
    assert first.code == 3
    done, failed = (json.loads(line) for line in first.out.splitlines())
    assert (done["status"], failed["status"]) == ("done", "failed")
    assert done["result"]["bytes"] == (tmp_path / "a.cogs").stat().st_size
    assert failed["error"]["exit_code"] == 4
    assert "1 done, 0 skipped, 1 failed" in first.err
    log = [json.loads(line) for line in (tmp_path / "scenes.jsonl.log").read_text().splitlines()]
    assert log == [done, failed]

    # A line that was cut off, and a scene that another option makes again.
    with (tmp_path / "scenes.jsonl.log").open("a") as file:
        file.write('{"input": "a.ply", "outp')
    manifest.write_text(good)
    assert json.loads(run("batch", manifest).out)["status"] == "skipped"
    manifest.write_text(
        entry(small.ply, "a.cogs", preset="fast", cameras=str(small.cameras), quality=30)
    )
    again = run("batch", manifest, "--json")
    assert again.code == 0
    assert again.json["counts"] == {"done": 1, "skipped": 0, "failed": 0}
    assert (tmp_path / "a.cogs").stat().st_size < done["result"]["bytes"]


@pytest.mark.slow
def test_what_is_not_of_a_batch_is_not_replaced(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    (tmp_path / "a.cogs").write_bytes(b"mine")
    (tmp_path / "scenes.jsonl").write_text(entry(small.ply, "a.cogs", preset="fast"))
    told = run("batch", tmp_path / "scenes.jsonl")
    assert told.code == 3
    assert json.loads(told.out)["error"]["code"] == "exists"
    assert (tmp_path / "a.cogs").read_bytes() == b"mine"


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_stopped_batch_leaves_no_half_of_a_file(small: SmallScene, tmp_path: Path) -> None:
    manifest = tmp_path / "scenes.jsonl"
    manifest.write_text(entry(small.ply, "a.cogs", preset="best"))
    words = program(["batch", manifest], before=TELL_OF_PROCESSES)
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "started\n"
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 130
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scenes.jsonl"]
