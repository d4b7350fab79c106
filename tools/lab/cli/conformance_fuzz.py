"""``cogsplat lab conformance fuzz``: a comparison of decoders on damaged files."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Final

import click

from cogsplat.formats.storage.atomic import atomic_write, is_file, open_for_read, storage_errors
from cogsplat.tools.lab.conformance.differential import FuzzReport, vector_files
from cogsplat.tools.lab.conformance.differential import fuzz as fuzz_decoders
from cogsplat.tools.terminal.options import json_option, quiet_option
from cogsplat.tools.terminal.output import count_text, print_json, print_line
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import PATH, WRITTEN_PATH

from .conformance_options import MOST_SHOWN, VECTORS, own_vectors, timeout_option

_INVALID_STATUS: Final = 3


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat lab conformance fuzz --count 1000 --seed 1 \\\n"
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
    help="Command line of a decoder, two or more; docs/conformance.md has the protocol.",
)
@click.option(
    "--count",
    type=click.IntRange(min=1),
    default=1000,
    show_default=True,
    help="Number of mutants.",
)
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of the mutants.")
@click.option(
    "--first",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    metavar="NUMBER",
    help="Number of the first mutant.",
)
@VECTORS
@click.option(
    "--keep",
    type=WRITTEN_PATH,
    metavar="DIR",
    help="Folder for the mutants on which decoders differ.",
)
@timeout_option("mutant")
@quiet_option
@json_option
def fuzz(
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
    """Compare the answers of decoders on damaged and malicious files.

    Mutants are made from the valid conformance vectors and from FILES, preferably small ones.
    Verdict, reason code and decoded arrays must be equal. Exit status 3 if decoders differ.
    """
    if len(decoders) < 2:
        raise click.UsageError("one --decoder, expected two or more to compare")
    if keep is not None:
        # Checked before the mutants are made.
        with storage_errors(keep):
            keep.mkdir(parents=True, exist_ok=True)
    sources = vector_files(vectors or own_vectors())
    for path in files:
        with open_for_read(path) as file:
            sources.append((path.name, file.read()))
    with Stages(shown=not (quiet or as_json)) as stages:
        report = fuzz_decoders(
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
            path = keep / f"{seed}-{case.number}.cogs"
            # An earlier run of the same seed keeps the same mutants; other files stay.
            if not (is_file(path) and path.read_bytes() == case.mutant.data):
                with atomic_write(path) as file:
                    file.write(case.mutant.data)
    if as_json:
        print_json({**_json(report), "seconds": stages.rounded_seconds()})
    else:
        _print_summary(report, quiet=quiet)
    if report.disagreements:
        raise click.exceptions.Exit(_INVALID_STATUS)


def _json(report: FuzzReport) -> dict[str, object]:
    """Return the JSON object."""
    return {
        "decoders": [
            asdict(decoder) | {"most_memory_bytes": memory}
            for decoder, memory in zip(report.decoders, report.peak_memory, strict=True)
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


def _print_summary(report: FuzzReport, *, quiet: bool) -> None:
    """Print the disagreements and the cost of each decoder."""
    accepted = report.verdicts.get("accepted", 0)
    print_line(
        f"{count_text(report.mutants, 'mutant')}, {accepted:,} of them read, "
        f"{count_text(len(report.disagreements), 'disagreement')}; "
        f"the slowest took {report.slowest_s:.2f} s"
    )
    for case in report.disagreements[:MOST_SHOWN]:
        how = ", partial" * case.mutant.partial + ", verified" * case.verify
        said = "; ".join(
            f"{decoder.name}: {verdict or 'not asked'}"
            for decoder, verdict in zip(report.decoders, case.verdicts, strict=True)
        )
        print_line(f"  {case.number}: {case.mutant.seed_file}, {case.mutant.change}{how}: {said}")
    more = len(report.disagreements) - MOST_SHOWN
    if more > 0:
        print_line(f"  and {count_text(more, 'disagreement')} more; --json lists all")
    if not quiet:
        for decoder, memory in zip(report.decoders, report.peak_memory, strict=True):
            print_line(f"  {decoder.name} {decoder.version}: at most {memory / 2**20:.0f} MiB")
