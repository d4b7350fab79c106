"""``-`` in place of a file: a scene from standard input, a result to standard output.

Readers ask for any part of a file at any time and writers give a file its name when it is complete,
so that both streams go through a temporary folder. Messages speak of the streams, not of it.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Final
from urllib.parse import urlsplit

import click

from cogsplat.formats.network.download import download
from cogsplat.formats.network.object_output import ObjectOutput
from cogsplat.formats.network.urls import HTTP_SCHEMES, is_url, redacted, scheme_of

from .progress import Stages

STREAM: Final = "-"
"""What stands for a stream in place of a path."""

AS_JSON: Final = "cogsplat.json"
"""Where a click context keeps whether ``--json`` was given."""

_KEY: Final = "cogsplat.streams"

# Of the name of a URL's file, so many characters: what a file system takes in any case.
_LONGEST_NAME: Final = 64

_INPUT: Final = "standard input"
_OUTPUT: Final = "standard output"


class InputPath(click.Path):
    """A file to read; ``-`` is what arrives on standard input, which is read to its end.

    A URL stands for a file as well, which is fetched; how far that is, is shown unless ``--quiet``
    or ``--json`` is given.

    Parameters
    ----------
    by_ranges : bool
        Whether the command reads what it needs of a URL itself, through `url_of`.
    """

    def __init__(self, *, by_ranges: bool = False) -> None:
        super().__init__(path_type=Path)
        self._by_ranges = by_ranges

    def convert(
        self,
        value: str | os.PathLike[str],
        param: click.Parameter | None,
        ctx: click.Context | None,
    ) -> Path:
        """Return the path, that of a temporary file for ``-`` and for a URL."""
        streams = _streams(ctx)
        if streams is not None and ctx is not None and is_url(value):
            quiet = bool(ctx.params.get("quiet") or ctx.meta.get(AS_JSON))
            return streams.fetch(str(value), later=self._by_ranges, quiet=quiet)
        if os.fspath(value) != STREAM or streams is None:
            return Path(os.fsdecode(super().convert(value, param, ctx)))
        return streams.receive()


class NamedPath(click.Path):
    """A file or folder that no stream can stand for; ``-`` is refused.

    Whether it exists is asked when it is opened, so that its absence is an error of input (exit
    code 4) and not of usage.
    """

    def convert(
        self,
        value: str | os.PathLike[str],
        param: click.Parameter | None,
        ctx: click.Context | None,
    ) -> Path:
        """Return the path.

        Raises
        ------
        click.BadParameter
            It is ``-``.
        """
        if os.fspath(value) == STREAM:
            self.fail(
                f"{STREAM} for a stream, expected the name of a file or folder: {STREAM} stands "
                f"only for a scene to read and for the result (./{STREAM} is a file of that name)",
                param,
                ctx,
            )
        return Path(os.fsdecode(super().convert(value, param, ctx)))


class OutputPath(click.Path):
    """A file to write; with ``-`` it goes to standard output once it is complete.

    The address of an object in a store stands for a file as well, which is sent there once the
    command is done, with all files that were written beside it.

    Parameters
    ----------
    suffix : str
        Of the file that stands for standard output; it says a format where none is named.
    """

    def __init__(self, suffix: str = "") -> None:
        super().__init__(path_type=Path)
        self._suffix = suffix

    def convert(
        self,
        value: str | os.PathLike[str],
        param: click.Parameter | None,
        ctx: click.Context | None,
    ) -> Path:
        """Return the path, that of a temporary file for ``-`` and for an object."""
        streams = _streams(ctx)
        if streams is not None and ctx is not None and is_url(value):
            if scheme_of(str(value)) in HTTP_SCHEMES:
                self.fail(
                    f"{redacted(str(value))}: web servers take no files, expected the name of a "
                    "file, or of an object such as s3://bucket/key",
                    param,
                    ctx,
                )
            return streams.promise_object(str(value), force=bool(ctx.params.get("force")))
        if os.fspath(value) != STREAM or streams is None or ctx is None:
            return Path(os.fsdecode(super().convert(value, param, ctx)))
        if ctx.meta.get(AS_JSON):
            raise click.UsageError("--json and a result on standard output, expected one of them")
        return streams.promise(self._suffix)


INPUT: Final = InputPath()
"""The type of a scene to read."""

INPUT_BY_RANGES: Final = InputPath(by_ranges=True)
"""The type of a scene of which a command reads what it needs, where it is on a network."""

PATH: Final = NamedPath(path_type=Path)
"""The type of every other file and folder."""


class StandardStreams:
    """The streams of a command, and the files that stand for them.

    Parameters
    ----------
    folder : Path
        Where those files lie.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._input: Path | None = None
        self._output: Path | None = None
        self._names: dict[str, str] = {}
        self._urls: dict[Path, str] = {}
        self._quiet: set[Path] = set()
        self._objects: dict[Path, str] = {}
        self._force = False
        self._held = ""
        self._ended = False

    def receive(self) -> Path:
        """Read standard input to its end, into a file.

        Raises
        ------
        click.UsageError
            It is a terminal, or was asked for twice.
        """
        if self._input is not None:
            raise click.UsageError("- for two scenes, expected one on standard input")
        if sys.stdin is None or sys.stdin.isatty():
            raise click.UsageError("standard input is a terminal, expected a file or a pipe")
        self._input = self._folder / "input"
        self.call(self._input, _INPUT)
        with self._input.open("wb") as file:
            shutil.copyfileobj(sys.stdin.buffer, file)
        return self._input

    def fetch(self, url: str, *, later: bool, quiet: bool = False) -> Path:
        """Return the file that stands for a URL.

        Parameters
        ----------
        url : str
        later : bool
            Whether it is fetched only when `fetched` asks for it.
        quiet : bool
            Whether nothing is written while it is fetched.

        Raises
        ------
        CogsplatError
            It cannot be fetched.
        """
        path = self._standing_for(url, f"url{len(self._urls)}")
        self._urls[path] = url
        if quiet:
            self._quiet.add(path)
        return path if later else self.fetched(path)

    def _standing_for(self, url: str, folder: str) -> Path:
        """Return the path of a file in a new folder that is named as that of a URL."""
        # Its own name, since extensions say formats.
        name = PurePosixPath(urlsplit(url).path).name or "scene"
        (self._folder / folder).mkdir()
        path = self._folder / folder / name[-_LONGEST_NAME:]
        self.call(path, redacted(url))
        return path

    def fetched(self, path: Path) -> Path:
        """Return a path, of which the file is there if it stands for a URL."""
        if path in self._urls and not path.exists():
            with Stages(shown=path not in self._quiet) as stages:
                download(self._urls[path], path, progress=stages)
        return path

    def url_of(self, path: Path) -> str | None:
        """Return the URL that a path stands for, where the file was not fetched; None otherwise."""
        return None if path.exists() else self._urls.get(path)

    def promise(self, suffix: str) -> Path:
        """Return the file to write that goes to standard output.

        Raises
        ------
        click.UsageError
            Standard output is a terminal, or was asked for twice.
        """
        if self._output is not None:
            raise click.UsageError("- for two outputs, expected one on standard output")
        if sys.stdout is None or sys.stdout.isatty():
            raise click.UsageError("standard output is a terminal, expected a file or a pipe")
        self._output = self._folder / f"output{suffix}"
        self.call(self._output, _OUTPUT)
        return self._output

    def promise_object(self, url: str, *, force: bool) -> Path:
        """Return the file to write that goes to an object store.

        Parameters
        ----------
        url : str
        force : bool
            Whether an object that is there may be replaced.

        Raises
        ------
        TargetExistsError
            There is one. Exit code 2.
        CogsplatError
            The store cannot be asked.
        """
        output = ObjectOutput(url)
        if not force:
            # Before the work that would fill it.
            output.require_absent()
        self._force = force
        path = self._standing_for(url, f"object{len(self._objects)}")
        self._objects[path] = url
        return path

    @property
    def is_output_taken(self) -> bool:
        """Whether standard output is for a file, and nothing else may be written to it."""
        return self._output is not None

    def is_output(self, path: Path) -> bool:
        """Whether a path stands for standard output."""
        return path == self._output

    def send(self) -> None:
        """Copy what was promised to standard output, and to object stores.

        Raises
        ------
        CogsplatError
            A store does not take it.
        """
        if self._output is not None and self._output.is_file():
            with self._output.open("rb") as file:
                shutil.copyfileobj(file, sys.stdout.buffer)
            sys.stdout.buffer.flush()
        for path, url in self._objects.items():
            # What the named file refers to is there before it.
            beside = sorted(other for other in path.parent.iterdir() if other != path)
            start = url[: len(url) - len(PurePosixPath(urlsplit(url).path).name)]
            for other in beside:
                ObjectOutput(f"{start}{other.name}").write(other, force=self._force)
            if path.is_file():
                ObjectOutput(url).write(path, force=self._force)
        click.echo(self._held, nl=False)

    def hold_back(self, line: str) -> bool:
        """Keep a line until what the command wrote is in its store, if it is to go to one."""
        if self._objects and not self._ended:
            self._held += f"{line}\n"
            return True
        return False

    def end(self) -> None:
        """Hold nothing back any more: what failed is told at once."""
        self._ended = True

    def call(self, path: Path, name: str) -> None:
        """Let a name stand for a temporary file in what is printed."""
        self._names[os.fspath(path)] = name

    def named(self, text: str) -> str:
        """Return a text in which names stand for the temporary files that have one."""
        for path, name in self._names.items():
            text = text.replace(path, name)
        return text


@contextmanager
def standard_streams(ctx: click.Context) -> Iterator[None]:
    """Let the command of a context use ``-``; what it wrote is sent when the block ends well."""
    with tempfile.TemporaryDirectory(prefix="cogsplat-") as folder:
        streams = ctx.meta[_KEY] = StandardStreams(Path(folder))
        try:
            yield
            streams.send()
        finally:
            streams.end()


def is_standard_output(path: Path) -> bool:
    """Whether a path of the running command stands for standard output."""
    streams = _streams(click.get_current_context(silent=True))
    return streams is not None and streams.is_output(path)


def is_output_taken() -> bool:
    """Whether the running command sends a file to standard output."""
    streams = _streams(click.get_current_context(silent=True))
    return streams is not None and streams.is_output_taken


def url_of(path: Path) -> str | None:
    """Return the URL that a path of the running command stands for, unless it was fetched."""
    streams = _streams(click.get_current_context(silent=True))
    return None if streams is None else streams.url_of(path)


def fetched(path: Path) -> Path:
    """Return a path of the running command; what it stands for is fetched where it is a URL.

    Raises
    ------
    CogsplatError
        It cannot be fetched.
    """
    streams = _streams(click.get_current_context(silent=True))
    return path if streams is None else streams.fetched(path)


def hold_back(line: str) -> bool:
    """Keep what a program will read until the running command is done, where it may still fail.

    Returns
    -------
    bool
        Whether the line is kept, and printed once what the command wrote is in its store. It is
        not where nothing goes to a store.
    """
    streams = _streams(click.get_current_context(silent=True))
    return streams is not None and streams.hold_back(line)


def call_file(path: Path, name: str) -> None:
    """Let the running command say a name in place of the path of a temporary file.

    Parameters
    ----------
    path : Path
        Its user has not given it and cannot see it.
    name : str
        What it holds.
    """
    streams = _streams(click.get_current_context(silent=True))
    if streams is not None:
        streams.call(path, name)


def with_streams_named(text: str) -> str:
    """Return a text of the running command in which streams and temporary files have names."""
    streams = _streams(click.get_current_context(silent=True))
    return text if streams is None else streams.named(text)


def _streams(ctx: click.Context | None) -> StandardStreams | None:
    found = None if ctx is None else ctx.meta.get(_KEY)
    return found if isinstance(found, StandardStreams) else None
