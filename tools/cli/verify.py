"""``cogsplat verify``: whether a host serves a scene well, and whether the scene is whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Final

import click

from cogsplat.formats.cogs.verification import Finding
from cogsplat.formats.network.urls import HTTP_SCHEMES, scheme_of
from cogsplat.tools.hosting.doctor import Diagnosis, examine
from cogsplat.tools.hosting.remedies import HOSTS, host_of, remedies
from cogsplat.tools.hosting.rules import ERROR, NOTE, SEVERITIES, WARNING, HostFinding
from cogsplat.tools.terminal.limits import current_limits, limits_option
from cogsplat.tools.terminal.options import json_option, quiet_option
from cogsplat.tools.terminal.output import counted, facts, say, say_json
from cogsplat.tools.terminal.partial import partial_option
from cogsplat.tools.terminal.progress import Stages

from .validate import file_findings

_INVALID: Final = 3


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat verify https://example.org/scene.cogs\n"
    "  cogsplat verify https://example.org/scene/ --hosts nginx,caddy\n"
    "  cogsplat verify scene.cogs"
)
@click.argument("target", metavar="URL|FILE|FOLDER")
@click.option(
    "--headers-only",
    is_flag=True,
    help="Of a URL, look at what the server answers, without fetching all of the scene.",
)
@click.option(
    "--hosts",
    metavar="NAME,…",
    help=f"Say what to change on these: {', '.join(HOSTS)}. By default on the one that answers, "
    "or on all where it is not known.",
)
@click.option("--strict", is_flag=True, help="Exit with 3 for warnings too.")
@partial_option
@limits_option
@quiet_option
@json_option
def verify(
    target: str, headers_only: bool, hosts: str | None, strict: bool, quiet: bool, as_json: bool
) -> None:
    """Check how a host serves a scene, and the scene itself.

    Of a URL: whether ranges are honoured, nothing compresses on the way, pages of other origins
    may read it and its headers, ETags are strong, caches are told what to keep, and how long the
    first chunk takes; then all of the scene against SPEC.md, as `validate` checks a file. Each
    finding has a code and says what to change. Exit status 3 where there are errors, 4 where the
    host cannot be reached.
    """
    wanted = _hosts(hosts)
    if scheme_of(target) in HTTP_SCHEMES:
        with Stages(shown=not (quiet or as_json)) as stages:
            found = examine(
                target, content=not headers_only, limits=current_limits(), progress=stages
            )
        changes = _changes(found, wanted)
        if as_json:
            say_json(_report(found, changes))
        else:
            _tell(found, changes, quiet=quiet)
        failing = (ERROR, WARNING) if strict else (ERROR,)
        bad = bool(found.content) or any(x.severity in failing for x in found.host)
    else:
        if headers_only:
            raise click.UsageError(f"{target}: is no URL, expected one with --headers-only")
        with Stages(shown=not (quiet or as_json)) as stages:
            content = file_findings(Path(target), stages)
        if as_json:
            say_json({"source": target, "valid": not content, **_content(content)})
        else:
            _tell_content(content, target, quiet=quiet)
        bad = bool(content)
    if bad:
        raise click.exceptions.Exit(_INVALID)


def _hosts(text: str | None) -> list[str] | None:
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in HOSTS:
            raise click.BadParameter(f"{name!r}, expected some of {', '.join(HOSTS)}")
    return names


def _changes(found: Diagnosis, wanted: Sequence[str] | None) -> dict[str, dict[str, str]]:
    own = host_of(found.server)
    hosts = wanted or ([own] if own else list(HOSTS))
    return remedies([finding.code for finding in found.host], hosts)


def _report(found: Diagnosis, changes: dict[str, dict[str, str]]) -> dict[str, object]:
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
        **_content(found.content),
    }


def _content(found: list[Finding]) -> dict[str, object]:
    return {"findings": [asdict(finding) for finding in found]}


def _tell(found: Diagnosis, changes: dict[str, dict[str, str]], *, quiet: bool) -> None:
    if not quiet:
        say(f"{found.url}: {'a folder' if found.folder else 'a file'}")
        chunk = f"{found.first_chunk_s:.2f} s" if found.first_chunk_s is not None else ""
        facts(
            ("server", found.server or "not named"),
            ("protocol", found.version),
            ("first byte", f"{found.first_byte_s:.3f} s"),
            ("first chunk", f"{chunk}, with a connection of its own" if chunk else ""),
        )
    for severity in SEVERITIES:
        for finding in found.host:
            if finding.severity == severity and not (quiet and severity == NOTE):
                _tell_host(finding, changes.get(finding.code, {}))
    if found.content_read or found.content:
        _tell_content(found.content, found.url, quiet=quiet)
    elif not quiet:
        say(f"{found.url}: the scene was not read")


def _tell_host(finding: HostFinding, changes: dict[str, str]) -> None:
    say(f"{finding.severity:<8} {finding.code}")
    say(f"    {finding.message}")
    for host, change in changes.items():
        say(f"    {HOSTS[host]}: {change}")


def _tell_content(found: list[Finding], name: str, *, quiet: bool) -> None:
    for finding in found:
        clause = f" SPEC {finding.clause}" if finding.clause else ""
        say(f"error    {finding.code}{clause}")
        say(f"    {finding.message}")
    if found:
        say(f"{name}: {counted(len(found), 'finding')} in the scene")
    elif not quiet:
        say(f"{name}: conforms to SPEC.md")
