"""What is right and wrong with the answers of a host, as findings with stable codes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final
from urllib.parse import urlsplit

from .probe import FIRST_BYTES, ORIGIN, Answer, Probed, content_range, total_of

ERROR: Final = "error"
WARNING: Final = "warning"
NOTE: Final = "note"
SEVERITIES: Final = (ERROR, WARNING, NOTE)

_EXPOSED: Final = ("content-range", "etag")

# Hosts of this machine, which browsers take for as safe as HTTPS.
_LOOPBACK: Final = re.compile(r"localhost|127(\.\d{1,3}){3}|\[?::1\]?|.*\.localhost")

_YEAR: Final = 31_536_000
_DAY: Final = 86_400


@dataclass(frozen=True)
class HostFinding:
    """One thing about a host that readers or browsers meet.

    Parameters
    ----------
    code : str
        Stable; `remedies.REMEDIES` says what to change.
    severity : str
        ``error``: some readers fail; ``warning``: slower, fragile, or closed to some pages;
        ``note``: could be better.
    message : str
        What was found, and what was expected.
    """

    code: str
    severity: str
    message: str


def file_findings(probed: Probed, *, manifest: bool = False) -> Iterator[HostFinding]:
    """Yield what is wrong with the way a file, or the manifest of a folder, is served.

    Parameters
    ----------
    probed : Probed
    manifest : bool
        A manifest is small and is replaced by new versions; readers need no ranges of it.
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


def object_findings(answer: Answer, name: str, size: int) -> Iterator[HostFinding]:
    """Yield what is wrong with the way an object of a folder is served.

    Parameters
    ----------
    answer : Answer
        To a request for all of it, by a client that takes compressed answers.
    name : str
    size : int
        Bytes that it should have.
    """
    if answer.status != 200:
        yield HostFinding("http-status", ERROR, f"{name}: status {answer.status}, expected 200")
        return
    if answer.encoding:
        yield HostFinding(
            "http-encoding-whole",
            WARNING,
            f"{name}: Content-Encoding {answer.encoding}, expected none: the bytes are compressed "
            "already",
        )
    elif len(answer.body) != size:
        yield HostFinding(
            "http-length", ERROR, f"{name}: {len(answer.body)} bytes or more, expected {size}"
        )
    yield from _origin_allowed(answer, f"{name}: ")
    yield from _media_type(answer, f"{name}: ")
    yield from _caching(answer, immutable=True, manifest=False, where=f"{name}: ")


def _connection(answer: Answer, asked: str) -> Iterator[HostFinding]:
    at, to = urlsplit(asked), urlsplit(answer.url)
    if answer.redirects:
        foreign = (at.scheme, at.netloc) != (to.scheme, to.netloc)
        yield HostFinding(
            "http-redirect",
            WARNING if foreign else NOTE,
            f"{len(answer.redirects)} redirects, to {answer.url}, expected none: each costs a "
            "round trip of every request",
        )
    if to.scheme == "http" and not _LOOPBACK.fullmatch(to.hostname or ""):
        yield HostFinding(
            "http-plain", WARNING, "no HTTPS: pages that come over HTTPS may not read it"
        )
    if to.scheme == "https" and answer.version in ("HTTP/1.0", "HTTP/1.1"):
        yield HostFinding(
            "http-version",
            NOTE,
            f"{answer.version}, expected HTTP/2: requests share no connection",
        )


def _ranges(probed: Probed, *, manifest: bool) -> Iterator[HostFinding]:
    first = probed.first
    if first.status == 200:
        yield HostFinding(
            "http-ranges-ignored",
            NOTE if manifest else ERROR,
            "status 200 and the whole file for a range, expected 206: chunks cannot be fetched by "
            "themselves",
        )
        return
    found = content_range(first)
    if found is None or found[0] != 0 or found[1] != min(FIRST_BYTES, found[2]) - 1:
        stated = first.headers.get("content-range", "none")
        yield HostFinding(
            "http-range-wrong",
            ERROR,
            f"Content-Range {stated!r} for bytes 0 to {FIRST_BYTES - 1}, expected those and the "
            "length of the file",
        )
        return
    if len(first.body) != found[1] + 1:
        yield HostFinding(
            "http-range-length",
            ERROR,
            f"{len(first.body)} bytes behind a Content-Range of {found[1] + 1}, expected as many",
        )
    last = probed.last
    if last is not None:
        start, end = probed.asked_last
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
            f"status {probed.beyond.status} for a range behind the end, expected 416: a file that "
            "became shorter shows late",
        )


def _encodings(probed: Probed) -> Iterator[HostFinding]:
    if probed.first.encoding:
        yield HostFinding(
            "http-encoding-range",
            ERROR,
            f"Content-Encoding {probed.first.encoding} though the request takes none, expected "
            "the bytes of the file",
        )
    elif probed.compressed.encoding or (
        probed.first.status == 206 and probed.compressed.status == 200
    ):
        what = probed.compressed.encoding or "none"
        yield HostFinding(
            "http-encoding-range",
            ERROR,
            f"status {probed.compressed.status}, Content-Encoding {what} for a range to a client "
            "that takes compressed answers, expected 206 and none: ranges are ignored for it",
        )
    elif probed.whole.encoding:
        yield HostFinding(
            "http-encoding-whole",
            WARNING,
            f"Content-Encoding {probed.whole.encoding} for the whole file, expected none: the "
            "bytes are compressed already",
        )


def _validators(probed: Probed) -> Iterator[HostFinding]:
    etag = probed.first.etag
    if not etag:
        yield HostFinding(
            "http-etag-missing",
            WARNING,
            "no ETag, expected a strong one: a file that is replaced while it is read is noticed "
            "by its checksums only",
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
            f"ETag {etag} and then {probed.last.etag or 'none'} of the same file, expected one: "
            "readers take the file for another",
        )


def _origin_allowed(answer: Answer, where: str = "") -> Iterator[HostFinding]:
    allowed = answer.headers.get("access-control-allow-origin", "").strip()
    if allowed not in ("*", ORIGIN):
        yield HostFinding(
            "cors-origin",
            WARNING,
            f"{where}Access-Control-Allow-Origin {allowed or 'none'} for {ORIGIN}, expected *: "
            "pages of other origins cannot read it",
        )


def _cross_origin(first: Answer, preflight: Answer) -> Iterator[HostFinding]:
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
            "ETag: pages of other origins cannot check what they get",
        )
    allowed = preflight.headers.get("access-control-allow-headers", "").lower()
    asked = {name.strip() for name in allowed.split(",")}
    if preflight.status not in (200, 204) or not {"range", "*"} & asked:
        yield HostFinding(
            "cors-preflight",
            NOTE,
            f"status {preflight.status}, Access-Control-Allow-Headers {allowed or 'none'} for "
            "OPTIONS, expected 204 and Range: browsers of before 2022 ask before each range",
        )


def _media_type(answer: Answer, where: str = "") -> Iterator[HostFinding]:
    found = answer.media_type
    if found.startswith("text/") or found in ("application/json", "application/javascript"):
        yield HostFinding(
            "http-type",
            WARNING,
            f"{where}Content-Type {found}, expected application/octet-stream: servers and "
            "proxies compress text",
        )
    elif not found:
        yield HostFinding(
            "http-type", NOTE, f"{where}no Content-Type, expected application/octet-stream"
        )


def _caching(
    answer: Answer, *, immutable: bool, manifest: bool, where: str = ""
) -> Iterator[HostFinding]:
    stated = answer.headers.get("cache-control", "").lower()
    rules = {rule.strip() for rule in stated.split(",") if rule.strip()}
    age = next((int(r[8:20]) for r in rules if re.fullmatch(r"max-age=\d+", r)), None)
    if "no-store" in rules:
        yield HostFinding(
            "cache-none", WARNING, f"{where}Cache-Control {stated}, expected to be cached"
        )
    elif immutable and ("immutable" not in rules or (age or 0) < _YEAR):
        yield HostFinding(
            "cache-immutable",
            WARNING if age is None else NOTE,
            f"{where}Cache-Control {stated or 'none'}, expected public, max-age={_YEAR}, "
            "immutable: what is named by its content never changes",
        )
    elif manifest and ("immutable" in rules or (age or 0) > _DAY):
        yield HostFinding(
            "cache-manifest",
            WARNING,
            f"Cache-Control {stated} of the manifest, expected no-cache: new versions of the scene "
            "stay unseen",
        )
    elif not rules and not immutable:
        yield HostFinding(
            "cache-missing",
            NOTE,
            "no Cache-Control, expected no-cache, or a long max-age for a name that is never used "
            "again: browsers guess how long they keep the file",
        )


def length_findings(probed: Probed, file_length: int) -> Iterator[HostFinding]:
    """Yield what is wrong with the length that a server states of a file (SPEC 3.1)."""
    total = total_of(probed.first)
    if total is not None and total != file_length:
        yield HostFinding(
            "http-length",
            ERROR,
            f"{total} bytes by the Content-Range, expected {file_length}, as the file states",
        )
