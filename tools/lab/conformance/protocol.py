"""The protocol between the conformance runner and a decoder under test: JSON lines over pipes.

The runner starts the decoder as a process, writes one JSON object a line to its standard input, and
reads one line from its standard output for each. ``docs/conformance.md`` describes the requests and
answers; what the decoder writes to standard error is not read.
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
    """What a decoder says of itself.

    Parameters
    ----------
    name, version : str
    level : str
        One of `LEVELS`.
    refuses : bool
        Whether it is to be tried with files that must be refused.
    partial : bool
        Whether it is to be tried with files that are cut short.
    folders : bool
        Whether it is to be tried with folders.
    """

    name: str
    version: str
    level: str
    refuses: bool
    partial: bool
    folders: bool = False


class DecoderProcess:
    """A decoder under test, running.

    Parameters
    ----------
    command : sequence of str
        Program and arguments.
    timeout_s : float
        An answer that takes longer is a failure, and the decoder is started again.

    Raises
    ------
    StorageError
        ``decoder``: it cannot be started.
    """

    def __init__(self, command: Sequence[str], timeout_s: float = 30.0) -> None:
        self._command = list(command)
        self._timeout_s = timeout_s
        self._most_memory = 0
        self._unsent = ""
        self._start()

    def _start(self) -> None:
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
        # A thread reads, so that an answer that does not come can be waited for in bounded time.
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
        """End the decoder: its input ends, and what does not stop then is killed."""
        try:
            self._input.close()
            self._process.wait(self._timeout_s)
        except (OSError, subprocess.TimeoutExpired):
            # It ended with a request unread, or does not end.
            self._process.kill()
        self._reap()

    def _reap(self) -> None:
        self._process.wait()
        self._reader.join()
        self._output.close()

    def ask(self, request: Answer) -> tuple[Answer | None, str]:
        """Send a request; return the answer, or None and what went wrong instead."""
        self.send(request)
        return self.receive()

    def send(self, request: Answer) -> None:
        """Send a request, whose answer `receive` returns."""
        self._unsent = ""
        try:
            self._input.write(json.dumps(request) + "\n")
            self._input.flush()
        except OSError as error:
            self._unsent = f"the decoder ended: {error.strerror}"

    def receive(self) -> tuple[Answer | None, str]:
        """Return the answer to what was sent last, or None and what went wrong instead."""
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

    def most_memory(self) -> int:
        """Return the most memory that the decoder held at once, bytes; 0 where no system tells."""
        # Linux alone keeps it where another process can read it.
        with suppress(OSError):
            for line in Path(f"/proc/{self._process.pid}/status").read_text("ascii").splitlines():
                if line.startswith("VmHWM:"):
                    self._most_memory = max(self._most_memory, 1024 * int(line.split()[1]))
        return self._most_memory

    def _restart(self, reason: str) -> str:
        self.most_memory()
        self._process.kill()
        with suppress(OSError):  # a request that was not sent is lost with the process
            self._input.close()
        self._reap()
        self._start()
        return reason

    def hello(self) -> Hello:
        """Return what the decoder says of itself.

        Raises
        ------
        StorageError
            ``decoder``: it does not answer, or not as the protocol has it.
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
        )

    def decode(
        self, path: Path, out: Path, *, partial: bool = False, refine: bool = True, verify: bool
    ) -> tuple[Answer | None, str]:
        """Ask for a file; see the module for what is answered."""
        return self.ask(decode_request(path, out, partial=partial, refine=refine, verify=verify))


def decode_request(
    path: Path, out: Path, *, partial: bool = False, refine: bool = True, verify: bool
) -> Answer:
    """Return the request that asks for a file, see ``docs/conformance.md``."""
    return {
        "op": "decode",
        "path": str(path),
        "out": str(out),
        "partial": partial,
        "refine": refine,
        "verify": verify,
    }
