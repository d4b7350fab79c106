"""The outermost command group, which turns failures into messages and exit codes."""

from __future__ import annotations

import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Final

import click

import cogsplat
from cogsplat.codec.errors import (
    Cancelled,
    CogsplatError,
    CogsplatWarning,
    LimitError,
    MissingExtraError,
    StorageError,
    printable,
)
from cogsplat.formats.storage.atomic import storage_error

from .lazy_group import LazyGroup, invoked_command
from .output import WARNINGS, print_json
from .standard_streams import AS_JSON, standard_streams, with_display_names

_USAGE_STATUS: Final = 2

# Finds the extra in the message of a `MissingExtraError`.
_EXTRA_NAME: Final = re.compile(r"cogsplat\[(\w+)\]")

# Import names of the packages of the extra `encode`.
_ENCODE_EXTRA: Final = frozenset({"numba", "scipy", "sklearn", "threadpoolctl", "plyfile", "PIL"})

# Signals handled like Ctrl-C, so that no half-written file stays behind.
_STOP_SIGNALS: Final = ("SIGTERM", "SIGHUP")

# Option and hint for a reason code, printed where the command has that option. Messages of the
# library name no options: its callers in Python have none.
_HINTS: Final = {
    "exists": ("--force", "--force replaces it"),
    "file-truncated": ("--partial", "--partial reads the chunks that are complete"),
    "segment-missing": ("--partial", "--partial reads the chunks that are complete"),
    "target-out-of-reach": (
        "--no-prune",
        "`cogsplat tune` trains fewer splats to show the scene in a size; `cogsplat filter --keep` "
        "removes the splats that matter least, without training",
    ),
    "ply-magic": ("--splats", "`cogsplat convert` writes a PLY"),
    "ply-not-plain": ("--splats", "`cogsplat convert` writes such a PLY"),
    "invalid-rows": ("--drop-invalid", "--drop-invalid leaves those splats out"),
    "decoded-size": ("--limits", "--limits memory=8GiB,expansion=4096 or larger values allow it"),
    "too-many-splats": ("--limits", "--limits splats=100M or a larger number allows it"),
    "too-many-cameras": ("--limits", "--limits cameras=1M or a larger number allows it"),
}


class _OutputError(StorageError):
    """Standard output could not be written."""


def _checkout() -> Path | None:
    """Return the checkout that the package is imported from, None for an installed package."""
    root = Path(cogsplat.__file__).resolve().parents[1]
    return root if (root / "pyproject.toml").is_file() else None


class CommandLine(LazyGroup):
    """The outermost group of commands, which turns every failure into a message and an exit code.

    The exit code is 2 for misuse, `CogsplatError.exit_code` for other failures. A bug keeps its
    traceback and exits with 1.
    """

    def make_context(
        self,
        info_name: str | None,
        args: list[str],
        parent: click.Context | None = None,
        **extra: object,
    ) -> click.Context:
        """Parse the group's own options; print failures."""
        as_json = "--json" in args
        with _report_failures(as_json):
            ctx = super().make_context(info_name, args, parent, **extra)
        ctx.meta[AS_JSON] = as_json
        return ctx

    def invoke(self, ctx: click.Context) -> object:
        """Run a command; print failures."""
        as_json = bool(ctx.meta[AS_JSON])
        with (
            _report_failures(as_json, ctx),
            _raise_on_signals(),
            _report_warnings(ctx, as_json),
            standard_streams(ctx),
        ):
            return super().invoke(ctx)


@contextmanager
def _report_failures(as_json: bool, group: click.Context | None = None) -> Iterator[None]:
    """Print the error that the block raises and exit with its code.

    Parameters
    ----------
    as_json : bool
        Whether the error is printed as a JSON object.
    group : click.Context, optional
        Context of the outermost group; its running command decides which hints apply.
    """
    try:
        with _as_cogsplat_errors():
            try:
                yield
            except click.exceptions.Exit:
                _flush()
                raise
            _flush()
    except click.ClickException as error:
        hint = ""
        if isinstance(error, click.UsageError) and error.ctx:
            hint = f"try '{error.ctx.command_path} --help'"
        _print_error("usage", error.format_message(), _USAGE_STATUS, as_json, hint)
        raise click.exceptions.Exit(_USAGE_STATUS) from None
    except CogsplatError as error:
        output_works = not isinstance(error, _OutputError)
        hint = (
            _extra_hint(error) if isinstance(error, MissingExtraError) else _hint(error.code, group)
        )
        _print_error(error.code, error.message, error.exit_code, as_json and output_works, hint)
        raise click.exceptions.Exit(error.exit_code) from None


def _extra_hint(error: CogsplatError) -> str:
    """Return the command that installs the extra from a checkout, nothing without a checkout."""
    root = _checkout()
    if root is None:
        return ""
    folder = "." if root == Path.cwd() else os.fspath(root)
    match = _EXTRA_NAME.search(error.message)
    extra = match[1] if match else "encode"
    return f"from this checkout: pip install -e '{folder}[{extra}]'"


def _hint(code: str, group: click.Context | None) -> str:
    """Return the hint for a reason code, nothing where the running command lacks its option."""
    option, text = _HINTS.get(code, ("", ""))
    command = None if group is None else invoked_command(group)
    if not option or command is None:
        return ""
    return text if any(option in parameter.opts for parameter in command.params) else ""


@contextmanager
def _as_cogsplat_errors() -> Iterator[None]:
    """Turn errors of the operating system, of memory and of missing extras into `CogsplatError`."""
    try:
        yield
    except (KeyboardInterrupt, click.Abort) as error:
        raise Cancelled("interrupted") from error
    except MemoryError as error:
        raise LimitError("memory", f"out of memory: {error or 'an allocation failed'}") from error
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        if module not in _ENCODE_EXTRA:
            raise
        raise MissingExtraError(
            "needs-extra",
            f"this command needs {module}, which is not installed; install the extra: "
            "pip install 'cogsplat[encode]'",
        ) from error
    except OSError as error:
        # Errors of files are raised as `StorageError`, so this one is of standard output.
        _drop_output()
        if isinstance(error, BrokenPipeError):
            raise _OutputError("broken-pipe", "closed by its reader") from error
        failure = storage_error(error, "standard output")
        raise _OutputError(failure.code, failure.message) from error


def _flush() -> None:
    """Write the buffer of standard output while a failure can still be reported."""
    if sys.stdout is not None:
        sys.stdout.flush()


def _drop_output() -> None:
    """Discard the buffer of standard output, so that the interpreter's exit does not fail on it."""
    # An output in memory has no descriptor, and its buffer cannot fail.
    with suppress(OSError, ValueError, AttributeError):
        descriptor = sys.stdout.fileno()
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, descriptor)
        os.close(null)


def _print_error(code: str, message: str, exit_code: int, as_json: bool, hint: str = "") -> None:
    """Print an error to standard error, or as a JSON object to standard output."""
    # A reader that closed the pipe, such as `head`, needs no message.
    if code == "broken-pipe":
        return
    message = with_display_names(message)
    # Without a working standard error, the exit code remains.
    with suppress(OSError):
        if as_json:
            report = {"code": code, "message": message, "exit_code": exit_code}
            print_json({"error": {**report, "hint": hint} if hint else report})
            _flush()
            return
        click.echo(f"error: {printable(message)} [{code}]", err=True)
        if hint:
            click.echo(printable(hint), err=True)
        return
    _drop_output()


@contextmanager
def _raise_on_signals() -> Iterator[None]:
    """Raise `KeyboardInterrupt` on signals that end a process, so that the block cleans up."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    with ExitStack() as stack:
        for name in _STOP_SIGNALS:
            number = getattr(signal, name, None)
            # A signal that is ignored, as under nohup, stays ignored.
            if number is not None and signal.getsignal(number) is signal.SIG_DFL:
                signal.signal(number, _interrupt)
                stack.callback(signal.signal, number, signal.SIG_DFL)
        yield


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


@contextmanager
def _report_warnings(ctx: click.Context, as_json: bool) -> Iterator[None]:
    """Print each `CogsplatWarning` of the block once, or keep it for the JSON object."""
    texts: list[str] = []
    ctx.meta[WARNINGS] = texts
    with warnings.catch_warnings():
        show_other = warnings.showwarning

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: object = None,
            line: str | None = None,
        ) -> None:
            if not issubclass(category, CogsplatWarning):
                show_other(message, category, filename, lineno, None, line)
                return
            text = with_display_names(str(message))
            if text not in texts:
                texts.append(text)
                if not as_json:
                    click.echo(f"warning: {text}", err=True)

        warnings.showwarning = show
        warnings.simplefilter("always", CogsplatWarning)
        yield
