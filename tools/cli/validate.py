"""``cogsplat validate``: every rule that a COGS file breaks."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from cogsplat.codec.errors import CogsplatError, StorageError
from cogsplat.formats.cogs.sources import cogs_source
from cogsplat.formats.cogs.verification import Finding, finding_of, findings
from cogsplat.tools.terminal.limits import current_limits, limits_option
from cogsplat.tools.terminal.options import json_option, quiet_option
from cogsplat.tools.terminal.output import counted, name_of, say, say_json
from cogsplat.tools.terminal.partial import partial_accepted, partial_option
from cogsplat.tools.terminal.progress import Stages
from cogsplat.tools.terminal.standard_streams import INPUT

_INVALID = 3


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat validate scene.cogs\n"
    "  cogsplat validate scene.cogs --json | jq '.findings[].code'"
)
@click.argument("path", type=INPUT, metavar="IN.cogs")
@partial_option
@limits_option
@quiet_option
@json_option
def validate(path: Path, quiet: bool, as_json: bool) -> None:
    """Check a COGS file or folder against every rule of SPEC.md.

    All segments are read, hashed and decoded, and all broken rules are listed, each with its reason
    code, the clause of SPEC.md and the byte offset. Exit status 3 where there are any. With
    --partial, a file that is short is no finding.
    """
    with Stages(shown=not (quiet or as_json)) as stages:
        found = file_findings(path, stages)
    if as_json:
        say_json(
            {
                "source": name_of(path),
                "valid": not found,
                "findings": [asdict(finding) for finding in found],
            }
        )
    else:
        for finding in found:
            say(_line(finding))
            say(f"    {finding.message}")
        if not found and not quiet:
            what = "what is there conforms" if partial_accepted() else "conforms"
            say(f"{name_of(path)}: {what} to SPEC.md")
        elif found:
            say(f"{name_of(path)}: {counted(len(found), 'finding')}")
    if found:
        raise click.exceptions.Exit(_INVALID)


def file_findings(path: Path, stages: Stages) -> list[Finding]:
    """Return the rules that a file or folder breaks, within the limits of the command.

    Raises
    ------
    StorageError
        It cannot be read.
    """
    try:
        source = cogs_source(path)
    except StorageError:
        raise
    except CogsplatError as error:
        # The manifest of a folder, which is read first.
        return [finding_of(error)]
    try:
        return findings(
            source, partial=partial_accepted(), limits=current_limits(), progress=stages
        )
    finally:
        source.close()


def _line(finding: Finding) -> str:
    where = "" if finding.offset is None else f" at byte {finding.offset:,}"
    clause = f"SPEC {finding.clause}" if finding.clause else "SPEC"
    return f"{finding.code:<24} {clause:<10}{where}"
