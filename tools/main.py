"""The command group, and the one place that turns failures into messages and exit codes."""

from __future__ import annotations

import importlib
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType, MappingProxyType
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
from cogsplat.formats.cogs import layout
from cogsplat.formats.storage.atomic import storage_error
from cogsplat.tools.terminal.output import WARNINGS, say_json
from cogsplat.tools.terminal.standard_streams import (
    AS_JSON,
    standard_streams,
    with_streams_named,
)

_USAGE: Final = 2

# How long a thread may hold the interpreter while another waits for it. Ours need it for moments,
# between kernels that take 3 ms and run without it: with Python's own 5 ms, two threads took as
# long as one to measure gains.
_SWITCH_SECONDS: Final = 0.0003

# The extra that the message of a `MissingExtraError` names.
_EXTRA_NAME: Final = re.compile(r"cogsplat\[(\w+)\]")

# Packages of the extra `encode`, by the names they are imported under.
_ENCODE_EXTRA: Final = frozenset({"numba", "scipy", "sklearn", "threadpoolctl", "plyfile", "PIL"})

# What ends the work as Ctrl-C does, so that nothing half-written stays behind.
_STOP_SIGNALS: Final = ("SIGTERM", "SIGHUP")

# What the command line adds to a refusal, where the command has the option: messages of the library
# name no options, because its callers have none.
_HINTS: Final = {
    "exists": ("--force", "--force replaces it"),
    "file-truncated": ("--partial", "--partial takes the chunks that are complete"),
    "segment-missing": ("--partial", "--partial takes the chunks that are complete"),
    "invalid-rows": ("--drop-invalid", "--drop-invalid leaves those splats out"),
    "decoded-size": ("--limits", "--limits memory=8GiB,expansion=4096, or other sizes, allows it"),
    "too-many-splats": ("--limits", "--limits splats=100M, or another number, allows it"),
    "too-many-cameras": ("--limits", "--limits cameras=1M, or another number, allows it"),
}


# The commands in the order of their use, and where they are. A module is imported when its command
# is asked for: together they take longer to import than some commands to run.
_COMMANDS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "encode": "cli.encode.encode",
        "batch": "cli.batch.batch",
        "tune": "cli.tune.tune",
        "layers": "cli.layers.layers",
        "decode": "cli.decode.decode",
        "convert": "cli.convert.convert",
        "merge": "cli.merge.merge",
        "filter": "cli.filter.filter_scene",
        "decimate": "cli.decimate.decimate",
        "view": "cli.view.view",
        "export-html": "cli.export_html.export_html",
        "serve": "cli.serve.serve",
        "unpack": "cli.folders.unpack",
        "pack": "cli.folders.pack",
        "upload": "cli.upload.upload",
        "info": "cli.info.info",
        "validate": "cli.validate.validate",
        "verify": "cli.verify.verify",
        "stats": "cli.stats.stats",
        "score": "lab.cli.score.score",
        "order": "lab.cli.order.order",
        "views": "lab.cli.views.views",
        "render": "cli.compare.render",
        "compare": "cli.compare.compare",
        "eval": "lab.cli.evaluate.evaluate",
        "simulate": "lab.cli.simulate.simulate",
        "bench": "lab.cli.bench.bench",
        "synth": "lab.cli.synth.synth",
        "demo": "lab.cli.synth.demo",
        "conformance": "lab.cli.conformance.conformance",
        "warm": "cli.warm.warm",
    }
)


class _OutputError(StorageError):
    """Standard output could not be written."""


def _checkout() -> Path | None:
    """Return the checkout that the package is imported from, None where it was installed."""
    root = Path(cogsplat.__file__).resolve().parents[1]
    return root if (root / "pyproject.toml").is_file() else None


class CommandLine(click.Group):
    """A group of commands that turns every failure into a message and an exit code.

    Usage is 2, the rest as `CogsplatError.exit_code` says; a fault of the program itself keeps its
    traceback and exits with 1.
    """

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the commands in the order of their use."""
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command, None where there is none of this name."""
        # A message on a name that is none suggests others of those that were added.
        for name in [cmd_name] if cmd_name in _COMMANDS else _COMMANDS:
            if name not in self.commands:
                module, attribute = _COMMANDS[name].rsplit(".", 1)
                found = getattr(importlib.import_module(f"{__package__}.{module}"), attribute)
                self.add_command(found, name)
        return super().get_command(ctx, cmd_name)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the group's own options; without any argument, show the help."""
        if not args and not ctx.resilient_parsing:
            click.echo(ctx.get_help(), err=True)
            ctx.exit(_USAGE)
        return super().parse_args(ctx, args)

    def make_context(
        self,
        info_name: str | None,
        args: list[str],
        parent: click.Context | None = None,
        **extra: object,
    ) -> click.Context:
        """Parse the group's own options; report failures."""
        as_json = "--json" in args
        with _failures_told(as_json):
            ctx = super().make_context(info_name, args, parent, **extra)
        ctx.meta[AS_JSON] = as_json
        return ctx

    def invoke(self, ctx: click.Context) -> object:
        """Run a command; report failures."""
        as_json = bool(ctx.meta[AS_JSON])
        with (
            _failures_told(as_json, ctx),
            _stoppable(),
            _warnings_told(ctx, as_json),
            standard_streams(ctx),
        ):
            return super().invoke(ctx)


@contextmanager
def _failures_told(as_json: bool, group: click.Context | None = None) -> Iterator[None]:
    """Print the error that the block raises and exit with its code.

    `group` is the context whose command runs, for a hint at one of its options.
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
        _tell("usage", error.format_message(), _USAGE, as_json, hint)
        raise click.exceptions.Exit(_USAGE) from None
    except CogsplatError as error:
        arrives = not isinstance(error, _OutputError)
        hint = (
            _extra_hint(error) if isinstance(error, MissingExtraError) else _hint(error.code, group)
        )
        _tell(error.code, error.message, error.exit_code, as_json and arrives, hint)
        raise click.exceptions.Exit(error.exit_code) from None


def _extra_hint(error: CogsplatError) -> str:
    """Return how the extra is installed where the package is not from an index."""
    root = _checkout()
    if root is None:
        return ""
    place = "." if root == Path.cwd() else os.fspath(root)
    named = _EXTRA_NAME.search(error.message)
    extra = named[1] if named else "encode"
    return f"from this checkout: pip install -e '{place}[{extra}]'"


def _hint(code: str, group: click.Context | None) -> str:
    """Return what option helps against a refusal, nothing where the command does not have it."""
    option, text = _HINTS.get(code, ("", ""))
    if not option or group is None or not isinstance(group.command, click.Group):
        return ""
    command = group.command.get_command(group, group.invoked_subcommand or "")
    has = command is not None and any(option in parameter.opts for parameter in command.params)
    return text if has else ""


@contextmanager
def _as_cogsplat_errors() -> Iterator[None]:
    """Turn errors of the operating system, of memory and of missing extras into `CogsplatError`."""
    try:
        yield
    except (KeyboardInterrupt, click.Abort) as error:
        raise Cancelled("interrupted") from error
    except MemoryError as error:
        raise LimitError("memory", f"out of memory: {error or 'no more to be had'}") from error
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        if module not in _ENCODE_EXTRA:
            raise
        raise MissingExtraError(
            "needs-extra",
            f"this takes {module}, which is not installed; it needs the extra: "
            "pip install 'cogsplat[encode]'",
        ) from error
    except OSError as error:
        # Files report theirs as `StorageError`; what is left is what was printed.
        _drop_output()
        if isinstance(error, BrokenPipeError):
            raise _OutputError("broken-pipe", "closed by its reader") from error
        told = storage_error(error, "standard output")
        raise _OutputError(told.code, told.message) from error


def _flush() -> None:
    # Here rather than when the interpreter ends, where a failure could no longer be told.
    if sys.stdout is not None:
        sys.stdout.flush()


def _drop_output() -> None:
    """Discard the buffer of standard output, so that the interpreter's exit does not fail on it."""
    # In-memory outputs have no descriptor and hold nothing back.
    with suppress(OSError, ValueError, AttributeError):
        descriptor = sys.stdout.fileno()
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, descriptor)
        os.close(nowhere)


def _tell(code: str, message: str, exit_code: int, as_json: bool, hint: str = "") -> None:
    # Whoever closed the pipe, as `head` does, has all it wanted.
    if code == "broken-pipe":
        return
    message = with_streams_named(message)
    # Where even this does not arrive, the exit code still tells.
    with suppress(OSError):
        if as_json:
            told = {"code": code, "message": message, "exit_code": exit_code}
            say_json({"error": {**told, "hint": hint} if hint else told})
            _flush()
            return
        click.echo(f"error: {printable(message)} [{code}]", err=True)
        if hint:
            click.echo(printable(hint), err=True)
        return
    _drop_output()


@contextmanager
def _stoppable() -> Iterator[None]:
    """Let signals that end a process raise in the block, so that it cleans up."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    with ExitStack() as stack:
        for name in _STOP_SIGNALS:
            number = getattr(signal, name, None)
            # One that is ignored, as under nohup, stays ignored.
            if number is not None and signal.getsignal(number) is signal.SIG_DFL:
                signal.signal(number, _interrupt)
                stack.callback(signal.signal, number, signal.SIG_DFL)
        yield


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


@contextmanager
def _warnings_told(ctx: click.Context, as_json: bool) -> Iterator[None]:
    """Print each `CogsplatWarning` of the block once, or keep it for the JSON object."""
    told: list[str] = []
    ctx.meta[WARNINGS] = told
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
            text = with_streams_named(str(message))
            if text not in told:
                told.append(text)
                if not as_json:
                    click.echo(f"warning: {text}", err=True)

        warnings.showwarning = show
        warnings.simplefilter("always", CogsplatWarning)
        yield


@click.group(
    cls=CommandLine,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="\b\nExample:\n"
    "  cogsplat demo\n\n"
    "A scene called - comes from standard input, an output called - goes to standard output.\n\n"
    "Exit status: 0 done, 2 misuse, 3 invalid data, 4 input or output failed or an extra is not "
    "installed, 5 a limit was reached, 130 interrupted. A command that fails leaves no "
    "half-written file.",
)
@click.version_option(
    cogsplat.__version__,
    message=f"cogsplat %(version)s, COGS {layout.MAJOR}.{layout.MINOR}",
)
def cli() -> None:
    """Turn 3D Gaussian splatting scenes into progressive COGS files and back."""


def main() -> None:
    """Run the command line."""
    sys.setswitchinterval(_SWITCH_SECONDS)
    cli(prog_name="cogsplat")


if __name__ == "__main__":
    main()
