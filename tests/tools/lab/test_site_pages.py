"""The site is built from the documents, and a link that leads nowhere fails."""

import subprocess
import sys
from pathlib import Path

import pytest

from cogsplat.tools.lab import check
from cogsplat.tools.lab.site_pages import rewrite_links

ROOT = Path(__file__).resolve().parents[3]


def test_links_lead_to_pages_of_the_site() -> None:
    guides, root = ROOT / "docs" / "guides", ROOT
    assert rewrite_links("[a](../../SPEC.md#2)", guides, depth=1) == "[a](../SPEC.md#2)"
    assert rewrite_links("[a](../streaming.md)", guides, depth=1) == "[a](../streaming.md)"
    assert rewrite_links("[a](docs/streaming.md)", root, depth=0) == "[a](streaming.md)"
    assert rewrite_links("[a](../../pyproject.toml)", guides, depth=1) == "a"
    assert rewrite_links("[a](https://a.example) [b](#c)", root, depth=0) == (
        "[a](https://a.example) [b](#c)"
    )


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="needs mkdocs")
    pytest.importorskip("mkdocstrings", reason="needs mkdocstrings")
    check.assemble(ROOT)
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", str(tmp_path / "site")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "encode" in (tmp_path / "site/reference/api/index.html").read_text(encoding="utf-8")
