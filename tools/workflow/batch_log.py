"""Log of ``cogsplat batch``: which outputs are done, and which were begun."""

from __future__ import annotations

import json
import os
import re
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Final

from cogsplat.formats.network.urls import is_url
from cogsplat.formats.storage.atomic import storage_errors
from cogsplat.formats.storage.regular_files import FileKind, open_regular
from cogsplat.tools.terminal.standard_streams import is_file_name

_FIRST_LINE: Final = {"log": "cogsplat batch"}

BATCH_LOG: Final = FileKind(
    "log of cogsplat batch", re.compile(re.escape(json.dumps(_FIRST_LINE)).encode() + rb"\n")
)
"""Kind of these files."""

# A line is the report of an encode, some KiB: about 100,000 encodes.
_MAX_BYTES: Final = 1 << 29


@dataclass(frozen=True)
class DoneEncode:
    """Last finished encode of an output.

    Parameters
    ----------
    fingerprint : str
        Fingerprint of the scene and its options (`BatchScene.fingerprint`).
    size_bytes : int
        Size of the output, bytes.
    """

    fingerprint: str
    size_bytes: int


class BatchLog:
    """Open log: JSON lines behind a first line that names its kind.

    A line with the status ``started`` precedes each encode. If no further line of that output
    follows, the run was killed; the output still belongs to the batch.

    Parameters
    ----------
    path : Path
        Log file, created if it does not exist.
    folder : Path
        Folder of the manifest, where relative paths begin.

    Raises
    ------
    StorageError
        ``foreign-file``, ``not-a-file`` (also for a link), ``file-too-large``, ``permission``,
        ``disk-full`` or ``io``.
    """

    def __init__(self, path: Path, folder: Path) -> None:
        self._path = path
        self._folder = folder
        self._lock = threading.Lock()
        self._done: dict[str, DoneEncode] = {}
        self._started: set[str] = set()
        self._file = open_regular(path, "a+b", max_bytes=_MAX_BYTES)
        try:
            with storage_errors(path):
                self._file.seek(0)
                BATCH_LOG.require(self._file, path)
                self._file.seek(0)
                self._read_lines()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> BatchLog:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def done(self, output: str) -> DoneEncode | None:
        """Return the last finished encode of an output, None without one."""
        return self._done.get(output_key(self._folder, output))

    def owns(self, output: str) -> bool:
        """Whether this batch wrote an output, or began to write it where nothing existed."""
        key = output_key(self._folder, output)
        return key in self._done or key in self._started

    def write(self, line: Mapping[str, object]) -> None:
        """Add a line; it is on the disk on return.

        Raises
        ------
        StorageError
            ``disk-full`` or ``io``.
        """
        with self._lock, storage_errors(self._path):
            self._file.seek(0, os.SEEK_END)
            begin = b""
            if not self._file.tell():
                begin = json.dumps(_FIRST_LINE).encode() + b"\n"
            else:
                self._file.seek(-1, os.SEEK_END)
                # A killed run may have left half a line.
                begin = b"" if self._file.read(1) == b"\n" else b"\n"
            self._file.write(begin + json.dumps(line, allow_nan=False).encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())

    def _read_lines(self) -> None:
        """Read the lines of earlier runs; skip invalid lines, such as a half-written one."""
        for text in self._file:
            try:
                line = json.loads(text)
            except (ValueError, RecursionError):
                continue
            output = line.get("output") if isinstance(line, dict) else None
            if not isinstance(output, str) or not is_file_name(output):
                continue
            key = output_key(self._folder, output)
            status, result = line.get("status"), line.get("result")
            if status == "started":
                self._started.add(key)
                continue
            self._started.discard(key)
            size = result.get("bytes") if isinstance(result, dict) else None
            if status == "done" and isinstance(size, int):
                self._done[key] = DoneEncode(str(line.get("fingerprint")), size)


def output_key(folder: Path, output: str) -> str:
    """Return the identity of an output, the same for all spellings of its path.

    Parameters
    ----------
    folder : Path
        Folder where relative paths begin.
    output : str
        Path or URL.
    """
    return output if is_url(output) else os.path.normcase(os.path.realpath(folder / output))


def output_keys(folder: Path, names: Iterable[str]) -> set[str]:
    """Return the identities (`output_key`) of several files, without names that no file can have.

    Parameters
    ----------
    folder : Path
        Folder where relative paths begin.
    names : iterable of str
        Paths or URLs.
    """
    return {output_key(folder, name) for name in names if is_file_name(name)}
