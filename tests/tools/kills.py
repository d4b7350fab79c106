"""Commands killed at random moments and run again: the same bytes, and nothing left behind.

Run as ``python tests/tools/kills.py [COMMAND]... --kills 200 --seed 1`` on Linux. Each command runs
in a process forked from one that has loaded everything, so that kills meet its work and not its
imports. A chain kills a command up to five times in one folder, then lets it finish.
"""

import argparse
import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

ROOT = Path(__file__).resolve().parents[2]
if __name__ == "__main__":
    sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "formats")]

from click.testing import CliRunner  # noqa: E402
from s3_server import s3_server  # noqa: E402

import cogsplat  # noqa: E402
from cogsplat.codec.fit import tune_config  # noqa: E402
from cogsplat.formats.cameras.inria import write_cameras_json  # noqa: E402
from cogsplat.formats.storage import atomic, scratch_folder  # noqa: E402
from cogsplat.tools import child_command  # noqa: E402
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras  # noqa: E402
from cogsplat.tools.main import cli, main  # noqa: E402
from cogsplat.tools.workflow import child_process  # noqa: E402

MOST_KILLS_OF_A_CHAIN = 5
SLOWEST_SECONDS = 600.0
MOST_SECONDS_OF_ORPHANS = 30.0


@dataclass
class Command:
    """A command to kill.

    Parameters
    ----------
    words : list of str
        Command line, run in a folder with ``scene.ply`` and ``cameras.json``.
    outputs : tuple of str
        Files that it promises, the same bytes in every run.
    others : tuple of str
        Further files that it may leave.
    """

    words: list[str]
    outputs: tuple[str, ...]
    others: tuple[str, ...] = ()


# Enough steps for all phases of tuning and for checkpoints; the usual number takes 17 s a run.
tune_config.TuneConfig = partial(  # type: ignore[misc,assignment]
    tune_config.TuneConfig, recovery_steps=150, quantised_steps=120
)

VIEWS = ["--cameras", "cameras.json"]
COMMANDS = {
    "tune": Command(
        ["tune", "scene.ply", "o.cogs", *VIEWS, "--keep", "0.5", "--target-size", "6KB",
         "--checkpoint", "o.npz", "--resume"],
        ("o.cogs",), ("o.npz",),
    ),
    "layers": Command(
        ["layers", "scene.ply", "o.cogs", *VIEWS, "--scales", "2,1", "--shares", "40%,100%",
         "--steps", "30"],
        ("o.cogs",),
    ),
    "memory": Command(
        ["encode", "scene.ply", "o.cogs", *VIEWS, "--preset", "fast", "--memory", "4GiB"],
        ("o.cogs",),
    ),
    "batch": Command(["batch", "m.jsonl", "--jobs", "2"], ("a.cogs", "b.cogs"), ("m.jsonl.log",)),
    "upload": Command(["upload", "scene"], ()),
}  # fmt: skip
MANIFEST = "".join(
    f'{{"input": "scene.ply", "output": "{name}.cogs", "options": '
    f'{{"cameras": "cameras.json", "preset": "fast", "quality": {quality}}}}}\n'
    for name, quality in (("a", 30), ("b", 35))
)


@dataclass
class Tally:
    """Counts of a run, and what went wrong."""

    kills: int = 0
    finished: int = 0
    faults: list[str] = field(default_factory=list)


def start_forked(words: list[str], **options: Any) -> subprocess.Popen[str]:
    """Start a child command of ``batch`` as a fork of this process, which has loaded everything.

    Parameters
    ----------
    words : list of str
        Command line of the interpreter: ``python -P -m MODULE``, then the command's words.
    **options : object
        Options of `subprocess.Popen`.
    """

    def run_command() -> None:
        # Pipes and folder are in place; other descriptors are closed as `exec` would close them.
        os.closerange(3, 1 << 10)
        sys.stdin, sys.stdout, sys.stderr = open(0), open(1, "w"), open(2, "w")  # noqa: SIM115
        run_to_end(child_command.main, words[4:])

    return subprocess.Popen(words, preexec_fn=run_command, **options)


def run_to_end(run: Callable[[], None], words: list[str]) -> NoReturn:
    """Run a command in a forked process, and end the process."""
    # Which folders were searched for files of killed processes.
    atomic._remove_stale.cache_clear()
    scratch_folder._remove_stale.cache_clear()
    sys.argv = ["cogsplat", *words]
    code: object = 1
    try:
        run()
    except SystemExit as end:
        code = end.code
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else 1)


def forked(
    words: list[str], folder: Path, scratch: Path, seconds: float | None, sessions: list[int]
) -> int | None:
    """Run a command in a forked process; return its exit code, None if it was killed.

    Parameters
    ----------
    words : list of str
        Command line.
    folder, scratch : Path
        Working folder, and folder of temporary files. Its messages go to ``scratch`` + ``.txt``.
    seconds : float or None
        Time after which it is killed; None to let it finish.
    sessions : list of int
        Receives the session of the process and its children.
    """
    process = os.fork()
    sessions.append(process)
    if not process:
        os.setsid()
        log = os.open(f"{scratch}.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        null = os.open(os.devnull, os.O_RDONLY)
        for number, target in ((null, 0), (log, 1), (log, 2)):
            os.dup2(number, target)
        os.chdir(folder)
        os.environ["TMPDIR"] = tempfile.tempdir = str(scratch)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        child_process.subprocess = SimpleNamespace(Popen=start_forked, PIPE=subprocess.PIPE)
        run_to_end(main, words)
    until = time.monotonic() + (SLOWEST_SECONDS if seconds is None else seconds)
    while time.monotonic() < until:
        ended, status = os.waitpid(process, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    if seconds is None:
        raise AssertionError(f"{words}: ran for more than {SLOWEST_SECONDS:g} s")
    return None


def running(session: int) -> list[int]:
    """Return the processes of a session that have not ended."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = path.read_text().rpartition(")")[2].split()
            if int(fields[3]) == session and fields[0] != "Z":
                found.append(int(path.parent.name))
    return found


def digests(folder: Path, names: tuple[str, ...]) -> dict[str, str]:
    """Return the hash of each file that exists."""
    return {
        name: hashlib.sha256((folder / name).read_bytes()).hexdigest()
        for name in names
        if (folder / name).exists()
    }


class Killer:
    """Kills of one command.

    Parameters
    ----------
    name : str
        Name in `COMMANDS`.
    base : Path
        Empty folder.
    rng : Random
        Moments of the kills.
    stack : ExitStack
        Receives the object store, which ends with it.
    """

    def __init__(self, name: str, base: Path, rng: random.Random, stack: ExitStack) -> None:
        self.command = COMMANDS[name]
        self.tally = Tally()
        self._name = name
        self._base = base
        self._rng = rng
        self._count = 0
        self._sessions: list[int] = []
        self._bucket: Callable[[str], set[str]] | None = None
        self._stack = stack
        self._url = ""
        if name == "upload":
            self._start_store()
        self._prepared = base / "prepared"
        self._prepared.mkdir()
        self._prepare()
        # The second run is timed: kernels that processes of the first compile are on disk by then.
        for _ in range(2):
            folder, scratch = self._folders()
            start = time.monotonic()
            code = forked(self._words(folder), folder, scratch, None, self._sessions)
            self.seconds = time.monotonic() - start
            assert code == 0, Path(f"{scratch}.txt").read_text()
        self.expected = digests(folder, self.command.outputs)
        assert set(self.expected) == set(self.command.outputs)

    def chain(self) -> None:
        """Kill the command some times in one folder, then let it finish, and check what it left."""
        folder, scratch = self._folders()
        words = self._words(folder)
        for attempt in range(self._rng.randint(1, MOST_KILLS_OF_A_CHAIN)):
            seconds = self._rng.uniform(0.0, 1.1 * self.seconds)
            start = time.monotonic()
            code = forked(words, folder, scratch, seconds, self._sessions)
            if code is not None:
                # Later attempts may resume, and end sooner than a whole run.
                if not attempt:
                    self.seconds = min(self.seconds, time.monotonic() - start)
                break
            self.tally.kills += 1
            self._check_store(folder, complete=False)
        else:
            code = forked(words, folder, scratch, None, self._sessions)
        self._check_processes()
        self.tally.finished += 1
        said = Path(f"{scratch}.txt").read_text()
        # Killed between the last rename and its end: the next run finds the finished output.
        is_there = code == 2 and "[exists]" in said
        if code != 0 and not is_there:
            self.tally.faults.append(f"{folder}: exit code {code}: {said[-2000:]}")
            return
        if digests(folder, self.command.outputs) != self.expected:
            self.tally.faults.append(f"{folder}: other bytes than of a run without kills")
        inputs = {path.name for path in self._prepared.iterdir()}
        left = {path.name for path in folder.iterdir()} - inputs
        left -= {*self.command.outputs, *self.command.others}
        if left:
            self.tally.faults.append(f"{folder}: left {sorted(left)}")
        if left := sorted(path.name for path in scratch.iterdir()):
            self.tally.faults.append(f"{scratch}: left {left}")
        self._check_store(folder, complete=True)

    def _check_processes(self) -> None:
        """Wait for the children of killed commands to end; count a fault if any runs on."""
        until = time.monotonic() + MOST_SECONDS_OF_ORPHANS
        while left := [number for session in self._sessions for number in running(session)]:
            if time.monotonic() > until:
                self.tally.faults.append(f"processes {left} outlive the command")
                break
            time.sleep(0.1)
        self._sessions.clear()

    def _folders(self) -> tuple[Path, Path]:
        """Return a new working folder with the inputs, and a new folder for temporary files."""
        self._count += 1
        folder, scratch = self._base / f"{self._count}", self._base / f"{self._count}-scratch"
        folder.mkdir()
        scratch.mkdir()
        for path in self._prepared.iterdir():
            (folder / path.name).symlink_to(path)
        return folder, scratch

    def _words(self, folder: Path) -> list[str]:
        """Return the command line for a folder."""
        if self._name != "upload":
            return self.command.words
        store = ["--endpoint", self._url, "--region", "us-east-1", "--concurrency", "2"]
        return [*self.command.words, f"s3://bucket/{folder.name}", *store]

    def _prepare(self) -> None:
        """Write the inputs, and load what the command needs into this process."""
        splats = 3000 if self._name == "memory" else 300
        cogsplat.write(synth(splats), self._prepared / "scene.ply")
        write_cameras_json(synth_cameras(5, 32, 24), self._prepared / "cameras.json")
        (self._prepared / "m.jsonl").write_text(MANIFEST)
        if self._name == "upload":
            with tempfile.TemporaryDirectory() as name:
                path = Path(name) / "a.cogs"
                config = cogsplat.EncodeConfig(chunk_splats=20)
                cogsplat.encode(self._prepared / "scene.ply", path, preset="fast", config=config)
                cogsplat.unpack(path, self._prepared / "scene")
        else:
            # A batch encodes in forks of its process.
            encode = ["encode", "scene.ply", "o.cogs", *VIEWS, "--preset", "fast"]
            with tempfile.TemporaryDirectory() as name:
                out = {"o.cogs": f"{name}/o.cogs", "o.npz": f"{name}/o.npz"}
                command = encode if self._name == "batch" else self.command.words
                words = [out.get(word, word) for word in command]
                before = Path.cwd()
                os.chdir(self._prepared)
                try:
                    done = CliRunner().invoke(cli, words)
                finally:
                    os.chdir(before)
                assert done.exit_code == 0, done.output

    def _start_store(self) -> None:
        """Start an object store; obstore is used in forked processes alone, as it has threads."""
        url = self._stack.enter_context(s3_server())
        os.environ.update(AWS_ACCESS_KEY_ID="key", AWS_SECRET_ACCESS_KEY="secret")
        self._url = url
        self._bucket = lambda prefix: listed(url, prefix)

    def _check_store(self, folder: Path, *, complete: bool) -> None:
        """Check that a manifest in the bucket never lacks an object."""
        if self._bucket is None:
            return
        found = self._bucket(f"{folder.name}/")
        scene = self._prepared / "scene"
        expected = {path.relative_to(scene).as_posix() for path in scene.rglob("*.*")}
        if ("manifest.cogsm" in found or complete) and found != expected:
            self.tally.faults.append(f"{folder}: objects {sorted(found ^ expected)}")


def listed(url: str, prefix: str) -> set[str]:
    """Return the names of the objects of the bucket below a prefix, from the server's XML."""
    import re
    import urllib.request

    with urllib.request.urlopen(f"{url}/bucket?list-type=2&prefix={prefix}") as answer:
        return {
            name.removeprefix(prefix)
            for name in re.findall(r"<Key>([^<]*)</Key>", answer.read().decode())
        }


@contextmanager
def killer(name: str, base: Path, seed: int) -> Iterator[Killer]:
    """Provide the kills of a command."""
    with ExitStack() as stack:
        yield Killer(name, base, random.Random(f"{name} {seed}"), stack)


def run() -> int:
    """Kill each command, print the counts; return the number of faults."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commands", nargs="*", choices=[[], *COMMANDS], default=[])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=1e9)
    given = parser.parse_args()
    faults = 0
    for name in given.commands or COMMANDS:
        until = time.monotonic() + 60 * given.minutes
        with tempfile.TemporaryDirectory() as base, killer(name, Path(base), given.seed) as made:
            while made.tally.kills < given.kills and time.monotonic() < until:
                before = len(made.tally.faults)
                made.chain()
                for fault in made.tally.faults[before:]:
                    print(fault, flush=True)
            tally = made.tally
            print(
                f"{name}: {tally.kills} kills of {made.seconds:.1f} s, {tally.finished} finished, "
                f"{len(tally.faults)} faults",
                flush=True,
            )
            faults += len(tally.faults)
    return faults


if __name__ == "__main__":
    sys.exit(bool(run()))
