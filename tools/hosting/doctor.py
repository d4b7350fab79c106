"""Diagnosis of a published scene: how its host serves it, and whether its content is valid."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Final

from cogsplat.codec.errors import CogsplatError, StorageError
from cogsplat.codec.progress import Progress, silent
from cogsplat.formats.cogs.findings import Finding, finding_of, findings
from cogsplat.formats.cogs.folder_map import MANIFEST_NAME, FolderMap, is_manifest
from cogsplat.formats.cogs.layout import PREAMBLE_BYTES, unpack_preamble
from cogsplat.formats.cogs.open_file import manifest_address, open_source
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.storage.limits import Limits

from .probe import Prober, ProbeResult
from .rules import HostFinding, file_findings, length_findings, object_findings

# Objects of a folder whose headers are checked; a host serves all objects alike.
_CHECKED_OBJECTS: Final = 1

# Larger objects are not fetched for their headers, because a manifest may state any size.
_MAX_CHECKED_BYTES: Final = 64 << 20


@dataclass(frozen=True)
class Diagnosis:
    """Findings about the scene at one address.

    Parameters
    ----------
    url : str
        Address of the file, or of a folder's manifest.
    folder : bool
        Whether the scene is a folder of a manifest and objects.
    server : str
        The Server header, empty if there is none.
    version : str
        ``HTTP/1.1`` or ``HTTP/2``.
    first_byte_s : float
        Seconds from connecting to the first response.
    first_chunk_s : float or None
        Seconds from connecting to the first decoded chunk; None if decoding failed or there are
        no chunks.
    host : list of HostFinding
        Violated rules of hosting.
    content : list of Finding
        Violated rules of SPEC.
    content_read : bool
        Whether the whole scene was fetched and checked.
    """

    url: str
    folder: bool
    server: str
    version: str
    first_byte_s: float
    first_chunk_s: float | None = None
    host: list[HostFinding] = field(default_factory=list)
    content: list[Finding] = field(default_factory=list)
    content_read: bool = False


def diagnose(
    url: str,
    *,
    content: bool = True,
    limits: Limits | None = None,
    progress: Progress = silent,
    prober: Prober | None = None,
) -> Diagnosis:
    """Diagnose a published scene: probe its host, decode a chunk, and validate the content.

    Parameters
    ----------
    url : str
        Address of a file, of a manifest, or of a folder with a slash at its end.
    content : bool
        Whether to fetch the whole scene and check it against SPEC.
    limits : Limits, optional
        Limits on splats and decoded bytes.
    progress : Progress
        Called with ``("validate", checks done, checks)``.
    prober : Prober, optional
        Client for the probe requests, closed by this function; a new one by default.

    Returns
    -------
    Diagnosis
        Findings, each code once.

    Raises
    ------
    StorageError
        ``host-unreachable``, ``network-timeout``, ``connection-broken``, ``redirect-loop``.
    """
    address = manifest_address(url)
    with prober or Prober() as client:
        probed = client.probe(address)
        head = probed.first.body
        folder = is_manifest(head) or address.endswith(MANIFEST_NAME)
        host = list(file_findings(probed, manifest=folder))
        content_findings: list[Finding] = []
        readable = False
        if probed.first.status in (200, 206) and not probed.first.encoding:
            try:
                host += _length_and_object_findings(client, probed, folder=folder)
                readable = True
            except StorageError:
                raise
            except CogsplatError as error:
                content_findings.append(finding_of(error))
    first_chunk_s = None
    if readable:
        first_chunk_s = _first_chunk_seconds(address, limits)
        if content:
            content_findings += _content_findings(address, limits, progress)
    return Diagnosis(
        url=address,
        folder=folder,
        server=probed.first.headers.get("server", ""),
        version=probed.first.version,
        first_byte_s=probed.first.first_byte_s,
        first_chunk_s=first_chunk_s,
        host=_one_per_code(host),
        content=content_findings,
        content_read=readable and content,
    )


def _length_and_object_findings(
    prober: Prober, probed: ProbeResult, *, folder: bool
) -> list[HostFinding]:
    """Check the length in the preamble or manifest, and how a folder's first object is served.

    Raises
    ------
    CogsplatError
        The preamble or the manifest violates SPEC.
    """
    head = probed.first.body
    if not folder:
        preamble = unpack_preamble(head[:PREAMBLE_BYTES], probed.url)
        return list(length_findings(probed, preamble.file_length))
    manifest = FolderMap(head, probed.url)
    found = list(length_findings(probed, manifest.manifest_bytes))
    start = manifest.root_end
    if start < manifest.file_length:
        pages = [manifest.page_range(page) for page in manifest.pages_for(start, 1)]
        for piece in (pages or manifest.object_ranges(start, 1))[:_CHECKED_OBJECTS]:
            if piece.name and piece.object_bytes <= _MAX_CHECKED_BYTES:
                size = piece.object_bytes
                response = prober.fetch_object(probed.first.url, piece.name, size + 1)
                found += object_findings(response, piece.name, size)
    return found


def _first_chunk_seconds(url: str, limits: Limits | None) -> float | None:
    """Return the seconds from connecting to the first decoded chunk.

    None if decoding fails or the file has no chunks.
    """
    start = time.perf_counter()
    try:
        source = open_source(url)
        try:
            file = open_cogs(source, limits=limits)
            if not file.num_chunks:
                return None
            file.decode([0], threads=1)
        finally:
            source.close()
    except CogsplatError:
        # `_content_findings` or the host's findings report the cause.
        return None
    return time.perf_counter() - start


def _content_findings(url: str, limits: Limits | None, progress: Progress) -> list[Finding]:
    """Fetch the whole scene and return the violated rules of SPEC, or a network error."""
    try:
        source = open_source(url)
    except StorageError as error:
        return [Finding(error.code, "network", "", None, error.message)]
    except CogsplatError as error:
        return [finding_of(error)]
    try:
        return findings(source, limits=limits, progress=progress)
    except StorageError as error:
        return [Finding(error.code, "network", "", None, error.message)]
    finally:
        source.close()


def _one_per_code(found: list[HostFinding]) -> list[HostFinding]:
    """Return the first finding of each code."""
    kept: dict[str, HostFinding] = {}
    for finding in found:
        kept.setdefault(finding.code, finding)
    return list(kept.values())
