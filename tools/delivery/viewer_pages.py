"""HTML pages with the viewer of ``tools/web``, which fetch a scene or embed it."""

from __future__ import annotations

import base64
import hashlib
import html
import os
from collections.abc import Iterable
from importlib.resources import files
from typing import BinaryIO, Final
from urllib.parse import quote

from cogsplat.codec.errors import printable

SCENE_NAME: Final = "scene.cogs"
"""Name of the scene's file in the folder of a page."""

PAGE_NAME: Final = "index.html"
"""Name of the page, which web servers use for its folder."""

# Parts of viewer.html to replace; a test checks that each occurs once.
_VIEWER_TAG: Final = '<cogsplat-viewer id="page">'
_TITLE: Final = "<title>COGS viewer</title>"
_STYLE_TAG: Final = '<link rel="stylesheet" href="viewer.css" />'
_SCRIPT_TAG: Final = '<script type="module" src="viewer.js"></script>'
_POLICY: Final = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; "
    "worker-src 'self'; connect-src 'self' https:"
)

# Files that viewer.html loads, and what the viewer loads when it is asked for; worker scripts last.
_WORKERS: Final = ("worker.js", "viewer_worker.js")
_EXTRAS: Final = "viewer_extras.js"
_LINKED_FILES: Final = ("viewer.css", "viewer.js", _EXTRAS, *_WORKERS)

# An embedded scene is split into blocks, because browsers limit a text node to half a GiB. The size
# is a multiple of 3 bytes, so that only the last block's base64 has padding.
BLOCK_BYTES: Final = 3 << 20


def linked_page(
    title: str,
    scene: str = SCENE_NAME,
    against: str | None = None,
    against_title: str | None = None,
) -> dict[str, bytes]:
    """Return the files of a viewer page that fetches a scene from its own folder.

    Parameters
    ----------
    title : str
        Title of the page, and label of the scene.
    scene : str
        Name of the scene's file in the page's folder: a ``.cogs``, or a PLY of 3DGS training.
    against : str, optional
        Name of a second scene's file, which the page compares with the first.
    against_title : str, optional
        Label of the second scene; by default its file's name.

    Returns
    -------
    dict of str to bytes
        Contents by file name, without the scene; the page, `PAGE_NAME`, is first. Links are
        relative, so that any static web server can serve the files.

    Examples
    --------
    >>> from cogsplat.tools.delivery.viewer_pages import linked_page
    >>> sorted(linked_page("Garden"))
    ['index.html', 'viewer.css', 'viewer.js', 'viewer_extras.js', 'viewer_worker.js', 'worker.js']
    """
    second = "" if against is None else f' against="{relative_url(against)}"'
    if against_title is not None:
        second += f' against-label="{html.escape(printable(against_title))}"'
    page = _titled(title, f' src="{relative_url(scene)}"{second}')
    return {PAGE_NAME: page.encode(), **{name: _viewer_file(name) for name in _LINKED_FILES}}


def relative_url(name: str) -> str:
    """Return the URL of a file relative to its folder, percent-encoded.

    Without the encoding ``https:example.org.cogs`` would be the URL of a host.

    Examples
    --------
    >>> from cogsplat.tools.delivery.viewer_pages import relative_url
    >>> relative_url("50% #1.cogs")
    '50%25%20%231.cogs'
    """
    return quote(os.fsencode(name))


def write_standalone_page(title: str, scene: Iterable[bytes], out: BinaryIO) -> None:
    """Write one HTML page with the viewer and the scene embedded, which needs no server.

    The page's content security policy allows its own scripts and style, by their hashes, and its
    embedded workers. It allows no connections. One of the scripts is the viewer's extras, a text
    that runs when it is asked for.

    Parameters
    ----------
    title : str
        Title of the page.
    scene : iterable of bytes
        The scene in blocks of `BLOCK_BYTES`; the last one may be shorter.
    out : binary file
        The output, UTF-8.
    """
    style, script = _viewer_file("viewer.css").decode(), _viewer_file("viewer.js").decode()
    extras = _viewer_file(_EXTRAS)
    policy = (
        f"default-src 'none'; script-src '{_hash(script)}' '{_hash(extras.decode())}' "
        f"'wasm-unsafe-eval'; style-src '{_hash(style)}'; worker-src blob:"
    )
    page = _replaced(_titled(title), _POLICY, policy)
    page = _replaced(page, _STYLE_TAG, f"<style>{style}</style>")
    before, after = page.split(_SCRIPT_TAG)
    out.write(before.encode())
    texts = [("extras", extras), *(("worker", _viewer_file(name)) for name in _WORKERS)]
    for kind, text in texts:
        if b"</script" in text.lower() or b"<!--" in text:
            raise RuntimeError(f"a program ({kind}) holds an end of a script, expected none")
        tag = f'<script type="application/x-cogs-{kind}">'.encode()
        out.write(tag + text + b"</script>\n    ")
    for block in scene:
        out.write(b'<script type="application/x-cogs-base64">')
        out.write(base64.b64encode(block))
        out.write(b"</script>\n    ")
    out.write(f'<script type="module">{script}</script>{after}'.encode())


def _titled(title: str, attributes: str = "") -> str:
    """Return viewer.html with a title, and with attributes of the viewer element."""
    page = _viewer_file("viewer.html").decode()
    # File names may contain characters that HTML forbids, e.g. lone surrogates.
    text = html.escape(printable(title))
    page = _replaced(page, _TITLE, f"<title>{text}</title>")
    tag = f'{_VIEWER_TAG[:-1]} label="{text}"{attributes}>'
    return _replaced(page, _VIEWER_TAG, tag)


def _viewer_file(name: str) -> bytes:
    """Return a file of the built viewer."""
    return files("cogsplat.tools").joinpath("web", "dist", name).read_bytes()


def _replaced(page: str, old: str, new: str) -> str:
    """Return a page with one text replaced, which must occur once."""
    if page.count(old) != 1:
        raise RuntimeError(f"viewer.html holds {old!r} {page.count(old)} times, expected once")
    return page.replace(old, new)


def _hash(text: str) -> str:
    """Return the hash that allows an inline script or style in a CSP (CSP 3, 2.3.1)."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
