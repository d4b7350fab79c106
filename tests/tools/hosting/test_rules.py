"""Findings about hosts, from answers that are made up."""

from dataclasses import replace

import pytest

from cogsplat.tools.hosting.probe import FIRST_BYTES, ORIGIN, ProbeResult, Response
from cogsplat.tools.hosting.rules import (
    ERROR,
    NOTE,
    WARNING,
    HostFinding,
    file_findings,
    length_findings,
    object_findings,
)

SIZE = 200_000
URL = "http://localhost/scene.cogs"
HEADERS = {
    "content-type": "application/octet-stream",
    "etag": '"a"',
    "cache-control": "no-cache",
    "access-control-allow-origin": "*",
    "access-control-expose-headers": "Content-Range, ETag",
}


def answer(status: int = 206, first: int = 0, end: int = FIRST_BYTES, **changes: str) -> Response:
    headers = HEADERS | {"content-range": f"bytes {first}-{end - 1}/{SIZE}"}
    headers |= {name.replace("_", "-"): value for name, value in changes.items()}
    return Response(URL, status, "HTTP/1.1", headers, bytes(end - first), 0.01)


def probed(**changes: Response) -> ProbeResult:
    right = ProbeResult(
        url=URL,
        first=answer(),
        compressed=answer(),
        whole=answer(200),
        last=answer(first=SIZE - 16, end=SIZE),
        beyond=answer(416),
        preflight=answer(204, access_control_allow_headers="range"),
        last_range=(SIZE - 16, SIZE - 1),
    )
    return replace(right, **changes)


def found(given: ProbeResult, *, manifest: bool = False) -> dict[str, str]:
    return {x.code: x.severity for x in file_findings(given, manifest=manifest)}


def test_a_correct_host_has_no_findings() -> None:
    assert found(probed()) == {}
    assert list(length_findings(probed(), SIZE)) == []


def without(name: str) -> Response:
    headers = {key: value for key, value in answer().headers.items() if key != name}
    return replace(answer(), headers=headers)


FIRST = {
    "status": (answer(404), "http-status", ERROR),
    "ranges": (answer(200), "http-ranges-ignored", ERROR),
    "range": (answer(content_range="bytes 1-65536/200000"), "http-range-wrong", ERROR),
    "no range": (without("content-range"), "http-range-wrong", ERROR),
    "unit": (answer(content_range="lines 0-65535/200000"), "http-range-wrong", ERROR),
    "short": (replace(answer(), body=b"x"), "http-range-length", ERROR),
    "gzip": (answer(content_encoding="gzip"), "http-encoding-range", ERROR),
    "no etag": (without("etag"), "http-etag-missing", WARNING),
    "weak": (answer(etag='W/"a"'), "http-etag-weak", WARNING),
    "changes": (answer(etag='"b"'), "http-etag-changes", ERROR),
    "origin": (without("access-control-allow-origin"), "cors-origin", WARNING),
    "exposed": (answer(access_control_expose_headers="ETag"), "cors-expose", WARNING),
    "type": (answer(content_type="text/plain; charset=utf-8"), "http-type", WARNING),
    "no type": (without("content-type"), "http-type", NOTE),
    "no cache": (without("cache-control"), "cache-missing", NOTE),
    "no store": (answer(cache_control="no-store"), "cache-none", WARNING),
    "redirect": (replace(answer(), redirects=(URL,)), "http-redirect", NOTE),
    "elsewhere": (
        replace(answer(), redirects=(URL,), url="http://127.0.0.1/a"), "http-redirect", WARNING
    ),
    "plain": (replace(answer(), url="http://example.org/a"), "http-plain", WARNING),
    "old": (replace(answer(), url="https://localhost/a"), "http-version", NOTE),
}  # fmt: skip


@pytest.mark.parametrize("name", FIRST)
def test_each_fault_of_a_first_answer_has_its_finding(name: str) -> None:
    first, code, severity = FIRST[name]
    assert found(probed(first=first))[code] == severity


def test_faults_of_other_answers() -> None:
    gzip = answer(200, content_encoding="gzip")
    assert found(probed(compressed=gzip, whole=gzip)) == {"http-encoding-range": ERROR}
    assert found(probed(whole=gzip)) == {"http-encoding-whole": WARNING}
    assert found(probed(last=answer())) == {"http-range-wrong": ERROR}
    assert found(probed(beyond=answer(200))) == {"http-range-beyond": NOTE}
    assert found(probed(preflight=answer(405))) == {"cors-preflight": NOTE}
    own = answer(access_control_allow_origin=ORIGIN, access_control_expose_headers="*")
    assert found(probed(first=own)) == {}
    (wrong,) = length_findings(probed(), SIZE + 1)
    assert (wrong.code, wrong.severity) == ("http-length", ERROR)


def test_manifests_may_do_without_ranges_and_may_not_be_kept() -> None:
    whole = Response(URL, 200, "HTTP/2", HEADERS, b"x", 0.0)
    bare = probed(first=whole, compressed=whole, last=None, beyond=None)  # type: ignore[arg-type]
    assert found(bare, manifest=True) == {"http-ranges-ignored": NOTE}
    kept = answer(cache_control="public, max-age=31536000, immutable")
    assert found(probed(first=kept), manifest=True) == {"cache-manifest": WARNING}
    assert found(probed(first=kept)) == {}


def test_objects_of_folders() -> None:
    right = answer(200, end=10, cache_control="public, max-age=31536000, immutable")

    def codes(given: Response) -> list[HostFinding]:
        return list(object_findings(given, "segments/a.bin", 10))

    assert codes(right) == []
    for given, code in (
        (replace(right, status=404), "http-status"),
        (replace(right, body=bytes(11)), "http-length"),
        (answer(200, end=10), "cache-immutable"),
        (replace(right, headers=right.headers | {"content-encoding": "br"}), "http-encoding-whole"),
    ):
        (wrong,) = codes(given)
        assert wrong.code == code
        assert "segments/a.bin" in wrong.message
