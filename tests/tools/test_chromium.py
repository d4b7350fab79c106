"""Tests of pages skip where no browser is installed, and say what they need."""

import pytest
from chromium import executable


def test_a_test_skips_without_a_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("COGSPLAT_CHROMIUM", raising=False)
    pytest.importorskip("playwright", reason="needs playwright")
    with pytest.raises(pytest.skip.Exception, match="COGSPLAT_CHROMIUM"):
        executable()
    monkeypatch.setenv("COGSPLAT_CHROMIUM", "/opt/chromium")
    assert executable() == "/opt/chromium"
