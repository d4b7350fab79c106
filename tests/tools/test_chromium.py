"""Tests of pages fail in CI where no browser is installed, and skip elsewhere."""

import pytest
from chromium import executable


def test_a_missing_browser_fails_in_ci_and_skips_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("COGSPLAT_CHROMIUM", raising=False)
    monkeypatch.setenv("CI", "true")
    with pytest.raises(pytest.fail.Exception, match="apt-get install chromium"):
        executable()
    monkeypatch.delenv("CI")
    with pytest.raises(pytest.skip.Exception, match="COGSPLAT_CHROMIUM"):
        executable()
    monkeypatch.setenv("COGSPLAT_CHROMIUM", "/opt/chromium")
    assert executable() == "/opt/chromium"
