"""Pages that show a scene: the viewer of ``tools/web``, with the scene beside it or inside it."""

from __future__ import annotations

import base64
import hashlib
import html
from collections.abc import Iterator
from importlib.resources import files
from typing import BinaryIO, Final

from cogsplat.codec.errors import printable

SCENE_NAME: Final = "scene.cogs"
"""Name of the scene's file beside a page."""

PAGE_NAME: Final = "index.html"
"""Name of the page that web servers answer with for its folder."""

# What viewer.html is made of: each stands in it once, which a test checks.
_VIEWER_TAG: Final = '<cogsplat-viewer id="page">'
_TITLE: Final = "<title>COGS viewer</title>"
_STYLE_TAG: Final = '<link rel="stylesheet" href="viewer.css" />'
_SCRIPT_TAG: Final = '<script type="module" src="viewer.js"></script>'
_POLICY: Final = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; "
    "worker-src 'self'; connect-src 'self' https:"
)

# What the viewer's page needs beside itself, the programs of its workers last.
_WORKERS: Final = ("worker.js", "viewer_worker.js")
_OTHERS: Final = ("viewer.css", "viewer.js", *_WORKERS)

# Browsers limit the length of one text to half a GiB, so a scene is cut into blocks. A multiple of
# 3 bytes, so that the base64 of each but the last ends without padding.
_BLOCK_BYTES: Final = 3 << 20


def linked_page(
    title: str,
    scene: str = SCENE_NAME,
    against: str | None = None,
    against_title: str | None = None,
) -> dict[str, bytes]:
    """Return the files of a page that fetches the scene beside it, by name.

    The scene is not among them; the first is the page, `PAGE_NAME`.

    Parameters
    ----------
    title : str
        What the browser writes above the page, and what the scene is called.
    scene : str
        Name of the scene's file, a ``.cogs`` or the PLY of 3DGS training, beside the page.
    against : str, optional
        Name of a second one, which the page compares with the scene.
    against_title : str, optional
        What the second one is called; its file's name by default.

    Returns
    -------
    dict of str to bytes
        They refer to each other by relative names and need no server but one that gives files.

    Examples
    --------
    >>> from cogsplat.tools.delivery.viewer_pages import linked_page
    >>> sorted(linked_page("Garden"))
    ['index.html', 'viewer.css', 'viewer.js', 'viewer_worker.js', 'worker.js']
    """
    second = "" if against is None else f' against="{html.escape(against)}"'
    if against_title is not None:
        second += f' against-label="{html.escape(printable(against_title))}"'
    page = _titled(title, f' src="{html.escape(scene)}"{second}')
    return {PAGE_NAME: page.encode(), **{name: _part(name) for name in _OTHERS}}


def write_lone_page(title: str, scene: BinaryIO, out: BinaryIO) -> None:
    """Write one page that holds the viewer and the scene, and works without a server.

    Parameters
    ----------
    title : str
        What the browser writes above the page.
    scene : binary file
        Read to its end from where it stands. Memory is needed for a block of it, not for all.
    out : binary file
        Receives UTF-8. The page's policy allows its own script and style, by their hashes, workers
        that it makes of texts in itself, and no connection to anywhere.
    """
    style, script = _part("viewer.css").decode(), _part("viewer.js").decode()
    policy = (
        f"default-src 'none'; script-src '{_hash(script)}' 'wasm-unsafe-eval'; "
        f"style-src '{_hash(style)}'; worker-src blob:"
    )
    page = _replaced(_titled(title), _POLICY, policy)
    page = _replaced(page, _STYLE_TAG, f"<style>{style}</style>")
    before, after = page.split(_SCRIPT_TAG)
    out.write(before.encode())
    for name in _WORKERS:
        text = _part(name)
        if b"</script" in text.lower() or b"<!--" in text:
            raise RuntimeError(f"{name} cannot stand in a page: it holds an end of a script")
        out.write(b'<script type="application/x-cogs-worker">' + text + b"</script>\n    ")
    for block in _blocks(scene):
        out.write(b'<script type="application/x-cogs-base64">')
        out.write(base64.b64encode(block))
        out.write(b"</script>\n    ")
    out.write(f'<script type="module">{script}</script>{after}'.encode())


def _blocks(scene: BinaryIO) -> Iterator[bytes]:
    while block := scene.read(_BLOCK_BYTES):
        yield block


def _titled(title: str, attributes: str = "") -> str:
    page = _part("viewer.html").decode()
    # Names of files may hold what no page may, halves of characters among it.
    text = html.escape(printable(title))
    page = _replaced(page, _TITLE, f"<title>{text}</title>")
    tag = f'<cogsplat-viewer id="page" label="{text}"{attributes}>'
    return _replaced(page, _VIEWER_TAG, tag)


def _part(name: str) -> bytes:
    return files("cogsplat.tools").joinpath("web", "dist", name).read_bytes()


def _replaced(page: str, old: str, new: str) -> str:
    if page.count(old) != 1:
        raise RuntimeError(f"viewer.html holds {old!r} {page.count(old)} times, expected once")
    return page.replace(old, new)


def _hash(text: str) -> str:
    """Return the hash by which a policy allows an inline script or style (CSP 3, 2.3.1)."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
