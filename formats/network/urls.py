"""URLs of files on a network: their schemes, and a form without secrets for messages."""

from __future__ import annotations

from typing import Final
from urllib.parse import urlsplit

HTTP_SCHEMES: Final = ("http", "https")
STORE_SCHEMES: Final = ("s3", "gs", "az")


def scheme_of(text: str) -> str:
    """Return the scheme of a supported URL in lower case, or an empty string.

    Examples
    --------
    >>> from cogsplat.formats.network.urls import scheme_of
    >>> scheme_of("https://example.org/scene.cogs"), scheme_of("C:/scene.cogs")
    ('https', '')
    """
    scheme, found, rest = text.partition("://")
    known = scheme.lower() in (*HTTP_SCHEMES, *STORE_SCHEMES)
    return scheme.lower() if found and known and rest else ""


def is_url(place: object) -> bool:
    """Whether `place` is a string with a supported URL scheme."""
    return isinstance(place, str) and bool(scheme_of(place))


def redacted(url: str) -> str:
    """Return a URL without user, password and query, which may be secret.

    Examples
    --------
    >>> from cogsplat.formats.network.urls import redacted
    >>> redacted("https://me:secret@example.org/a.cogs?X-Amz-Signature=0123")
    'https://example.org/a.cogs'
    """
    parts = urlsplit(url)
    host = parts.netloc.rpartition("@")[2]
    return f"{parts.scheme}://{host}{parts.path}"
