"""Batches: what is done is not done again, what fails does not stop the rest."""

import importlib
import json
import os
import shutil
import signal
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from running import Run, SmallScene, program

from cogsplat.codec.errors import CogsplatError
from cogsplat.tools.cli.encode import encode
from cogsplat.tools.terminal.config_file import settable_options
from cogsplat.tools.workflow import batch_manifest
from cogsplat.tools.workflow.batch_log import BatchLog, DoneEncode
from cogsplat.tools.workflow.batch_manifest import BatchScene, read_manifest

batch_module = importlib.import_module("cogsplat.tools.cli.batch")

OPTIONS = {
    name: option
    for name, option in settable_options(encode).items()
    if name in {"preset", "quality", "no-jitter", "cameras"}
}


TELL_OF_PROCESSES = """
import subprocess
start = subprocess.Popen.__init__
def told(self, *args, **options):
    start(self, *args, **options)
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
        ("{", "bad-manifest", "line 1: Expecting property name"),
        ("[1]", "bad-manifest", "line 1: is an array of 1, expected a JSON object"),
        ('\n{"input": "a", "output": NaN}', "bad-manifest", "line 2: NaN is no JSON number"),
        ("[" * 9999, "bad-manifest", "expected a JSON object"),
        ('{"a": ' + "[]," * 2_000_000, "json-too-long", "line 1"),
        ('{"input": "a", "output": "b", "size": 1}', "bad-manifest", "key 'size'"),
        ('{"input": "a"}', "bad-manifest", "output None, expected paths"),
        ('{"input": "a", "output": "b", "options": {"json": true}}', "bad-manifest", "'json'"),
        ('{"input": "a", "output": "b", "options": {"quality": [1]}}', "bad-manifest", "[1]"),
    ],
)
def test_a_malformed_entry_is_a_scene_with_an_error(
    tmp_path: Path, text: str, code: str, told: str
) -> None:
    path = tmp_path / "a.jsonl"
    path.write_text(f"{text}\n{entry('c', 'd')}")
    malformed, good = read_manifest(path, OPTIONS)
    assert good == BatchScene("c", "d", ())
    assert malformed.error is not None
    assert malformed.error.code == code
    assert told in malformed.error.message
    assert malformed.inputs == malformed.outputs == ()


def test_a_malformed_entry_of_toml_is_a_scene_with_an_error(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text('scene = [1, {input = "a", size = 1}, {input = "c", output = "d"}]')
    number, key, good = read_manifest(path, OPTIONS)
    assert good == BatchScene("c", "d", ())
    assert number.error is not None
    assert key.error is not None
    assert (number.error.code, key.error.code) == ("bad-manifest", "bad-manifest")
    assert "scene 1: int" in number.error.message
    assert "scene 2: key 'size'" in key.error.message


@pytest.mark.parametrize("spelling", ["b", "./b", "x/../b"])
def test_two_scenes_with_one_output_are_refused(tmp_path: Path, spelling: str) -> None:
    path = tmp_path / "a.jsonl"
    path.write_text(f"{entry('a', 'b')}\n{entry('c', spelling)}")
    with pytest.raises(CogsplatError, match=f"2 scenes with output '{spelling}'") as error:
        read_manifest(path, OPTIONS)
    assert error.value.code == "same-output"


def test_scenes_share_options_and_override_them(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text(
        '[options]\npreset = "fast"\nquality = 38\nno-jitter = true\n'
        '[[scene]]\ninput = "a.ply"\noutput = "a.cogs"\n'
        '[[scene]]\ninput = "b.ply"\noutput = "b.cogs"\n'
        'options = {quality = 30, no-jitter = false, cameras = "c.json"}\n'
    )
    assert read_manifest(path, OPTIONS) == [
        BatchScene("a.ply", "a.cogs", ("--preset=fast", "--quality=38", "--no-jitter")),
        BatchScene(
            "b.ply", "b.cogs", ("--preset=fast", "--quality=30", "--cameras=c.json"), ("c.json",)
        ),
    ]


@pytest.mark.parametrize(
    "text",
    [
        *("scene = 3", "scene = {}", "[[scene", "a = " * 9),
        *("options = 3", "options = {qualty = 30}", "options = {quality = [1]}", "[option]"),
    ],
)
def test_toml_that_is_no_manifest_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(CogsplatError) as error:
        read_manifest(path, OPTIONS)
    assert error.value.code == "bad-manifest"


def test_a_long_manifest_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(b"#" * (1 << 25))
    with pytest.raises(CogsplatError, match="is longer than") as error:
        read_manifest(path, OPTIONS)
    assert error.value.code == "bad-manifest"


def test_links_to_one_output_are_one_output(tmp_path: Path) -> None:
    (tmp_path / "b.cogs").symlink_to("c.cogs")
    path = tmp_path / "a.jsonl"
    path.write_text(entry("a", "b.cogs") + "\n" + entry("d", str(tmp_path / "c.cogs")))
    with pytest.raises(CogsplatError) as error:
        read_manifest(path, OPTIONS)
    assert error.value.code == "same-output"


@pytest.mark.parametrize(
    ("reads", "told"),
    [
        ({"a": "a"}, "a reads a,"),
        ({"a": "./b", "b": "a"}, "a reads b reads a,"),
        ({"d": "a", "a": "b", "b": "c", "c": "a"}, "reads"),
    ],
)
def test_scenes_that_read_each_other_are_refused(
    tmp_path: Path, reads: dict[str, str], told: str
) -> None:
    path = tmp_path / "a.jsonl"
    path.write_text(
        "\n".join(entry("s.ply", f"{a}.cogs", cameras=f"{b}.cogs") for a, b in reads.items())
    )
    with pytest.raises(CogsplatError) as error:
        read_manifest(path, OPTIONS)
    assert error.value.code == "circle-of-scenes"
    assert told in error.value.message.replace(".cogs", "")


@dataclass
class FakeEncodes:
    """Encodes that write the names of what they read, and fail for some outputs.

    `log` has the name of each output when its encode begins and ends.
    """

    folder: Path
    failing: frozenset[str] = frozenset()
    log: list[str] = field(default_factory=list)

    def __call__(self, words: list[str]) -> tuple[int, str, str]:
        name = words[-1]
        self.log.append(f"{name} begins")
        time.sleep(0.02)
        self.log.append(f"{name} ends")
        if name in self.failing:
            report = {"error": {"code": "no-splats", "message": "none", "exit_code": 3}}
            return 3, json.dumps(report), ""
        (self.folder / name).write_text(name)
        return 0, json.dumps({"bytes": len(name)}), ""


@pytest.fixture
def chain(tmp_path: Path) -> Path:
    """Manifest of four scenes, three of which read the output of another, two of which exist."""
    (tmp_path / "s.ply").write_text("scene")
    path = tmp_path / "a.jsonl"
    path.write_text(
        "\n".join(
            [
                entry("s.ply", "c.cogs", cameras="b.cogs"),
                entry("s.ply", "b.cogs", masks="sub/../a.cogs"),
                entry("s.ply", "d.cogs"),
                entry("s.ply", "a.cogs"),
                entry("a.cogs", "e.cogs"),
            ]
        )
    )
    return path


def fake_encodes(monkeypatch: pytest.MonkeyPatch, encodes: FakeEncodes) -> FakeEncodes:
    """Put encodes in the place of those in processes."""
    monkeypatch.setattr(batch_module._Batch, "_run", lambda self, words: encodes(words))
    monkeypatch.setattr(batch_manifest, "scene_files", lambda path: [path])
    return encodes


@pytest.mark.parametrize("jobs", [1, 2, 8])
def test_a_scene_waits_for_the_output_that_it_reads(
    run: Run, chain: Path, monkeypatch: pytest.MonkeyPatch, jobs: int
) -> None:
    encodes = fake_encodes(monkeypatch, FakeEncodes(chain.parent))
    told = run("batch", chain, "--jobs", jobs)
    assert told.code == 0, told.err
    lines = [json.loads(line) for line in told.out.splitlines()]
    assert [line["output"] for line in lines] == [f"{name}.cogs" for name in "cbdae"]
    for first, then in ("ab", "bc", "ae"):
        assert encodes.log.index(f"{first}.cogs ends") < encodes.log.index(f"{then}.cogs begins")
    if jobs == 1:
        assert [text[0] for text in encodes.log[::2]] == ["d", "a", "b", "e", "c"]
    encodes.log.clear()
    assert run("batch", chain, "--json").json["counts"] == {"done": 0, "skipped": 5, "failed": 0}
    assert encodes.log == []


def test_a_changed_output_encodes_anew_what_reads_it(
    run: Run, chain: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    encodes = fake_encodes(monkeypatch, FakeEncodes(chain.parent))
    assert run("batch", chain).code == 0
    encodes.log.clear()
    # As large as before: its own scene is up to date.
    (chain.parent / "b.cogs").write_text("other!")
    assert run("batch", chain).code == 0
    assert encodes.log == ["c.cogs begins", "c.cogs ends"]


def test_what_reads_a_failed_output_fails(
    run: Run, chain: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    encodes = fake_encodes(monkeypatch, FakeEncodes(chain.parent, frozenset({"a.cogs"})))
    # An output of an earlier run is no excuse.
    (chain.parent / "b.cogs").write_text("earlier")
    told = run("batch", chain, "--jobs", 2)
    assert told.code == 3
    found = {line["output"][0]: line for line in map(json.loads, told.out.splitlines())}
    assert {name for name, line in found.items() if line["status"] == "failed"} == set("abce")
    assert found["d"]["status"] == "done"
    assert found["a"]["error"]["code"] == "no-splats"
    for name, read in (("b", "sub/../a.cogs"), ("c", "b.cogs"), ("e", "a.cogs")):
        assert found[name]["error"]["code"] == "input-failed"
        assert found[name]["error"]["message"].startswith(f"{name}.cogs: reads {read}, which")
    assert {text[0] for text in encodes.log} == {"a", "d"}


def test_what_reads_the_output_of_a_malformed_entry_fails(
    run: Run, chain: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_encodes(monkeypatch, FakeEncodes(chain.parent))
    chain.write_text(
        entry("s.ply", "b.cogs", cameras="a.cogs") + "\n" + entry("s.ply", "a.cogs", qualty=3)
    )
    told = run("batch", chain)
    codes = [json.loads(line)["error"]["code"] for line in told.out.splitlines()]
    assert codes == ["input-failed", "bad-manifest"]


def test_malformed_entries_fail_alone(run: Run, small: SmallScene, tmp_path: Path) -> None:
    good = {"input": str(small.ply), "output": "good.cogs", "options": {"quality": 30}}
    good["options"] |= {"preset": "fast", "cameras": str(small.cameras)}
    wrong = {"input": str(small.ply), "output": "wrong.cogs", "options": {"qualty": 30}}
    manifest = tmp_path / "a.jsonl"
    manifest.write_text("\n".join(['{"input": "a.ply', json.dumps(wrong), json.dumps(good)]))
    told = run("batch", manifest)
    assert told.code == 3, told.err
    cut, unknown, done = (json.loads(line) for line in told.out.splitlines())
    assert done["status"] == "done"
    assert (cut["status"], cut["input"], cut["output"]) == ("failed", "", "")
    assert (unknown["status"], unknown["output"]) == ("failed", "wrong.cogs")
    for line, place in ((cut, "line 1"), (unknown, "line 2")):
        assert (line["error"]["code"], line["error"]["exit_code"]) == ("bad-manifest", 3)
        assert line["error"]["message"].startswith(f"{manifest}: {place}: ")
    assert {path.name for path in tmp_path.iterdir()} == {"a.jsonl", "a.jsonl.log", "good.cogs"}
    assert run("batch", manifest, "--json").json["counts"] == {"done": 0, "skipped": 1, "failed": 2}


def test_names_that_no_file_can_have_fail_alone(run: Run, tmp_path: Path) -> None:
    """Other scenes go on, and no name of a scene is an option or a stream."""
    names = ["a\0b.ply", "\ud800.ply", "-", "--help", "--force"]
    lines = [entry(name, f"{number}.cogs") for number, name in enumerate(names)]
    lines += [entry("gone.ply", "c\0.cogs"), entry("gone.ply", "-"), entry("gone.ply", "d.cogs")]
    lines += [entry("gone.ply", "e.cogs", cameras="c\0"), entry("gone.ply", "f.cogs", order="\0")]
    (tmp_path / "a.jsonl").write_text("\n".join(lines))
    told = run("batch", tmp_path / "a.jsonl")
    assert told.code == 3, told.err
    codes = [json.loads(line)["error"]["code"] for line in told.out.splitlines()]
    assert codes == [
        *("bad-manifest", "bad-manifest", "bad-manifest", "not-found", "not-found"),
        *("bad-manifest", "bad-manifest", "not-found", "bad-manifest", "bad-manifest"),
    ]


@pytest.mark.parametrize(
    ("log", "code"),
    [
        ("scene.ply", "output-is-input"),
        ("hard.ply", "output-is-input"),
        ("link.ply", "output-is-input"),
        ("cameras.json", "output-is-input"),
        ("a.jsonl", "output-is-input"),
        ("./a.cogs", "usage"),
        ("report.html", "usage"),
        ("notes.txt", "foreign-file"),
        ("link.txt", "not-a-file"),
        (".", "not-a-file"),
    ],
)
def test_a_log_is_never_another_file(
    run: Run, small: SmallScene, tmp_path: Path, log: str, code: str
) -> None:
    for path in (small.ply, small.cameras):
        shutil.copy(path, tmp_path / path.name)
    os.link(tmp_path / "scene.ply", tmp_path / "hard.ply")
    (tmp_path / "link.ply").symlink_to("scene.ply")
    (tmp_path / "notes.txt").write_text('{"input": "a.ply", "output": "a.cogs"}\n')
    (tmp_path / "own.log").write_text('{"log": "cogsplat batch"}\n')
    (tmp_path / "link.txt").symlink_to("own.log")
    manifest = tmp_path / "a.jsonl"
    manifest.write_text(entry("scene.ply", "a.cogs", cameras="cameras.json", report="report.html"))
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    told = run("batch", manifest, "--log", tmp_path / log)
    assert (told.code in (2, 4), f"[{code}]" in told.err) == (True, True), told.err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def lines_of(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_log_tells_own_outputs_from_others(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    done = {"output": "a", "status": "done", "fingerprint": "f", "result": {"bytes": 3}}
    with BatchLog(path, tmp_path) as log:
        assert not log.owns("a")
        log.write({"output": "./a", "status": "started"})
        log.write(done)
        log.write({"output": "b", "status": "started"})
        log.write({"output": "b", "status": "failed"})
        log.write({"output": "c", "status": "started"})
        log.write({"output": "a", "status": "started"})
        log.write({"output": "a", "status": "failed"})
    with path.open("a") as file:
        file.write('["output"]\n{"output": "x\\u0000"}\n{"output": 3}\n' + "[" * 9999 + '\n{"outp')
    with BatchLog(path, tmp_path) as log:
        owned = [log.owns(name) for name in ("a", "x/../a", "b", "c", "d", "log")]
        assert owned == [True, True, False, True, False, False]
        assert log.done("./a") == DoneEncode("f", 3)
        log.write({"output": "d", "status": "started"})
    with BatchLog(path, tmp_path) as log:
        # The half of a line before it does not swallow it.
        assert log.owns("d")
    assert path.read_text().startswith('{"log": "cogsplat batch"}\n')
    assert path.read_text().count('"cogsplat batch"') == 1


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


def test_a_fingerprint_covers_the_files_that_options_name(
    small: SmallScene, tmp_path: Path
) -> None:
    """Of a COLMAP folder the model, not the photos beside it."""
    shutil.copy(small.ply, tmp_path / "a.ply")
    model = tmp_path / "colmap" / "sparse" / "0"
    model.mkdir(parents=True)
    paths = [tmp_path / "c.json", tmp_path / "masks" / "a" / "1.png"]
    paths += [model / "cameras.bin", model / "images.bin"]
    photo = tmp_path / "colmap" / "photo.jpg"
    for path in (*paths, photo):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"0")
    scene = BatchScene("a.ply", "a.cogs", (), ("c.json", "masks", "colmap", "missing.json"))
    seen = {scene.fingerprint(tmp_path)}
    for path in paths:
        path.write_bytes(b"1")
        assert scene.fingerprint(tmp_path) not in seen
        seen.add(scene.fingerprint(tmp_path))
    paths[1].rename(paths[1].with_name("2.png"))
    assert scene.fingerprint(tmp_path) not in seen
    seen = {scene.fingerprint(tmp_path)}
    photo.write_bytes(b"1")
    assert scene.fingerprint(tmp_path) in seen


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
    log = lines_of(tmp_path / "scenes.jsonl.log")
    assert log.pop(0) == {"log": "cogsplat batch"}
    assert log.pop([line["status"] for line in log].index("started"))["output"] == "a.cogs"
    assert sorted(log, key=str) == sorted([done, failed], key=str)

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
    assert run("batch", manifest, "--json").json["counts"]["skipped"] == 1


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
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["scenes.jsonl", "scenes.jsonl.log"]


def alive(number: int) -> bool:
    """Whether a process runs; one that waits for its parent to read its status does not."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").exists(), reason="needs /proc")
def test_a_killed_batch_leaves_no_encode_and_is_continued(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    """The encode ends with its parent; the same command replaces the unfinished file."""
    manifest = tmp_path / "scenes.jsonl"
    manifest.write_text(entry(small.ply, "a.cogs", preset="best"))
    words = program(["batch", manifest], before=TELL_OF_PROCESSES.replace('"started"', "self.pid"))
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        child = int(process.stdout.readline())
        assert alive(child)
        process.kill()
    until = time.monotonic() + 60
    while alive(child) and time.monotonic() < until:
        time.sleep(0.1)
    assert not alive(child)
    # As if the encode had just finished when the batch was killed.
    (tmp_path / "a.cogs").write_bytes(b"half")
    manifest.write_text(entry(small.ply, "a.cogs", preset="fast"))
    told = run("batch", manifest, "--json")
    assert told.json["counts"] == {"done": 1, "skipped": 0, "failed": 0}, told.out
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["a.cogs", "scenes.jsonl", "scenes.jsonl.log"]
