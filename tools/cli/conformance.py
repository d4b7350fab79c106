"""``cogsplat conformance``: any decoder against the conformance vectors."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from pathlib import Path

import click

from cogsplat.codec.errors import StorageError
from cogsplat.tools.conformance.runner import Failure, Report, run
from cogsplat.tools.terminal.options import PATH, json_option, quiet_option
from cogsplat.tools.terminal.output import counted, say, say_json, table
from cogsplat.tools.terminal.progress import Stages

_INVALID = 3
_MOST_SHOWN = 40


@click.group()
def conformance() -> None:
    """Prove a decoder of COGS against the conformance vectors."""


@conformance.command(
    "run",
    epilog="\b\nExample:\n"
    "  cogsplat conformance run --decoder 'node my-decoder.js'\n"
    "  cogsplat conformance run --json \\\n"
    "    --decoder 'python -m cogsplat.tools.conformance.decoder numpy'",
)
@click.option(
    "--decoder",
    required=True,
    metavar="CMD",
    help="Command line of the decoder under test; docs/conformance.md has the protocol.",
)
@click.option(
    "--vectors",
    type=PATH,
    metavar="DIR",
    help="Folder of the vectors; tests/vectors of this checkout where it is one.",
)
@click.option(
    "--timeout",
    type=click.FloatRange(min=0, min_open=True),
    default=30.0,
    show_default=True,
    metavar="SECONDS",
    help="Longest time for one file.",
)
@quiet_option
@json_option
def run_command(
    decoder: str, vectors: Path | None, timeout: float, quiet: bool, as_json: bool
) -> None:
    """Drive a decoder over all vectors and list what it fails, by clause of SPEC.md.

    The decoder is a program in any language. It reads one JSON request a line from standard input
    and answers each with one line. Exit status 3 where it fails a vector.
    """
    folder = vectors or _own_vectors()
    with Stages(shown=not (quiet or as_json)) as stages:
        report = run(shlex.split(decoder), folder, timeout_s=timeout, progress=stages)
    if as_json:
        say_json(_json(report))
    else:
        _tell(report, quiet=quiet)
    if report.failures:
        raise click.exceptions.Exit(_INVALID)


def _own_vectors() -> Path:
    # Resolved, because the import package reaches this folder through a link.
    folder = Path(__file__).resolve().parents[2] / "tests" / "vectors"
    if not (folder / "manifest.json").is_file():
        raise StorageError(
            "not-found",
            f"{folder}: no vectors here, expected --vectors with the folder tests/vectors of the "
            "source of cogsplat",
        )
    return folder


def _json(report: Report) -> dict[str, object]:
    return {
        "decoder": asdict(report.decoder),
        "passed": report.passed,
        "failed": len(report.failures),
        "failures": [asdict(failure) for failure in report.failures],
        "clauses": {
            clause: {"passed": passed, "checks": made}
            for clause, (passed, made) in report.by_clause.items()
        },
    }


def _tell(report: Report, *, quiet: bool) -> None:
    decoder = report.decoder
    say(
        f"{decoder.name} {decoder.version}, level {decoder.level}: "
        f"{report.passed:,} passed, {len(report.failures):,} failed"
    )
    if report.failures:
        broken = [
            (clause, f"{passed}/{made}")
            for clause, (passed, made) in report.by_clause.items()
            if passed < made
        ]
        table(("clause", "passed"), broken)
        for failure in report.failures[:_MOST_SHOWN]:
            say(_line(failure))
        more = len(report.failures) - _MOST_SHOWN
        if more > 0:
            say(f"  and {counted(more, 'failure')} more; --json lists all")
    elif not quiet:
        say(f"  {counted(len(report.by_clause), 'clause')} of SPEC.md, all passed")


def _line(failure: Failure) -> str:
    clauses = ", ".join(failure.clauses)
    return f"  {failure.vector} (SPEC {clauses}): {failure.found}; expected {failure.expected}"
