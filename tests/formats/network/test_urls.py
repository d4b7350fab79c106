from pathlib import Path

import pytest

from cogsplat.formats.network.urls import is_url, redacted, scheme_of


@pytest.mark.parametrize("url", ["https://a.b/c.cogs", "HTTP://a", "s3://bucket/key", "gs://b/k"])
def test_addresses(url):
    assert is_url(url)
    assert scheme_of(url) == url.partition(":")[0].lower()


@pytest.mark.parametrize(
    "place", ["scene.cogs", "C:/a", "C://a", "https:/a", "https://", "file:///a", "", b"http://a"]
)
def test_paths(place):
    assert not is_url(place)


def test_a_path_object_is_no_address():
    assert not is_url(Path("https://a.b/c.cogs"))


def test_secrets_are_not_shown():
    assert redacted("https://u:p@a.b:8080/c.cogs?sig=1#x") == "https://a.b:8080/c.cogs"
