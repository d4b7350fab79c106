"""The command line as a whole: help, JSON, failures, signals, outputs that go away."""

import errno
import json
import os
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from running import ROOT, Run, SmallScene, all_commands, program

import cogsplat
from cogsplat.codec.errors import CogsplatWarning, DataError
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.tools.lab.synthetic.terrace import synth_cameras
from cogsplat.tools.main import cli
from cogsplat.tools.terminal.command_line import CommandLine

posix = pytest.mark.skipif(os.name != "posix", reason="signals and descriptors of POSIX")


@pytest.mark.parametrize("name", all_commands())
def test_every_command_has_help_with_an_example_and_json(run: Run, name: str) -> None:
    shown = run(*name.split(), "--help")
    assert shown.code == 0
    assert f"\n    cogsplat {name}" in shown.out
    assert "--json" in shown.out
    assert all(len(line) <= 80 for line in shown.out.splitlines())


def test_a_command_that_is_not_there_is_refused_with_one_that_is() -> None:
    """A new process, in which no command has been loaded yet, suggests the nearest command."""
    told = subprocess.run(program(["encoed"]), capture_output=True, text=True, check=False)
    assert told.returncode == 2
    assert "encode" in told.stderr


def test_a_command_imports_no_other() -> None:
    after = "import atexit; atexit.register(lambda: print(*sys.modules))"
    told = subprocess.run(
        program(["info", "--help"], after), capture_output=True, text=True, check=True
    )
    loaded = set(told.stdout.split())
    assert "cogsplat.tools.cli.info" in loaded
    assert not {"cogsplat.tools.cli.encode", "cogsplat.tools.lab.cli.simulate"} & loaded


def test_at_most_twenty_commands_stand_at_the_top() -> None:
    assert len(cli.list_commands(click.Context(cli))) <= 20


def test_commands_are_listed_in_the_order_of_their_use(run: Run) -> None:
    shown = run("--help").out
    names = [
        "encode",
        "decode",
        "convert",
        "info",
        "check",
        "compare",
        "render",
        "demo",
        "lab",
    ]
    places = [shown.index(f"\n  {name} ") for name in names]
    assert places == sorted(places)
    listed = [line for line in shown.splitlines() if line.startswith("  ")]
    assert not any(line.endswith("...") for line in listed), "a summary was cut"


def test_without_arguments_the_help_is_shown_as_misuse(run: Run) -> None:
    shown = run()
    assert (shown.code, shown.out) == (2, "")
    assert "Commands:" in shown.err


def test_version_names_program_and_format(run: Run) -> None:
    shown = run("--version")
    assert shown.code == 0
    assert shown.out.startswith("cogsplat ")
    assert "COGS 0." in shown.out


@pytest.mark.parametrize(
    "arguments",
    [
        ["bogus"],
        ["--bogus"],
        ["encode"],
        ["encode", "a.ply", "b.cogs", "--profile", "huge"],
        ["encode", "a.ply", "b.cogs", "--quality", "5"],
        ["encode", "a.ply", "b.cogs", "--prune", "0.1", "--no-prune"],
        ["decode", "a.cogs", "b.ply", "--chunks", "1"],
        ["decode", "a.cogs", "b.ply", "--bytes", "101%"],
        ["decode", "a.cogs", "b.ply", "--bytes", "1KiB", "--splats", "3"],
        ["decode", "a.cogs", "b.ply", "--sh", "4"],
        ["render", "a.cogs", "b.png", "--size", "0x5"],
        ["render", "a.cogs", "b.png", "--background", "2,0,0"],
        ["lab", "score", "a.ply", "b.npy", "--threads", "-1"],
    ],
)
def test_misuse_exits_with_2_as_text_and_as_json(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    told = run(*arguments)
    assert (told.code, told.out) == (2, "")
    assert "[usage]" in told.err
    assert "--help'" in told.err
    told = run(*arguments, "--json")
    assert (told.code, told.err) == (2, "")
    error = told.json["error"]
    assert isinstance(error, dict)
    assert (error["code"], error["exit_code"]) == ("usage", 2)
    assert list(tmp_path.iterdir()) == []


def group_with(failure: BaseException) -> CommandLine:
    @click.command
    @click.option("--json", "as_json", is_flag=True)
    def fail(as_json: bool) -> None:
        raise failure

    group = CommandLine("cogsplat")
    group.add_command(fail)
    return group


@pytest.mark.parametrize(
    ("failure", "code", "reason"),
    [
        (MemoryError("Unable to allocate 51 GiB"), 5, "memory"),
        (KeyboardInterrupt(), 130, "cancelled"),
        (ModuleNotFoundError("no numba", name="numba"), 4, "needs-extra"),
        (ModuleNotFoundError("no PIL", name="PIL.Image"), 4, "needs-extra"),
    ],
)
def test_what_goes_wrong_outside_the_program_has_its_code(
    failure: BaseException, code: int, reason: str
) -> None:
    group = group_with(failure)
    told = CliRunner().invoke(group, ["fail"])
    assert (told.exit_code, told.stdout) == (code, "")
    assert told.stderr.splitlines()[0].endswith(f"[{reason}]")
    assert "Traceback" not in told.stderr
    told = CliRunner().invoke(group, ["fail", "--json"])
    assert told.exit_code == code
    assert json.loads(told.stdout)["error"]["code"] == reason


@pytest.mark.parametrize("form", [[], ["--json"]])
@pytest.mark.parametrize(("number", "reason"), [("ENOSPC", "disk-full"), ("EIO", "io")])
def test_output_that_fails_is_told_where_it_arrives(
    number: str, reason: str, form: list[str]
) -> None:
    failure = OSError(getattr(errno, number), "as the system says")
    told = CliRunner().invoke(group_with(failure), ["fail", *form])
    assert (told.exit_code, told.stdout) == (4, "")
    assert told.stderr.endswith(f"[{reason}]\n")


def test_interruption_is_said_in_one_word() -> None:
    assert "interrupted" in CliRunner().invoke(group_with(KeyboardInterrupt()), ["fail"]).stderr


def test_faults_of_the_program_are_not_dressed_up() -> None:
    for failure in (RuntimeError("bug"), ModuleNotFoundError("no bug", name="bug")):
        told = CliRunner().invoke(group_with(failure), ["fail"])
        assert told.exit_code == 1
        assert told.exception is failure


def test_warnings_are_told_once_or_kept_for_json() -> None:
    from cogsplat.tools.terminal.output import print_json

    @click.command
    @click.option("--json", "as_json", is_flag=True)
    def warn(as_json: bool) -> None:
        for _ in range(2):
            warnings.warn("rows are left out", CogsplatWarning, stacklevel=1)
        if as_json:
            print_json({"splats": 3})

    group = CommandLine("cogsplat")
    group.add_command(warn)
    told = CliRunner().invoke(group, ["warn"])
    assert told.stderr == "warning: rows are left out\n"
    told = CliRunner().invoke(group, ["warn", "--json"])
    assert told.stderr == ""
    assert json.loads(told.stdout) == {"splats": 3, "warnings": ["rows are left out"]}


WITHOUT_EXTRAS = (
    "sys.modules.update(dict.fromkeys(('numba', 'scipy', 'sklearn', 'PIL', 'plyfile', "
    "'threadpoolctl', 'skimage')))"
)


def test_core_alone_decodes_and_inspects(run_apart: Run, small: SmallScene, tmp_path: Path) -> None:
    out = tmp_path / "out.ply"
    for arguments in (
        ["decode", small.cogs, out],
        ["info", small.cogs, "--statistics", "--json"],
        ["info", out],
        ["check", small.cogs],
        ["convert", small.cogs, tmp_path / "out.spz", "--rotate", "90,0,0"],
        ["convert", tmp_path / "out.spz", tmp_path / "out.glb"],
        ["lab synth", tmp_path / "synth.ply", "--splats", 50],
    ):
        done = run_apart(*arguments, before=WITHOUT_EXTRAS)
        assert done.code == 0, done.err


@pytest.mark.parametrize("command", ["encode", "lab score", "render", "compare", "demo"])
def test_what_takes_the_extra_says_so(
    run_apart: Run, small: SmallScene, tmp_path: Path, command: str
) -> None:
    target = "." if Path.cwd() == ROOT else ROOT
    out = tmp_path / "out"
    arguments: list[object] = [command, small.ply, out]
    if command == "compare":
        arguments = [command, small.ply, small.cogs]
    if command == "demo":
        arguments = [command, "--out", out]
    done = run_apart(*arguments, "--json", before=WITHOUT_EXTRAS)
    assert done.code == 4
    error = done.json["error"]
    assert isinstance(error, dict)
    assert error["code"] == "needs-extra"
    assert "pip install 'cogsplat[encode]'" in str(error["message"])
    # The tests run from a checkout, where the name alone would ask the package index.
    assert str(error["hint"]).startswith(f"from this checkout: pip install -e '{target}[encode]'")
    assert list(tmp_path.iterdir()) == []


def test_an_installed_package_gives_no_hint_at_a_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cogsplat, "__file__", str(tmp_path / "cogsplat" / "__init__.py"))
    told = CliRunner().invoke(group_with(ModuleNotFoundError("no", name="numba")), ["fail"])
    assert told.stderr == (
        "error: this command needs numba, which is not installed; install the extra: "
        "pip install 'cogsplat[encode]' [needs-extra]\n"
    )


HINTS = {"exists": "--force", "file-truncated": "--partial", "invalid-rows": "--drop-invalid"}


@pytest.mark.parametrize(("code", "option"), HINTS.items())
def test_refusals_name_the_option_that_helps_where_the_command_has_it(
    code: str, option: str
) -> None:
    group = CommandLine("cogsplat")
    for name, options in (("with", [click.Option([option], is_flag=True)]), ("without", [])):

        def fail(**given: object) -> None:
            raise DataError(code, "found, expected")

        as_json = click.Option(["--json", "as_json"], is_flag=True)
        group.add_command(click.Command(name, callback=fail, params=[as_json, *options]))
    told = CliRunner().invoke(group, ["with"])
    first, hint = told.stderr.splitlines()
    assert first == f"error: found, expected [{code}]"
    assert hint.startswith(f"{option} ")
    assert json.loads(CliRunner().invoke(group, ["with", "--json"]).stdout)["error"]["hint"] == hint
    assert CliRunner().invoke(group, ["without"]).stderr.splitlines() == [first]


@posix
@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
def test_stopping_an_encode_leaves_nothing(small: SmallScene, tmp_path: Path, number: str) -> None:
    cameras = tmp_path / "cameras.json"
    # Seconds of scoring, of which the first tenth is enough.
    write_cameras_json(synth_cameras(400, 480, 360), cameras)
    arguments = ["encode", small.ply, tmp_path / "out.cogs", "--cameras", cameras]
    with subprocess.Popen(
        program(arguments), stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        # Where the kernels are not cached yet, compiling them comes first.
        assert any(line.startswith("score 0/") for line in process.stderr)
        process.send_signal(getattr(signal, number))
        told = process.stderr.read()
        assert process.wait(timeout=60) == 130
    assert "error: interrupted [cancelled]" in told
    assert "Traceback" not in told
    assert list(tmp_path.iterdir()) == [cameras]


@posix
def test_reader_that_went_away_ends_quietly(small: SmallScene) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run(
            program(["info", small.cogs, "--json"]),
            stdin=subprocess.DEVNULL,
            stdout=writer,
            stderr=subprocess.PIPE,
            check=False,
        )
    finally:
        os.close(writer)
    assert (done.returncode, done.stderr) == (4, b"")


@posix
def test_closed_output_is_no_fault(small: SmallScene) -> None:
    closed = "import os; os.close(1); sys.stdout = None"
    done = subprocess.run(
        program(["info", small.cogs], before=closed),
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.skipif(sys.platform != "linux", reason="/dev/full is Linux's")
@pytest.mark.parametrize("form", [[], ["--json"]])
def test_output_that_is_full_is_an_error(small: SmallScene, form: list[str]) -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            program(["info", small.cogs, *form]),
            stdin=subprocess.DEVNULL,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 4
    assert "[disk-full]" in done.stderr
    assert "Traceback" not in done.stderr


@posix
@pytest.mark.parametrize("command", ["decode", "lab score", "render", "encode"])
def test_full_disk_leaves_nothing(
    run_apart: Run, small: SmallScene, tmp_path: Path, command: str
) -> None:
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))"
    source = small.cogs if command == "decode" else small.ply
    suffix = {"decode": "ply", "lab score": "npy", "render": "png", "encode": "cogs"}[command]
    arguments: list[object] = [command, source, tmp_path / f"out.{suffix}"]
    if command != "decode":
        arguments += ["--cameras", small.cameras]
    done = run_apart(*arguments, before=limit)
    assert done.code == 4
    assert "[disk-full]" in done.err
    assert "Traceback" not in done.err
    assert list(tmp_path.iterdir()) == []


@posix
def test_a_full_disk_names_the_page_and_not_the_scene(
    run_apart: Run, small: SmallScene, tmp_path: Path
) -> None:
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100000, 100000))"
    done = run_apart("export-html", small.cogs, tmp_path / "page.html", before=limit)
    assert (done.code, "[disk-full]" in done.err) == (4, True), done.err
    assert str(tmp_path / "page.html") in done.err
    assert str(small.cogs) not in done.err
    assert list(tmp_path.iterdir()) == []


@posix
def test_a_full_temporary_folder_is_named(small: SmallScene, tmp_path: Path) -> None:
    """Errors of writing what standard input holds are none of standard output."""
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))"
    with small.ply.open("rb") as scene:
        done = subprocess.run(
            program(["info", "-"], before=limit),
            stdin=scene,
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, "TMPDIR": str(tmp_path)},
        )
    assert (done.returncode, "[disk-full]" in done.stderr) == (4, True), done.stderr
    assert "standard output" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_missing_temporary_folder_is_an_error(small: SmallScene) -> None:
    done = subprocess.run(
        program(["info", small.cogs], before="import tempfile; tempfile.tempdir = '/no/such'"),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, "[not-found]" in done.stderr) == (4, True), done.stderr
    assert "standard output" not in done.stderr
