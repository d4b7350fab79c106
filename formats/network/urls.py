"""URLs of files on a network: their schemes, and a form without secrets for messages."""

from __future__ import annotations

from typing import Final
from urllib.parse import SplitResult, urlsplit

from cogsplat.codec.errors import StorageError

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
    # Not split by urlsplit, which refuses malformed URLs.
    shown = url.partition("?")[0].partition("#")[0]
    scheme, slashes, rest = shown.partition("://")
    if not slashes:
        return shown
    host, slash, path = rest.partition("/")
    return f"{scheme}{slashes}{host.rpartition('@')[2]}{slash}{path}"


def split_url(url: str) -> SplitResult:
    """Split a URL into its parts.

    Raises
    ------
    StorageError
        ``bad-url``: control characters, lone surrogates, no host, or a malformed host or port.

    Examples
    --------
    >>> from cogsplat.formats.network.urls import split_url
    >>> split_url("https://example.org/a.cogs?v=1").path
    '/a.cogs'
    """
    try:
        # urlsplit drops line breaks and tabs, and leaves other control characters.
        url.encode()
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise bad_url(url, str(error)) from error
    if any(ord(character) < 32 or character == "\x7f" for character in url):
        raise bad_url(url, "a control character")
    if not parts.hostname or port == 0:
        raise bad_url(url, "no host" if port is None else f"port {port}")
    return parts


def bad_url(url: str, fault: str) -> StorageError:
    """Return the error ``bad-url`` for a malformed URL."""
    return StorageError("bad-url", f"{redacted(url)}: {fault}, expected a well-formed URL")
