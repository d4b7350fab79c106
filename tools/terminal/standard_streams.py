"""Standard input and output, and URLs, in place of files on the command line.

Readers need any part of a file at any time, and writers rename a complete file. Streams and
fetched files therefore lie in a temporary folder. Messages name the stream or the URL instead.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Final

import click

from cogsplat.formats.network.download import download
from cogsplat.formats.network.object_output import ObjectOutput
from cogsplat.formats.network.urls import HTTP_SCHEMES, is_url, redacted, scheme_of, split_url
from cogsplat.formats.storage.atomic import exists, is_file, storage_errors
from cogsplat.formats.storage.scratch_folder import scratch_folder

from .progress_bars import Stages

STREAM: Final = "-"
"""The argument for standard input or output."""

AS_JSON: Final = "cogsplat.json"
"""Key of a click context under which the flag ``--json`` is kept."""

READ_PATHS: Final = "cogsplat.read_paths"
"""Key of a click context under which files are kept that no parameter names, such as `--config`."""

_KEY: Final = "cogsplat.streams"

# Characters of a file's name that are kept of a URL; every file system accepts this length.
_LONGEST_NAME: Final = 64

_INPUT: Final = "standard input"
_OUTPUT: Final = "standard output"


def is_file_name(name: str) -> bool:
    """Whether a file can have a name: no NUL, and no character that the file system cannot hold.

    Command lines never have such names; files of options and manifests may.
    """
    try:
        return b"\0" not in os.fsencode(name)
    except UnicodeEncodeError:
        return False


def _require_name(
    kind: click.Path,
    value: str | os.PathLike[str],
    param: click.Parameter | None,
    ctx: click.Context | None,
) -> None:
    """Refuse a name that no file can have."""
    if not is_file_name(os.fspath(value)):
        kind.fail(f"{os.fspath(value)!r}, expected a name that a file can have", param, ctx)


class InputPath(click.Path):
    """Parameter type of a file to read, of standard input as ``-``, or of a URL.

    Standard input is read to its end and a URL is fetched, with progress unless ``--quiet`` or
    ``--json`` is given.

    Parameters
    ----------
    by_ranges : bool
        Whether the command itself reads ranges of a URL, through `unfetched_url`.
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
        """Return the path of the file, a temporary one for ``-`` and for a URL."""
        _require_name(self, value, param, ctx)
        streams = _streams(ctx)
        if streams is not None and ctx is not None and is_url(value):
            quiet = bool(ctx.params.get("quiet") or ctx.meta.get(AS_JSON))
            return streams.fetch(str(value), later=self._by_ranges, quiet=quiet)
        if os.fspath(value) != STREAM or streams is None:
            return Path(os.fsdecode(super().convert(value, param, ctx)))
        return streams.read_input()


class NamedPath(click.Path):
    """Parameter type of a file or folder; ``-`` is refused.

    Its absence is found when it is opened, and is then an error of input (exit code 4).

    Parameters
    ----------
    is_output : bool
        Whether the command writes the file or folder, and does not read it.
    """

    def __init__(self, *, is_output: bool = False) -> None:
        super().__init__(path_type=Path)
        self.is_output = is_output

    def convert(
        self,
        value: str | os.PathLike[str],
        param: click.Parameter | None,
        ctx: click.Context | None,
    ) -> Path:
        """Return the path of the file or folder.

        Raises
        ------
        click.BadParameter
            The argument is ``-``, or no file can have its name.
        """
        _require_name(self, value, param, ctx)
        if os.fspath(value) == STREAM:
            self.fail(
                f"{STREAM} for a stream, expected the name of a file or folder: {STREAM} is only "
                f"for the scene and the result (./{STREAM} is a file of that name)",
                param,
                ctx,
            )
        return Path(os.fsdecode(super().convert(value, param, ctx)))


class OutputPath(click.Path):
    """Parameter type of a file to write, of standard output as ``-``, or of an object's URL.

    A complete file is copied to standard output, or to the object store with all files of its
    folder.

    Parameters
    ----------
    suffix : str
        Extension of the temporary file for standard output, which names its format.
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
        """Return the path of the file, a temporary one for ``-`` and for an object."""
        _require_name(self, value, param, ctx)
        streams = _streams(ctx)
        if streams is not None and ctx is not None and is_url(value):
            if scheme_of(str(value)) in HTTP_SCHEMES:
                self.fail(
                    f"{redacted(str(value))}: web servers accept no files, expected the name of a "
                    "file, or of an object such as s3://bucket/key",
                    param,
                    ctx,
                )
            return streams.object_file(str(value), force=bool(ctx.params.get("force")))
        if os.fspath(value) != STREAM or streams is None or ctx is None:
            return Path(os.fsdecode(super().convert(value, param, ctx)))
        if ctx.meta.get(AS_JSON):
            raise click.UsageError("--json and a result on standard output, expected one of them")
        return streams.output_file(self._suffix)


INPUT: Final = InputPath()
"""Parameter type of a scene to read."""

INPUT_BY_RANGES: Final = InputPath(by_ranges=True)
"""Parameter type of a scene that a command reads by ranges from a network."""

PATH: Final = NamedPath()
"""Parameter type of every other file and folder that a command reads."""

WRITTEN_PATH: Final = NamedPath(is_output=True)
"""Parameter type of every other file and folder that a command writes."""


class StandardStreams:
    """Temporary files of a command for its streams, fetched URLs and objects to upload.

    Parameters
    ----------
    folder : Path
        Temporary folder that holds the files.
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

    def read_input(self) -> Path:
        """Read standard input to its end; return the path of the file that holds it.

        Raises
        ------
        click.UsageError
            Standard input is a terminal, or two arguments name it.
        """
        if self._input is not None:
            raise click.UsageError("- for two scenes, expected one on standard input")
        if sys.stdin is None or sys.stdin.isatty():
            raise click.UsageError("standard input is a terminal, expected a file or a pipe")
        self._input = self._folder / "input"
        self.set_name(self._input, _INPUT)
        with storage_errors(self._input), self._input.open("wb") as file:
            shutil.copyfileobj(sys.stdin.buffer, file)
        return self._input

    def fetch(self, url: str, *, later: bool, quiet: bool = False) -> Path:
        """Return the path of the temporary file for a URL.

        Parameters
        ----------
        url : str
        later : bool
            Whether the file is fetched by `fetch_if_url` only.
        quiet : bool
            Whether fetching prints no progress.

        Raises
        ------
        CogsplatError
            The URL cannot be fetched.
        """
        path = self._path_for(url, f"url{len(self._urls)}")
        self._urls[path] = url
        if quiet:
            self._quiet.add(path)
        return path if later else self.fetch_if_url(path)

    def _path_for(self, url: str, folder: str) -> Path:
        """Return the path of a file in a new folder, named like the file of a URL."""
        # The name is kept because its extension names the format.
        name = PurePosixPath(split_url(url).path).name or "scene"
        (self._folder / folder).mkdir()
        path = self._folder / folder / name[-_LONGEST_NAME:]
        self.set_name(path, redacted(url))
        return path

    def fetch_if_url(self, path: Path) -> Path:
        """Return the path; if it stands for a URL, download to the path first."""
        if path in self._urls and not exists(path):
            with Stages(shown=path not in self._quiet) as stages:
                download(self._urls[path], path, progress=stages)
        return path

    def unfetched_url(self, path: Path) -> str | None:
        """Return the URL that a path stands for, None for others and after the download."""
        return None if exists(path) else self._urls.get(path)

    def output_file(self, suffix: str) -> Path:
        """Return the path of the temporary file that is copied to standard output.

        Raises
        ------
        click.UsageError
            Standard output is a terminal, or two arguments name it.
        """
        if self._output is not None:
            raise click.UsageError("- for two outputs, expected one on standard output")
        if sys.stdout is None or sys.stdout.isatty():
            raise click.UsageError("standard output is a terminal, expected a file or a pipe")
        self._output = self._folder / f"output{suffix}"
        self.set_name(self._output, _OUTPUT)
        return self._output

    def object_file(self, url: str, *, force: bool) -> Path:
        """Return the path of the temporary file that is uploaded to an object store.

        Parameters
        ----------
        url : str
            Address of the object.
        force : bool
            Whether an existing object may be replaced.

        Raises
        ------
        TargetExistsError
            The object exists. Exit code 2.
        CogsplatError
            The store does not answer.
        """
        output = ObjectOutput(url)
        if not force:
            # Checked before the command starts its work.
            output.require_absent()
        self._force = force
        path = self._path_for(url, f"object{len(self._objects)}")
        self._objects[path] = url
        return path

    @property
    def is_output_reserved(self) -> bool:
        """Whether standard output is reserved for a file."""
        return self._output is not None

    def is_output(self, path: Path) -> bool:
        """Whether a path is the temporary file for standard output."""
        return path == self._output

    def send(self) -> None:
        """Copy the temporary files to standard output and to object stores.

        Raises
        ------
        CogsplatError
            A store refuses a file.
        """
        if self._output is not None and is_file(self._output):
            with self._output.open("rb") as file:
                shutil.copyfileobj(file, sys.stdout.buffer)
            sys.stdout.buffer.flush()
        for path, url in self._objects.items():
            # The files that the named file refers to are uploaded before it.
            beside = sorted(other for other in path.parent.iterdir() if other != path)
            start = url[: len(url) - len(PurePosixPath(split_url(url).path).name)]
            for other in beside:
                ObjectOutput(f"{start}{other.name}").write(other, force=self._force)
            if is_file(path):
                ObjectOutput(url).write(path, force=self._force)
        click.echo(self._held, nl=False)

    def hold_back(self, line: str) -> bool:
        """Keep a line until the uploads are finished; return whether there are any."""
        if self._objects and not self._ended:
            self._held += f"{line}\n"
            return True
        return False

    def release(self) -> None:
        """Print later lines at once, such as the error of a failed command."""
        self._ended = True

    def set_name(self, path: Path, name: str) -> None:
        """Set the name that printed texts use for a temporary file."""
        self._names[os.fspath(path)] = name

    def with_names(self, text: str) -> str:
        """Return a text with the paths of temporary files replaced by their names."""
        for path, name in self._names.items():
            text = text.replace(path, name)
        return text


@contextmanager
def standard_streams(ctx: click.Context) -> Iterator[None]:
    """Serve ``-`` and URLs to the command of a context; copy its results after the block."""
    with scratch_folder() as folder:
        streams = ctx.meta[_KEY] = StandardStreams(folder)
        try:
            yield
            streams.send()
        finally:
            streams.release()


def is_standard_output(path: Path) -> bool:
    """Whether a path of the running command is the temporary file for standard output."""
    streams = _streams(click.get_current_context(silent=True))
    return streams is not None and streams.is_output(path)


def given_inputs() -> list[Path]:
    """Return the paths given to arguments and options of the running command that it reads."""
    context = click.get_current_context(silent=True)
    if context is None:
        return []
    found: list[Path] = list(context.meta.get(READ_PATHS, ()))
    for param in context.command.params:
        if isinstance(param.type, InputPath) or (
            isinstance(param.type, NamedPath) and not param.type.is_output
        ):
            value = context.params.get(param.name or "")
            found += [value] if isinstance(value, Path) else list(value or ())
    return found


def is_output_reserved() -> bool:
    """Whether the running command sends a file to standard output."""
    streams = _streams(click.get_current_context(silent=True))
    return streams is not None and streams.is_output_reserved


def unfetched_url(path: Path) -> str | None:
    """Return the URL that a path stands for, None for others and after the download."""
    streams = _streams(click.get_current_context(silent=True))
    return None if streams is None else streams.unfetched_url(path)


def fetch_if_url(path: Path) -> Path:
    """Return the path; if it stands for a URL, download to the path first.

    Raises
    ------
    CogsplatError
        The URL cannot be fetched.
    """
    streams = _streams(click.get_current_context(silent=True))
    return path if streams is None else streams.fetch_if_url(path)


def hold_back(line: str) -> bool:
    """Keep a line of JSON until the uploads of the running command are finished.

    An upload may still fail, and only one JSON object may be printed.

    Returns
    -------
    bool
        True if the line is kept; False if nothing is uploaded.
    """
    streams = _streams(click.get_current_context(silent=True))
    return streams is not None and streams.hold_back(line)


def set_display_name(path: Path, name: str) -> None:
    """Set the name that texts of the running command use for a temporary file.

    Parameters
    ----------
    path : Path
        The temporary file, which the user does not know.
    name : str
        Name of its contents.
    """
    streams = _streams(click.get_current_context(silent=True))
    if streams is not None:
        streams.set_name(path, name)


def with_display_names(text: str) -> str:
    """Return a text with paths of the running command's temporary files replaced by names."""
    streams = _streams(click.get_current_context(silent=True))
    return text if streams is None else streams.with_names(text)


def _streams(ctx: click.Context | None) -> StandardStreams | None:
    """Return the streams of a context, None outside `standard_streams`."""
    found = None if ctx is None else ctx.meta.get(_KEY)
    return found if isinstance(found, StandardStreams) else None
