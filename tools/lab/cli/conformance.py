"""``cogsplat conformance``: any decoder against the conformance vectors."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Final, TypeVar

import click

from cogsplat.codec.errors import StorageError
from cogsplat.formats.storage.atomic import atomic_write, open_for_read, storage_errors
from cogsplat.tools.lab.conformance.differential import FuzzReport, fuzz, vector_files
from cogsplat.tools.lab.conformance.runner import Failure, Report, run
from cogsplat.tools.terminal.options import json_option, quiet_option
from cogsplat.tools.terminal.output import counted, say, say_json, table
from cogsplat.tools.terminal.progress import Stages
from cogsplat.tools.terminal.standard_streams import PATH

Command = TypeVar("Command", bound=Callable[..., object])

_INVALID = 3
_MOST_SHOWN = 40


_VECTORS: Final = click.option(
    "--vectors",
    type=PATH,
    metavar="DIR",
    help="Folder of the vectors; tests/vectors of this checkout where it is one.",
)


def _timeout_option(what: str) -> Callable[[Command], Command]:
    return click.option(
        "--timeout",
        type=click.FloatRange(min=0, min_open=True),
        default=30.0,
        show_default=True,
        metavar="SECONDS",
        help=f"Longest time for one {what}.",
    )


@click.group()
def conformance() -> None:
    """Prove a decoder of COGS against the conformance vectors."""


@conformance.command(
    "run",
    epilog="\b\nExample:\n"
    "  cogsplat conformance run --decoder 'node my-decoder.js'\n"
    "  cogsplat conformance run --json \\\n"
    "    --decoder 'python -m cogsplat.tools.lab.conformance.decoder numpy'",
)
@click.option(
    "--decoder",
    required=True,
    metavar="CMD",
    help="Command line of the decoder under test; docs/conformance.md has the protocol.",
)
@_VECTORS
@_timeout_option("file")
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
        say_json({**_json(report), "seconds": stages.rounded()})
    else:
        _tell(report, quiet=quiet)
    if report.failures:
        raise click.exceptions.Exit(_INVALID)


@conformance.command(
    "fuzz",
    epilog="\b\nExample:\n"
    "  cogsplat conformance fuzz --count 1000 --seed 1 \\\n"
    "    --decoder 'python -m cogsplat.tools.lab.conformance.decoder numpy' \\\n"
    "    --decoder 'node my-decoder.js'",
)
@click.argument("files", type=PATH, nargs=-1)
@click.option(
    "--decoder",
    "decoders",
    required=True,
    multiple=True,
    metavar="CMD",
    help="Command line of a decoder, two of them or more; docs/conformance.md has the protocol.",
)
@click.option(
    "--count", type=click.IntRange(min=1), default=1000, show_default=True, help="Mutants."
)
@click.option(
    "--seed", type=int, default=1, show_default=True, help="The same seed makes the same mutants."
)
@click.option(
    "--first",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    metavar="NUMBER",
    help="Begin with this mutant of the run.",
)
@_VECTORS
@click.option(
    "--keep",
    type=PATH,
    metavar="DIR",
    help="Folder to write the mutants to of which decoders say different things.",
)
@_timeout_option("mutant")
@quiet_option
@json_option
def fuzz_command(
    files: tuple[Path, ...],
    decoders: tuple[str, ...],
    count: int,
    seed: int,
    first: int,
    vectors: Path | None,
    keep: Path | None,
    timeout: float,
    quiet: bool,
    as_json: bool,
) -> None:
    """Ask decoders about damaged and deceiving files; all must say the same of each.

    Mutants are made from the valid conformance vectors and from FILES, small ones best. Compared
    are verdict, reason code and the bits of decoded arrays. Exit status 3 where decoders differ.
    """
    if len(decoders) < 2:
        raise click.UsageError("one --decoder, expected two or more to compare")
    if keep is not None:
        # Before the mutants are made, not after.
        with storage_errors(keep):
            keep.mkdir(parents=True, exist_ok=True)
    sources = vector_files(vectors or _own_vectors())
    for path in files:
        with open_for_read(path) as file:
            sources.append((path.name, file.read()))
    with Stages(shown=not (quiet or as_json)) as stages:
        report = fuzz(
            [shlex.split(decoder) for decoder in decoders],
            sources,
            seed=seed,
            count=count,
            first=first,
            timeout_s=timeout,
            progress=stages,
        )
    if keep is not None:
        for case in report.disagreements:
            with atomic_write(keep / f"{seed}-{case.number}.cogs", force=True) as file:
                file.write(case.mutant.data)
    if as_json:
        say_json({**_fuzz_json(report), "seconds": stages.rounded()})
    else:
        _tell_fuzz(report, quiet=quiet)
    if report.disagreements:
        raise click.exceptions.Exit(_INVALID)


def _own_vectors() -> Path:
    # Resolved, because the import package reaches this folder through a link.
    folder = Path(__file__).resolve().parents[3] / "tests" / "vectors"
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


def _fuzz_json(report: FuzzReport) -> dict[str, object]:
    return {
        "decoders": [
            asdict(decoder) | {"most_memory_bytes": memory}
            for decoder, memory in zip(report.decoders, report.most_memory, strict=True)
        ],
        "mutants": report.mutants,
        "verdicts": report.verdicts,
        "slowest_s": report.slowest_s,
        "disagreements": [
            {
                "number": case.number,
                "file": case.mutant.seed_file,
                "change": case.mutant.change,
                "partial": case.mutant.partial,
                "verify": case.verify,
                "verdicts": list(case.verdicts),
            }
            for case in report.disagreements
        ],
    }


def _tell_fuzz(report: FuzzReport, *, quiet: bool) -> None:
    accepted = report.verdicts.get("accepted", 0)
    say(
        f"{counted(report.mutants, 'mutant')}, {accepted:,} of them read, "
        f"{counted(len(report.disagreements), 'disagreement')}; "
        f"the slowest took {report.slowest_s:.2f} s"
    )
    for case in report.disagreements[:_MOST_SHOWN]:
        how = ", partial" * case.mutant.partial + ", verified" * case.verify
        said = "; ".join(
            f"{decoder.name}: {verdict or 'not asked'}"
            for decoder, verdict in zip(report.decoders, case.verdicts, strict=True)
        )
        say(f"  {case.number}: {case.mutant.seed_file}, {case.mutant.change}{how}: {said}")
    more = len(report.disagreements) - _MOST_SHOWN
    if more > 0:
        say(f"  and {counted(more, 'disagreement')} more; --json lists all")
    if not quiet:
        for decoder, memory in zip(report.decoders, report.most_memory, strict=True):
            say(f"  {decoder.name} {decoder.version}: at most {memory / 2**20:.0f} MiB")


def _line(failure: Failure) -> str:
    clauses = ", ".join(failure.clauses)
    return f"  {failure.vector} (SPEC {clauses}): {failure.found}; expected {failure.expected}"
