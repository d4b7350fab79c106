"""Rules for the HTTP responses of a host; each violation is a finding with a stable code."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final
from urllib.parse import urlsplit

from .probe import FIRST_BYTES, ORIGIN, ProbeResult, Response, content_range, total_of

ERROR: Final = "error"
WARNING: Final = "warning"
NOTE: Final = "note"
SEVERITIES: Final = (ERROR, WARNING, NOTE)

_EXPOSED: Final = ("content-range", "etag")

# Host names of the local machine, which browsers trust without HTTPS.
_LOOPBACK: Final = re.compile(r"localhost|127(\.\d{1,3}){3}|\[?::1\]?|.*\.localhost")

_YEAR: Final = 31_536_000
_DAY: Final = 86_400


@dataclass(frozen=True)
class HostFinding:
    """A rule that a host violates.

    Parameters
    ----------
    code : str
        Stable reason code, a key of `remedies.REMEDIES`.
    severity : str
        ``error``: some readers fail; ``warning``: reading is slower or fragile, or some pages
        cannot read; ``note``: a possible improvement.
    message : str
        The value found and the value expected.
    """

    code: str
    severity: str
    message: str


def file_findings(probed: ProbeResult, *, manifest: bool = False) -> Iterator[HostFinding]:
    """Check how a host serves a file, or the manifest of a folder.

    Parameters
    ----------
    probed : ProbeResult
        The host's responses to all probe requests.
    manifest : bool
        Whether the file is a manifest: readers fetch it whole, and new versions replace it.

    Yields
    ------
    HostFinding
        One for each violated rule.
    """
    first = probed.first
    yield from _connection(first, probed.url)
    if first.status not in (200, 206):
        yield HostFinding(
            "http-status", ERROR, f"status {first.status}, expected 206 for a range of bytes"
        )
        return
    yield from _ranges(probed, manifest=manifest)
    yield from _encodings(probed)
    yield from _validators(probed)
    yield from _cross_origin(first, probed.preflight)
    yield from _media_type(first)
    yield from _caching(first, immutable=False, manifest=manifest)


def object_findings(response: Response, name: str, size: int) -> Iterator[HostFinding]:
    """Check how a host serves an object of a folder.

    Parameters
    ----------
    response : Response
        Response to a request for the whole object that accepts compression.
    name : str
        Name of the object for messages.
    size : int
        Expected size of the object, bytes.

    Yields
    ------
    HostFinding
        One for each violated rule.
    """
    if response.status != 200:
        yield HostFinding("http-status", ERROR, f"{name}: status {response.status}, expected 200")
        return
    if response.encoding:
        yield HostFinding(
            "http-encoding-whole",
            WARNING,
            f"{name}: Content-Encoding {response.encoding}, expected none: the bytes are "
            "compressed already",
        )
    elif len(response.body) != size:
        yield HostFinding(
            "http-length", ERROR, f"{name}: {len(response.body)} bytes or more, expected {size}"
        )
    yield from _origin_allowed(response, f"{name}: ")
    yield from _media_type(response, f"{name}: ")
    yield from _caching(response, immutable=True, manifest=False, label=f"{name}: ")


def _connection(response: Response, url: str) -> Iterator[HostFinding]:
    """Check redirects, HTTPS and the HTTP version."""
    requested, final = urlsplit(url), urlsplit(response.url)
    if response.redirects:
        other_host = (requested.scheme, requested.netloc) != (final.scheme, final.netloc)
        yield HostFinding(
            "http-redirect",
            WARNING if other_host else NOTE,
            f"{len(response.redirects)} redirects, to {response.url}, expected none: each adds a "
            "round trip to every request",
        )
    if final.scheme == "http" and not _LOOPBACK.fullmatch(final.hostname or ""):
        yield HostFinding(
            "http-plain", WARNING, "HTTP, expected HTTPS: pages served over HTTPS cannot read it"
        )
    if final.scheme == "https" and response.version in ("HTTP/1.0", "HTTP/1.1"):
        yield HostFinding(
            "http-version",
            NOTE,
            f"{response.version}, expected HTTP/2: requests do not share a connection",
        )


def _ranges(probed: ProbeResult, *, manifest: bool) -> Iterator[HostFinding]:
    """Check the responses to range requests; for a manifest, ignored ranges are only a note."""
    first = probed.first
    if first.status == 200:
        yield HostFinding(
            "http-ranges-ignored",
            NOTE if manifest else ERROR,
            "status 200 and the whole file for a range, expected 206: single chunks cannot be "
            "fetched",
        )
        return
    found = content_range(first)
    if found is None or found[0] != 0 or found[1] != min(FIRST_BYTES, found[2]) - 1:
        stated = first.headers.get("content-range", "none")
        yield HostFinding(
            "http-range-wrong",
            ERROR,
            f"Content-Range {stated!r} for bytes 0 to {FIRST_BYTES - 1}, expected this range and "
            "the length of the file",
        )
        return
    if len(first.body) != found[1] + 1:
        yield HostFinding(
            "http-range-length",
            ERROR,
            f"{len(first.body)} bytes with a Content-Range of {found[1] + 1}, expected equal sizes",
        )
    last = probed.last
    if last is not None:
        start, end = probed.last_range
        if last.status != 206 or content_range(last) != (start, end, found[2]):
            yield HostFinding(
                "http-range-wrong",
                ERROR,
                f"status {last.status} and Content-Range "
                f"{last.headers.get('content-range', 'none')!r} for the last bytes, expected "
                f"206 and bytes {start}-{end}/{found[2]}",
            )
    if probed.beyond is not None and probed.beyond.status != 416:
        yield HostFinding(
            "http-range-beyond",
            NOTE,
            f"status {probed.beyond.status} for a range behind the end, expected 416: readers "
            "detect late that a file became shorter",
        )


def _encodings(probed: ProbeResult) -> Iterator[HostFinding]:
    """Check that no response is compressed."""
    if probed.first.encoding:
        yield HostFinding(
            "http-encoding-range",
            ERROR,
            f"Content-Encoding {probed.first.encoding} for a request that accepts none, expected "
            "the bytes of the file",
        )
    elif probed.compressed.encoding or (
        probed.first.status == 206 and probed.compressed.status == 200
    ):
        what = probed.compressed.encoding or "none"
        yield HostFinding(
            "http-encoding-range",
            ERROR,
            f"status {probed.compressed.status}, Content-Encoding {what} for a range request that "
            "accepts compression, expected 206 and none",
        )
    elif probed.whole.encoding:
        yield HostFinding(
            "http-encoding-whole",
            WARNING,
            f"Content-Encoding {probed.whole.encoding} for the whole file, expected none: the "
            "bytes are compressed already",
        )


def _validators(probed: ProbeResult) -> Iterator[HostFinding]:
    """Check that the ETag exists, is strong and is the same for the first and the last bytes."""
    etag = probed.first.etag
    if not etag:
        yield HostFinding(
            "http-etag-missing",
            WARNING,
            "no ETag, expected a strong one: only checksums detect a file that is replaced while "
            "it is read",
        )
        return
    if etag.startswith("W/"):
        yield HostFinding(
            "http-etag-weak", WARNING, f"ETag {etag}, expected a strong one, without W/"
        )
    if probed.last is not None and probed.last.status == 206 and probed.last.etag != etag:
        yield HostFinding(
            "http-etag-changes",
            ERROR,
            f"ETag {etag}, then {probed.last.etag or 'none'} of the same file, expected one ETag: "
            "readers reject a file that seems to change",
        )


def _origin_allowed(response: Response, label: str = "") -> Iterator[HostFinding]:
    """Check that pages of all origins may read a response; `label` begins each message."""
    allowed = response.headers.get("access-control-allow-origin", "").strip()
    if allowed not in ("*", ORIGIN):
        yield HostFinding(
            "cors-origin",
            WARNING,
            f"{label}Access-Control-Allow-Origin {allowed or 'none'} for {ORIGIN}, expected *: "
            "pages of other origins cannot read it",
        )


def _cross_origin(first: Response, preflight: Response) -> Iterator[HostFinding]:
    """Check by CORS that pages of another origin can read the file and headers, and send Range."""
    missing = list(_origin_allowed(first))
    yield from missing
    if missing:
        return
    stated = first.headers.get("access-control-expose-headers", "").lower()
    exposed = {name.strip() for name in stated.split(",")}
    hidden = [name for name in _EXPOSED if name not in exposed and "*" not in exposed]
    if hidden:
        yield HostFinding(
            "cors-expose",
            WARNING,
            f"Access-Control-Expose-Headers lacks {', '.join(hidden)}, expected Content-Range and "
            "ETag: pages of other origins cannot check their responses",
        )
    allowed = preflight.headers.get("access-control-allow-headers", "").lower()
    allowed_names = {name.strip() for name in allowed.split(",")}
    if preflight.status not in (200, 204) or not {"range", "*"} & allowed_names:
        yield HostFinding(
            "cors-preflight",
            NOTE,
            f"status {preflight.status}, Access-Control-Allow-Headers {allowed or 'none'} for "
            "OPTIONS, expected 204 and Range: browsers before 2022 send it before each range "
            "request",
        )


def _media_type(response: Response, label: str = "") -> Iterator[HostFinding]:
    """Check that a Content-Type is sent and is no text type, since servers compress text.

    `label` begins each message.
    """
    found = response.media_type
    if found.startswith("text/") or found in ("application/json", "application/javascript"):
        yield HostFinding(
            "http-type",
            WARNING,
            f"{label}Content-Type {found}, expected application/octet-stream: servers and "
            "proxies compress text",
        )
    elif not found:
        yield HostFinding(
            "http-type", NOTE, f"{label}no Content-Type, expected application/octet-stream"
        )


def _caching(
    response: Response, *, immutable: bool, manifest: bool, label: str = ""
) -> Iterator[HostFinding]:
    """Check Cache-Control; `immutable` is for objects, whose names are hashes of their content."""
    stated = response.headers.get("cache-control", "").lower()
    rules = {rule.strip() for rule in stated.split(",") if rule.strip()}
    age = next((int(r[8:20]) for r in rules if re.fullmatch(r"max-age=\d+", r)), None)
    if "no-store" in rules:
        yield HostFinding(
            "cache-none", WARNING, f"{label}Cache-Control {stated}, expected one without no-store"
        )
    elif immutable and ("immutable" not in rules or (age or 0) < _YEAR):
        yield HostFinding(
            "cache-immutable",
            WARNING if age is None else NOTE,
            f"{label}Cache-Control {stated or 'none'}, expected public, max-age={_YEAR}, "
            "immutable: an object named by the hash of its content never changes",
        )
    elif manifest and ("immutable" in rules or (age or 0) > _DAY):
        yield HostFinding(
            "cache-manifest",
            WARNING,
            f"Cache-Control {stated} of the manifest, expected no-cache: clients would miss new "
            "versions of the scene",
        )
    elif not rules and not immutable:
        yield HostFinding(
            "cache-missing",
            NOTE,
            "no Cache-Control, expected no-cache, or a long max-age if the name is never reused: "
            "browsers guess how long to keep the file",
        )


def length_findings(probed: ProbeResult, file_length: int) -> Iterator[HostFinding]:
    """Check the length in Content-Range against the length stated in the file (SPEC 3.1)."""
    total = total_of(probed.first)
    if total is not None and total != file_length:
        yield HostFinding(
            "http-length",
            ERROR,
            f"{total} bytes in the Content-Range, expected {file_length}, the length in the file",
        )
