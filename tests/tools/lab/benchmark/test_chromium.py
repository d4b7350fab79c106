"""Chromium is found where it is, and a page in it can be used once it says so."""

from pathlib import Path

import pytest
from chromium import executable as needed

from cogsplat.tools.lab.benchmark.chromium import executable, opened_page


@pytest.mark.parametrize("name", ["chromium", "chromium-browser"])
def test_what_is_installed_is_found_and_what_is_given_comes_before_it(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COGSPLAT_CHROMIUM", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert executable() is None
    program = tmp_path / name
    program.touch(mode=0o755)
    assert executable() == str(program)
    monkeypatch.setenv("COGSPLAT_CHROMIUM", "/opt/chromium")
    assert executable() == "/opt/chromium"


def test_a_page_is_opened_when_it_is_ready() -> None:
    needed()
    page = "data:text/html,<script>setTimeout(() => { window.answer = 42 }, 50)</script>"
    with opened_page(page, "window.answer !== undefined") as opened:
        assert opened.evaluate("() => window.answer") == 42
