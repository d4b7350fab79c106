"""Protocol between the conformance runner and a decoder under test: JSON lines over pipes.

The runner starts the decoder as a process, writes one JSON object a line to its standard input, and
reads one line from its standard output for each. ``docs/conformance.md`` describes the requests and
answers. The runner does not read the decoder's standard error.
"""

from __future__ import annotations

import json
import queue
import subprocess
import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Final

from cogsplat.codec.errors import StorageError

LEVELS: Final = ("viewer", "reader", "verifier")

Answer = dict[str, object]


@dataclass(frozen=True)
class Hello:
    """Name and capabilities of a decoder, from its answer to ``hello``.

    Parameters
    ----------
    name, version : str
    level : str
        Conformance level, one of `LEVELS`.
    refuses : bool
        Whether the decoder refuses invalid files; if not, it is tested with valid files only.
    partial : bool
        Whether the decoder reads truncated files.
    folders : bool
        Whether the decoder reads folders.
    draws : bool
        Whether the decoder draws pictures.
    """

    name: str
    version: str
    level: str
    refuses: bool
    partial: bool
    folders: bool = False
    draws: bool = False


class DecoderProcess:
    """A running decoder under test.

    Parameters
    ----------
    command : sequence of str
        Program and arguments.
    timeout_s : float
        Time limit of one answer, seconds; after it the decoder is restarted.

    Raises
    ------
    StorageError
        ``decoder``: the decoder cannot be started.
    """

    def __init__(self, command: Sequence[str], timeout_s: float = 30.0) -> None:
        self._command = list(command)
        self._timeout_s = timeout_s
        self._peak_memory = 0
        self._unsent = ""
        self._start()

    def _start(self) -> None:
        """Start the process and the thread that reads its answers."""
        try:
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
        except OSError as error:
            raise StorageError("decoder", f"{self._command[0]}: {error.strerror}") from error
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._input, self._output = self._process.stdin, self._process.stdout
        self._lines: queue.Queue[str | None] = queue.Queue()
        # A thread reads the answers, since reading a pipe has no time limit.
        self._reader = threading.Thread(target=self._read, args=(self._output, self._lines))
        self._reader.daemon = True
        self._reader.start()

    @staticmethod
    def _read(output: IO[str], lines: queue.Queue[str | None]) -> None:
        for line in output:
            lines.put(line)
        lines.put(None)

    def __enter__(self) -> DecoderProcess:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the decoder's input; kill the process if it does not end within the time limit."""
        try:
            self._input.close()
            self._process.wait(self._timeout_s)
        except (OSError, subprocess.TimeoutExpired):
            # The process ended before it read a request, or does not end.
            self._process.kill()
        self._reap()

    def _reap(self) -> None:
        """Wait for the ended process and its reader, and close the pipe."""
        self._process.wait()
        self._reader.join()
        self._output.close()

    def ask(self, request: Answer) -> tuple[Answer | None, str]:
        """Send a request; return the answer and "", or None and the reason of the failure."""
        self.send(request)
        return self.receive()

    def send(self, request: Answer) -> None:
        """Send a request; `receive` returns its answer."""
        self._unsent = ""
        try:
            self._input.write(json.dumps(request) + "\n")
            self._input.flush()
        except OSError as error:
            self._unsent = f"the decoder ended: {error.strerror}"

    def receive(self) -> tuple[Answer | None, str]:
        """Return the answer to the last request and "", or None and the reason of the failure."""
        if self._unsent:
            return None, self._restart(self._unsent)
        try:
            line = self._lines.get(timeout=self._timeout_s)
        except queue.Empty:
            return None, self._restart(f"no answer within {self._timeout_s:g} s")
        if line is None:
            status = self._process.wait()
            return None, self._restart(f"the decoder ended with status {status}")
        try:
            answer = json.loads(line)
        except json.JSONDecodeError:
            return None, f"{line[:80]!r} is no JSON"
        if not isinstance(answer, dict):
            return None, f"{line[:80]!r} is no JSON object"
        return answer, ""

    def peak_memory(self) -> int:
        """Return the decoder's peak resident memory, bytes; 0 if the system does not report it."""
        # Only Linux lets another process read this value.
        with suppress(OSError):
            for line in Path(f"/proc/{self._process.pid}/status").read_text("ascii").splitlines():
                if line.startswith("VmHWM:"):
                    self._peak_memory = max(self._peak_memory, 1024 * int(line.split()[1]))
        return self._peak_memory

    def _restart(self, reason: str) -> str:
        """Kill and restart the decoder; return `reason`."""
        self.peak_memory()
        self._process.kill()
        with suppress(OSError):  # closing flushes an unsent request, which fails
            self._input.close()
        self._reap()
        self._start()
        return reason

    def hello(self) -> Hello:
        """Send a ``hello`` request; return the decoder's name and capabilities.

        Raises
        ------
        StorageError
            ``decoder``: the decoder does not answer, or states an unknown level.
        """
        answer, reason = self.ask({"op": "hello"})
        if answer is None:
            raise StorageError("decoder", f"{self._command[0]}: {reason}")
        level = answer.get("level")
        if level not in LEVELS:
            raise StorageError(
                "decoder", f"{self._command[0]}: level {level!r}, expected one of {LEVELS}"
            )
        return Hello(
            str(answer.get("name", "")),
            str(answer.get("version", "")),
            str(level),
            answer.get("refuses") is not False,
            answer.get("partial") is not False,
            answer.get("folders") is True,
            answer.get("draws") is True,
        )

    def decode(
        self, path: Path, out: Path, *, partial: bool = False, refine: bool = True, verify: bool
    ) -> tuple[Answer | None, str]:
        """Send a ``decode`` request; return the answer and "", or None and the reason."""
        return self.ask(decode_request(path, out, partial=partial, refine=refine, verify=verify))

    def draw(self, path: Path, out: Path, camera: object) -> tuple[Answer | None, str]:
        """Send a ``draw`` request; return the answer and "", or None and the reason."""
        return self.ask({"op": "draw", "path": str(path), "out": str(out), "camera": camera})


def decode_request(
    path: Path, out: Path, *, partial: bool = False, refine: bool = True, verify: bool
) -> Answer:
    """Return a ``decode`` request, see ``docs/conformance.md``."""
    return {
        "op": "decode",
        "path": str(path),
        "out": str(out),
        "partial": partial,
        "refine": refine,
        "verify": verify,
    }
