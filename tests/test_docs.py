"""Every block of code in the documents runs, and every example in a docstring gives what it shows.

Commands run as they are written, on a scene that is small enough for a test: cameras are smaller,
and numbers of splats and bytes that belong to the large scene are replaced.
"""

import doctest
import importlib
import json
import os
import re
import shlex
import sys
import textwrap
import tomllib
from collections.abc import AsyncIterator
from pathlib import Path
from types import ModuleType

import httpx
import pytest
from _pytest.mark import ParameterSet
from click.testing import CliRunner

import cogsplat
from cogsplat.codec.rate.pruning import PruneConfig
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.formats.network import http_transport
from cogsplat.formats.network.network_options import NetworkOptions
from cogsplat.tools.lab import check, make_vectors
from cogsplat.tools.lab.cli import demonstration
from cogsplat.tools.lab.synthetic import terrace as synthetic
from cogsplat.tools.main import cli

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("tests/**/*.md")])
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# Pictures, dumps, pages, shaders: nothing that runs here.
TRANSCRIPT = ("", "glsl", "html", "js", "text", "ts")

# What is added to a command so that the scene it makes is small.
SMALL = {"lab synth": ("--splats", "3000"), "demo": ("--splats", "2000")}
# What belongs to the large scene in a command, and what stands for it with the small one.
REPLACED = {"500KiB": "60KiB", "300KiB": "60KiB", "10000": "1500"}


@pytest.fixture(autouse=True)
def web(small_scene: dict[str, bytes], monkeypatch: pytest.MonkeyPatch) -> None:
    """Answer requests for any URL with the small scene, from no network."""

    def answer(request: httpx.Request) -> httpx.Response:
        data = small_scene["scene.cogs"]
        first, last = request.headers["Range"].removeprefix("bytes=").split("-")
        part = data[int(first) : int(last) + 1]
        span = f"bytes {first}-{int(first) + len(part) - 1}/{len(data)}"

        async def body() -> AsyncIterator[bytes]:
            yield part

        return httpx.Response(206, headers={"Content-Range": span}, content=body())

    def new_client(options: NetworkOptions) -> httpx.AsyncClient:
        return httpx.AsyncClient(transport=httpx.MockTransport(answer))

    monkeypatch.setattr(http_transport, "new_client", new_client)


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stand in an empty folder where commands make small pictures and leave the checkout alone."""
    monkeypatch.chdir(tmp_path)
    # Blocks are for an activated environment: this one, activated or not.
    here = os.fspath(Path(sys.executable).parent)
    monkeypatch.setenv("PATH", f"{here}{os.pathsep}{os.environ['PATH']}")
    cameras = synthetic.synth_cameras(48, 64, 48)
    for module in (synthetic, demonstration):
        monkeypatch.setattr(module, "synth_cameras", lambda: cameras)
    # All checks would run this test again.
    monkeypatch.setattr(check, "run", lambda checks, root: [])
    vectors, spec = tmp_path / "vectors", tmp_path / "SPEC.md"
    spec.write_bytes(make_vectors.SPEC.read_bytes())
    monkeypatch.setattr(make_vectors, "VECTORS", vectors)
    monkeypatch.setattr(make_vectors, "SPEC", spec)
    return tmp_path


def blocks(path: Path) -> list[tuple[str, str]]:
    return BLOCK.findall(path.read_text(encoding="utf-8"))


def commands(block: str) -> list[list[str]]:
    """Return the words of every command of a shell block."""
    found = []
    for line in block.replace("\\\n", " ").splitlines():
        command: list[str] = []
        for word in [*shlex.split(line, comments=True), "&&"]:
            if word != "&&":
                command.append(word)
            elif command:
                found.append(command)
                command = []
    return found


# Files and folders of the tree and entries of the npm package, in backticks; a document says which
# are to be made.
NAMED = re.compile(r"`((?:codec|formats|tools|tests|cogsplat)/[\w./-]+)`(, to be made)?")


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_files_that_documents_name_are_there(path: Path) -> None:
    named = NAMED.findall(path.read_text(encoding="utf-8"))
    package = json.loads((ROOT / "tools" / "web" / "package.json").read_text(encoding="utf-8"))
    entries = {f"cogsplat{entry.removeprefix('.')}" for entry in package["exports"]}
    wrong = [
        name
        for name, to_be_made in named
        if ((ROOT / name).exists() or name in entries) == bool(to_be_made)
    ]
    assert wrong == []


def test_the_shader_of_the_documents_is_the_viewer_s() -> None:
    """Chromium draws the pictures of the vectors with it, in `tests/tools/web`."""
    source = (ROOT / "tools" / "web" / "src" / "viewer" / "shaders.ts").read_text(encoding="utf-8")
    shown = [block for path in DOCUMENTS for kind, block in blocks(path) if kind == "glsl"]
    assert len(shown) == 1
    assert textwrap.indent(shown[0], "  ") in source


def test_the_picture_of_the_readme_is_what_the_demonstration_draws() -> None:
    """A strip of that shape and size; which bytes a PNG has depends on its library's version."""
    width, height = png_size((ROOT / "docs" / "filmstrip.png").read_bytes())
    pictures = len(demonstration.SHARES) + 1
    camera = synthetic.synth_cameras()[0]
    assert pictures * camera.width < width < 1.2 * pictures * camera.width
    assert camera.height < height < 2 * camera.height
    assert (ROOT / "docs" / "filmstrip.png").stat().st_size < 1 << 21


def png_size(data: bytes) -> tuple[int, int]:
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    return int.from_bytes(data[16:20]), int.from_bytes(data[20:24])


LINK = re.compile(r"\]\((?!https?:)([^)#]+)")


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_between_documents_lead_somewhere(path: Path) -> None:
    for target in LINK.findall(path.read_text(encoding="utf-8")):
        assert (path.parent / target).exists(), target


def run_program(arguments: list[str]) -> None:
    command = " ".join(arguments[: 2 if arguments[0] == "lab" else 1])
    added = SMALL.get(command, ())
    small = [*(REPLACED.get(word, word) for word in arguments), *added]
    done = CliRunner().invoke(cli, small)
    if done.exception and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == 0, f"cogsplat {shlex.join(small)}: {done.output}"


def run_module(name: str, arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module(name)
    with monkeypatch.context() as patch:
        patch.setattr(sys, "argv", [name, *arguments])
        assert module.main() == 0, name


def run_command(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Run one command of a shell block; one that is not known here fails."""
    match words:
        case ["python3", "-m", "venv", ".venv"] | [".", ".venv/bin/activate"]:
            return  # The environment that runs the tests stands for it.
        case [".venv/bin/pip", "install", "-q", "-e", target]:
            project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
                "project"
            ]
            extra = re.fullmatch(r"\.\[(\w+)\]", target)
            assert extra, target
            assert extra[1] in project["optional-dependencies"]
        case ["mkdir", "-p", folder]:
            Path(folder).mkdir(parents=True, exist_ok=True)
        case ["echo", text, ">", path]:
            Path(path).write_text(f"{text}\n", encoding="utf-8")
        case ["cogsplat" | ".venv/bin/cogsplat", *arguments]:
            # As a shell does.
            given = [sorted(map(str, Path().glob(w))) if "*" in w else [w] for w in arguments]
            run_program([word for words in given for word in words])
        case ["python" | ".venv/bin/python", "-m", module, *arguments]:
            run_module(module, arguments, monkeypatch)
        case _:
            pytest.fail(f"no way to run {shlex.join(words)}")


def test_the_documents_have_blocks() -> None:
    names = {path.name for path in DOCUMENTS if blocks(path)}
    assert names >= {"README.md", "CONTRIBUTING.md", "SPEC.md"}
    assert commands("a 'b c' # d\n\nx && y \\\n z\n") == [["a", "b c"], ["x"], ["y", "z"]]


@pytest.mark.parametrize(
    "words", [["rm", "-r", "."], ["cogsplat", "lab", "synth"], ["python", "-m", "no"]]
)
def test_blocks_that_cannot_run_fail(
    words: list[str], workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises((pytest.fail.Exception, AssertionError, ModuleNotFoundError)):
        run_command(words, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_blocks_run_one_after_the_other(
    path: Path, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for language, block in blocks(path):
        if language == "sh":
            for words in commands(block):
                run_command(words, monkeypatch)
        elif language == "python":
            exec(compile(block, path.name, "exec"), {"__name__": "block"})
        elif language == "json":
            json.loads(block)
        else:
            assert language in TRANSCRIPT, f"no way to run {language}"


def examples() -> list[ParameterSet]:
    """Return the docstrings of the package that hold examples."""
    finder = doctest.DocTestFinder(exclude_empty=True)
    found: list[ParameterSet] = []
    for package in ("codec", "formats", "tools", "cogsplat"):
        for path in sorted((ROOT / package).rglob("*.py")):
            if ">>>" not in path.read_text(encoding="utf-8"):
                continue
            parts = path.relative_to(ROOT).with_suffix("").parts
            inside = parts if package == "cogsplat" else ("cogsplat", *parts)
            try:
                module = importlib.import_module(".".join(inside).removesuffix(".__init__"))
            except ModuleNotFoundError as error:
                if error.name != "torch":
                    raise
                skip = pytest.mark.skip(reason="needs torch")
                found.append(pytest.param((path, None), id=path.name, marks=skip))
                continue
            found += [
                pytest.param((module, test), id=test.name)
                for test in finder.find(module)
                if test.examples
            ]
    return found


@pytest.fixture(scope="module")
def small_scene(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Return the files that examples in docstrings find in their folder."""
    from cogsplat.codec.encode.config import EncodeConfig

    folder = tmp_path_factory.mktemp("examples")
    splats, cameras = synthetic.synth(1000), synthetic.synth_cameras(9, 64, 48)
    cogsplat.write(splats, folder / "scene.ply")
    write_cameras_json(cameras, folder / "cameras.json")
    config = EncodeConfig(chunk_splats=300, prune=PruneConfig(peak=0.001))
    cogsplat.encode(splats, folder / "scene.cogs", cameras=cameras, config=config)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("example", examples())
def test_examples_in_docstrings_give_what_they_show(
    example: tuple[ModuleType, doctest.DocTest],
    small_scene: dict[str, bytes],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, content in small_scene.items():
        (tmp_path / name).write_bytes(content)
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    runner.run(example[1], out=said.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(said)
