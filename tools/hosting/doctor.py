"""Whether a host serves a scene as readers and browsers need it, and whether the scene is whole."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Final

from cogsplat.codec.errors import CogsplatError, StorageError
from cogsplat.codec.progress import Progress, silent
from cogsplat.formats.cogs.folder_map import MANIFEST_NAME, FolderMap, is_manifest
from cogsplat.formats.cogs.layout import PREAMBLE_BYTES, unpack_preamble
from cogsplat.formats.cogs.open_file import manifest_address, source_of_place
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.cogs.verification import Finding, finding_of, findings
from cogsplat.formats.storage.limits import Limits

from .probe import Probed, Prober
from .rules import HostFinding, file_findings, length_findings, object_findings

# Objects of a folder whose headers are looked at: all are served alike.
_OBJECTS: Final = 1


@dataclass(frozen=True)
class Diagnosis:
    """What was found about one address.

    Parameters
    ----------
    url : str
        Of the file, or of the manifest of a folder.
    folder : bool
    server : str
        What the server calls itself, empty where it does not.
    version : str
        ``HTTP/1.1`` or ``HTTP/2``.
    first_byte_s : float
        Seconds until the first answer began, the connection included.
    first_chunk_s : float or None
        Seconds until the first chunk was decoded, a new connection included; None where it was not.
    host : list of HostFinding
    content : list of Finding
        Broken rules of SPEC.
    content_read : bool
        Whether all of the scene was fetched and checked.
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


def examine(
    url: str,
    *,
    content: bool = True,
    limits: Limits | None = None,
    progress: Progress = silent,
    prober: Prober | None = None,
) -> Diagnosis:
    """Ask a host what readers and browsers will ask, and read the scene from it.

    Parameters
    ----------
    url : str
        Of a file, of a manifest, or of a folder, with a slash at its end.
    content : bool
        Whether all of the scene is fetched and checked against SPEC.
    limits : Limits, optional
    progress : Progress
        Called with ``("validate", checks done, checks)``.
    prober : Prober, optional

    Returns
    -------
    Diagnosis

    Raises
    ------
    StorageError
        ``host-unreachable``, ``network-timeout``, ``connection-broken``, ``redirect-loop``.
    """
    address = manifest_address(url)
    with prober or Prober() as asked:
        probed = asked.probe(address)
        head = probed.first.body
        folder = is_manifest(head) or address.endswith(MANIFEST_NAME)
        host = list(file_findings(probed, manifest=folder))
        wrong: list[Finding] = []
        readable = False
        if probed.first.status in (200, 206) and not probed.first.encoding:
            try:
                host += _of_content(asked, probed, folder=folder)
                readable = True
            except StorageError:
                raise
            except CogsplatError as error:
                wrong.append(finding_of(error))
    first_chunk_s = None
    if readable:
        first_chunk_s = _first_chunk_seconds(address, limits)
        if content:
            wrong += _broken_rules(address, limits, progress)
    return Diagnosis(
        url=address,
        folder=folder,
        server=probed.first.headers.get("server", ""),
        version=probed.first.version,
        first_byte_s=probed.first.first_byte_s,
        first_chunk_s=first_chunk_s,
        host=_once(host),
        content=wrong,
        content_read=readable and content,
    )


def _of_content(prober: Prober, probed: Probed, *, folder: bool) -> list[HostFinding]:
    """Return what is wrong with lengths, and with objects of a folder; raises what SPEC refuses."""
    head = probed.first.body
    if not folder:
        preamble = unpack_preamble(head[:PREAMBLE_BYTES], probed.url)
        return list(length_findings(probed, preamble.file_length))
    found = FolderMap(head, probed.url)
    wrong = list(length_findings(probed, found.manifest_bytes))
    start = found.root_end
    if start < found.file_length and not found.pages_for(start, 1):
        for piece in found.pieces(start, 1)[:_OBJECTS]:
            if piece.name:
                answer = prober.whole_object(probed.first.url, piece.name, piece.object_bytes + 1)
                wrong += object_findings(answer, piece.name, piece.object_bytes)
    return wrong


def _first_chunk_seconds(url: str, limits: Limits | None) -> float | None:
    """Return how long a reader takes from nothing to the first chunk, None where it fails."""
    start = time.perf_counter()
    try:
        source = source_of_place(url)
        try:
            file = open_cogs(source, limits=limits)
            if not file.num_chunks:
                return None
            file.decode([0], threads=1)
        finally:
            source.close()
    except CogsplatError:
        # Why it fails is a finding of `_broken_rules`, or of the headers.
        return None
    return time.perf_counter() - start


def _broken_rules(url: str, limits: Limits | None, progress: Progress) -> list[Finding]:
    try:
        source = source_of_place(url)
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


def _once(found: list[HostFinding]) -> list[HostFinding]:
    """Return the findings, of each code the first of the highest severity, in their order."""
    kept: dict[str, HostFinding] = {}
    for finding in found:
        kept.setdefault(finding.code, finding)
    return list(kept.values())
