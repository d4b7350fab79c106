"""``cogsplat check``: a COGS file against the format, and a host against what readers need."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Final

import click
from click.shell_completion import CompletionItem

from cogsplat.codec.errors import CogsplatError, StorageError
from cogsplat.formats.cogs.findings import Finding, finding_of, findings
from cogsplat.formats.cogs.open_file import open_source
from cogsplat.formats.network.urls import HTTP_SCHEMES, is_url, scheme_of
from cogsplat.tools.hosting.doctor import Diagnosis, diagnose
from cogsplat.tools.hosting.remedies import HOSTS, host_of, remedies
from cogsplat.tools.hosting.rules import ERROR, NOTE, SEVERITIES, WARNING, HostFinding
from cogsplat.tools.terminal.limits_option import current_limits, limits_option
from cogsplat.tools.terminal.options import json_option, quiet_option
from cogsplat.tools.terminal.output import (
    count_text,
    display_name,
    print_facts,
    print_json,
    print_line,
)
from cogsplat.tools.terminal.partial import partial_accepted, partial_option
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.terminal.standard_streams import INPUT

_INVALID_STATUS: Final = 3


class _Target(click.ParamType[Path | str]):
    """A file, a folder, or the URL of a web server, which stays text."""

    name = "path"

    def convert(
        self,
        value: str | os.PathLike[str],
        param: click.Parameter | None,
        ctx: click.Context | None,
    ) -> Path | str:
        """Return the URL of a web server as it is, the path of everything else."""
        if is_url(value) and scheme_of(str(value)) in HTTP_SCHEMES:
            return str(value)
        return INPUT.convert(value, param, ctx)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Delegate the completion of file names to the shell."""
        return INPUT.shell_complete(ctx, param, incomplete)


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat check scene.cogs\n"
    "  cogsplat check scene.cogs --json | jq '.findings[].code'\n"
    "  cogsplat check https://example.org/scene.cogs"
)
@click.argument("target", type=_Target(), metavar="FILE|FOLDER|URL")
@click.option(
    "--headers-only",
    is_flag=True,
    help="For a URL: check the answers of the server without fetching the whole scene.",
)
@click.option(
    "--hosts",
    metavar="NAME,…",
    help=f"For a URL: say what to change on these hosts: {', '.join(HOSTS)}.  [default: the host "
    "that answers, or all if it is unknown]",
)
@click.option("--strict", is_flag=True, help="For a URL: exit with 3 for warnings as well.")
@partial_option
@limits_option
@quiet_option
@json_option
def check(
    target: Path | str,
    headers_only: bool,
    hosts: str | None,
    strict: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Check a COGS file or folder, and the host of a URL.

    All segments are read, hashed, decoded and checked against SPEC.md. Every broken rule is listed
    with its reason code, its clause of SPEC.md and the byte offset. With --partial, a truncated
    file is no finding.

    For a URL, the host is checked first: byte ranges, compression, CORS, ETags, cache headers, and
    the seconds to the first chunk. Each finding has a code and says what to change.

    Exit status 3 if there are errors, 4 if a file cannot be read or a host cannot be reached.
    """
    chosen = _hosts(hosts)
    if isinstance(target, str):
        failed = _check_host(
            target, chosen, headers_only=headers_only, strict=strict, quiet=quiet, as_json=as_json
        )
    else:
        if headers_only:
            raise click.UsageError(f"{target}: is no URL, expected one with --headers-only")
        failed = _check_file(target, quiet=quiet, as_json=as_json)
    if failed:
        raise click.exceptions.Exit(_INVALID_STATUS)


def _hosts(text: str | None) -> list[str] | None:
    """Parse and check names of hosts, separated by commas; None for no option."""
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in HOSTS:
            raise click.BadParameter(f"{name!r}, expected some of {', '.join(HOSTS)}")
    return names


def _check_file(path: Path, *, quiet: bool, as_json: bool) -> bool:
    """Print the rules that a file or folder breaks; return whether it breaks any."""
    with Stages(shown=not (quiet or as_json)) as stages:
        found = _file_findings(path, stages)
    name = display_name(path)
    if as_json:
        print_json({"source": name, "valid": not found, **_findings_report(found)})
    else:
        _print_findings(found, name, quiet=quiet)
    return bool(found)


def _file_findings(path: Path, stages: Stages) -> list[Finding]:
    """Return the rules that a file or folder breaks, within the limits of the command.

    Raises
    ------
    StorageError
        The file cannot be read.
    """
    try:
        source = open_source(path)
    except StorageError:
        raise
    except CogsplatError as error:
        # The manifest of a folder is read first and may be broken itself.
        return [finding_of(error)]
    try:
        return findings(
            source, partial=partial_accepted(), limits=current_limits(), progress=stages
        )
    finally:
        source.close()


def _check_host(
    url: str,
    hosts: Sequence[str] | None,
    *,
    headers_only: bool,
    strict: bool,
    quiet: bool,
    as_json: bool,
) -> bool:
    """Print the findings about a host and its scene; return whether the command fails."""
    with Stages(shown=not (quiet or as_json)) as stages:
        found = diagnose(url, content=not headers_only, limits=current_limits(), progress=stages)
    changes = _changes(found, hosts)
    if as_json:
        print_json(_host_report(found, changes))
    else:
        _print_host(found, changes, quiet=quiet)
    failing = (ERROR, WARNING) if strict else (ERROR,)
    return bool(found.content) or any(finding.severity in failing for finding in found.host)


def _changes(found: Diagnosis, hosts: Sequence[str] | None) -> dict[str, dict[str, str]]:
    """Return the remedies of the findings by code, then by host.

    Without `hosts`, the host of the server is taken, or every known host if it is unknown.
    """
    own = host_of(found.server)
    return remedies(
        [finding.code for finding in found.host], hosts or ([own] if own else list(HOSTS))
    )


def _host_report(found: Diagnosis, changes: dict[str, dict[str, str]]) -> dict[str, object]:
    """Return the JSON object about a URL: its findings and remedies.

    `changes` has the remedies by finding code, then by host; see `_changes`.
    """
    return {
        "source": found.url,
        "folder": found.folder,
        "server": found.server,
        "http_version": found.version,
        "first_byte_s": round(found.first_byte_s, 4),
        "first_chunk_s": None if found.first_chunk_s is None else round(found.first_chunk_s, 4),
        "host_findings": [asdict(finding) for finding in found.host],
        "remedies": [
            {"code": code, "host": host, "remedy": change}
            for code, by_host in changes.items()
            for host, change in by_host.items()
        ],
        "content_read": found.content_read,
        "valid": found.content_read and not found.content,
        **_findings_report(found.content),
    }


def _findings_report(found: list[Finding]) -> dict[str, object]:
    """Return the part of the JSON object about the scene."""
    return {"findings": [asdict(finding) for finding in found]}


def _print_host(found: Diagnosis, changes: dict[str, dict[str, str]], *, quiet: bool) -> None:
    """Print facts about a host, the findings about it, and the findings in the scene."""
    if not quiet:
        print_line(f"{found.url}: {'a folder' if found.folder else 'a file'}")
        seconds = found.first_chunk_s
        print_facts(
            ("server", found.server or "not named"),
            ("protocol", found.version),
            ("first byte", f"{found.first_byte_s:.3f} s"),
            ("first chunk", "" if seconds is None else f"{seconds:.2f} s, on a new connection"),
        )
    for severity in SEVERITIES:
        for finding in found.host:
            if finding.severity == severity and not (quiet and severity == NOTE):
                _print_host_finding(finding, changes.get(finding.code, {}))
    if found.content_read or found.content:
        _print_findings(found.content, found.url, quiet=quiet)
    elif not quiet:
        print_line(f"{found.url}: the scene was not read")


def _print_host_finding(finding: HostFinding, changes: dict[str, str]) -> None:
    """Print one finding about a host and what to change."""
    print_line(f"{finding.severity:<8} {finding.code}")
    print_line(f"    {finding.message}")
    for host, change in changes.items():
        print_line(f"    {HOSTS[host]}: {change}")


def _print_findings(found: list[Finding], name: str, *, quiet: bool) -> None:
    """Print the rules that a scene breaks."""
    for finding in found:
        where = "" if finding.offset is None else f" at byte {finding.offset:,}"
        clause = f"SPEC {finding.clause}" if finding.clause else "SPEC"
        print_line(f"{ERROR:<8} {finding.code:<24} {clause:<10}{where}")
        print_line(f"    {finding.message}")
    if found:
        print_line(f"{name}: {count_text(len(found), 'finding')} in the scene")
    elif not quiet:
        what = "the chunks that are there conform" if partial_accepted() else "conforms"
        print_line(f"{name}: {what} to SPEC.md")
