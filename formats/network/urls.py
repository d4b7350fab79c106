"""Which texts are addresses of files on a network, and how they are shown in messages."""

from __future__ import annotations

from typing import Final
from urllib.parse import urlsplit

HTTP_SCHEMES: Final = ("http", "https")
STORE_SCHEMES: Final = ("s3", "gs", "az")


def scheme_of(text: str) -> str:
    """Return the scheme of an address that can be read, empty where the text is none.

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
    """Whether something is the address of a file on a network."""
    return isinstance(place, str) and bool(scheme_of(place))


def shown(url: str) -> str:
    """Return an address without what may be secret: user, password and query.

    Examples
    --------
    >>> from cogsplat.formats.network.urls import shown
    >>> shown("https://me:secret@example.org/a.cogs?X-Amz-Signature=0123")
    'https://example.org/a.cogs'
    """
    parts = urlsplit(url)
    host = parts.netloc.rpartition("@")[2]
    return f"{parts.scheme}://{host}{parts.path}"
