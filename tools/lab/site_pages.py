"""Hooks of MkDocs: documents at the root of the tree become pages of the site, with their links."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

_ROOT: Final = Path(__file__).resolve().parents[2]
_DOCUMENTS: Final = ("SPEC.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")
_LINK: Final = re.compile(r"\[([^\]]*)\]\((?!https?:|#)([^)#\s]+)(#[^)]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the documents at the root to the files of the site."""
    from mkdocs.structure.files import File

    for name in _DOCUMENTS:
        files.append(File.generated(config, name, abs_src_path=str(_ROOT / name)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Rewrite links between documents; a link to a file that is no page becomes plain text."""
    source = page.file.src_uri
    folder = _ROOT if source in _DOCUMENTS else (_ROOT / "docs" / source).parent
    return rewrite_links(markdown, folder, depth=source.count("/"))


def rewrite_links(markdown: str, folder: Path, *, depth: int) -> str:
    """Return Markdown whose links lead to pages of the site.

    Parameters
    ----------
    markdown : str
    folder : Path
        Folder of the document in the tree; its links are relative to it.
    depth : int
        Folders above the page in the site.
    """
    up = "../" * depth

    def replaced(match: re.Match[str]) -> str:
        text, place, anchor = match[1], match[2], match[3] or ""
        path = (folder / place).resolve()
        if path.is_relative_to(_ROOT / "docs") and path.is_file():
            return f"[{text}]({up}{path.relative_to(_ROOT / 'docs').as_posix()}{anchor})"
        if path.parent == _ROOT and path.name in _DOCUMENTS:
            return f"[{text}]({up}{path.name}{anchor})"
        return text

    return _LINK.sub(replaced, markdown)
