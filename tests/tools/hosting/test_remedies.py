"""Remedies exist for every finding that a configuration can fix."""

import re
from pathlib import Path

import pytest

from cogsplat.tools.hosting.remedies import HOSTS, REMEDIES, host_of, remedies

RULES = Path(__file__).resolve().parents[3] / "tools" / "hosting" / "rules.py"

# What is wrong with the file, its address or the server's program: no setting mends it.
WITHOUT = {"http-status", "http-range-wrong", "http-range-length", "http-length",
           "http-range-beyond", "http-redirect"}  # fmt: skip


def test_every_finding_has_a_remedy_or_none_is_known() -> None:
    codes = set(re.findall(r'"((?:http|cors|cache)-[a-z-]+)"', RULES.read_text(encoding="utf-8")))
    headers = {"cache-control"}
    assert codes - headers == REMEDIES.keys() | WITHOUT
    assert not REMEDIES.keys() & WITHOUT
    assert {host for by_host in REMEDIES.values() for host in by_host} == set(HOSTS)


@pytest.mark.parametrize(
    ("server", "host"),
    [("nginx/1.22.1", "nginx"), ("Caddy", "caddy"), ("AmazonS3", "s3"), ("cloudflare", "r2"),
     ("GitHub.com", "github-pages"), ("SimpleHTTP/0.6 Python/3.11", "http-server"),
     ("Apache", None), ("", None)],
)  # fmt: skip
def test_hosts_are_known_by_their_headers(server: str, host: str | None) -> None:
    assert host_of(server) == host


def test_remedies_of_the_given_codes_and_hosts() -> None:
    found = remedies(["http-status", "cors-origin", "cors-origin"], ["nginx"])
    assert list(found) == ["cors-origin"]
    assert list(found["cors-origin"]) == ["nginx"]
    assert remedies(["http-type"], ["http-server"]) == {}
