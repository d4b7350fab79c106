"""``cogsplat lab conformance run``: one decoder against the conformance vectors."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Final

import click

from cogsplat.tools.lab.conformance.runner import Failure, Report
from cogsplat.tools.lab.conformance.runner import run as run_vectors
from cogsplat.tools.terminal.options import json_option, quiet_option
from cogsplat.tools.terminal.output import count_text, print_json, print_line, print_table
from cogsplat.tools.terminal.progress_bars import Stages

from .conformance_options import MOST_SHOWN, VECTORS, own_vectors, timeout_option

_INVALID_STATUS: Final = 3


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat lab conformance run --decoder 'node my-decoder.js'\n"
    "  cogsplat lab conformance run --json \\\n"
    "    --decoder 'python -m cogsplat.tools.lab.conformance.decoder numpy'",
)
@click.option(
    "--decoder",
    required=True,
    metavar="CMD",
    help="Command line of the decoder under test; docs/conformance.md has the protocol.",
)
@VECTORS
@timeout_option("file")
@quiet_option
@json_option
def run(decoder: str, vectors: Path | None, timeout: float, quiet: bool, as_json: bool) -> None:
    """Run a decoder over all vectors and list failures by clause of SPEC.md.

    The decoder is a program in any language that reads JSON requests from standard input, one a
    line, and answers each with one line. Exit status 3 if any vector fails.
    """
    folder = vectors or own_vectors()
    with Stages(shown=not (quiet or as_json)) as stages:
        report = run_vectors(shlex.split(decoder), folder, timeout_s=timeout, progress=stages)
    if as_json:
        print_json({**_json(report), "seconds": stages.rounded_seconds()})
    else:
        _print_summary(report, quiet=quiet)
    if report.failures:
        raise click.exceptions.Exit(_INVALID_STATUS)


def _json(report: Report) -> dict[str, object]:
    """Return the JSON object."""
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


def _print_summary(report: Report, *, quiet: bool) -> None:
    """Print the result of all vectors and the first failures."""
    decoder = report.decoder
    print_line(
        f"{decoder.name} {decoder.version}, level {decoder.level}: "
        f"{report.passed:,} passed, {len(report.failures):,} failed"
    )
    if report.failures:
        broken = [
            (clause, f"{passed}/{made}")
            for clause, (passed, made) in report.by_clause.items()
            if passed < made
        ]
        print_table(("clause", "passed"), broken)
        for failure in report.failures[:MOST_SHOWN]:
            print_line(_line(failure))
        more = len(report.failures) - MOST_SHOWN
        if more > 0:
            print_line(f"  and {count_text(more, 'failure')} more; --json lists all")
    elif not quiet:
        print_line(f"  {count_text(len(report.by_clause), 'clause')} of SPEC.md, all passed")


def _line(failure: Failure) -> str:
    """Return a failure as a line of text."""
    clauses = ", ".join(failure.clauses)
    return f"  {failure.vector} (SPEC {clauses}): {failure.found}; expected {failure.expected}"
