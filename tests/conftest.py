"""Settings and fixtures of all tests, and a list of the tests that skip."""

import gc
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from cogsplat.codec.streams import decoding_tiers

# The same examples on every run and every machine, none refused for being slow on a busy one, and
# no folder of failures left in the checkout.
settings.register_profile("cogsplat", derandomize=True, deadline=None, database=None)
settings.load_profile("cogsplat")


# Collecting 12,000 tests makes millions of objects that all stay: searching them for garbage
# takes 40 % of the time of collecting.
gc.disable()


SKIPPED = pytest.StashKey[dict[str, str]]()

# Tests skip with these words where a program or package is not installed.
MISSING = ("needs ", "could not import ")


def pytest_configure(config: pytest.Config) -> None:
    config.stash[SKIPPED] = {}
    config.pluginmanager.register(SkippedTests(config), "skipped-tests")


def pytest_collection_finish() -> None:
    gc.enable()


class SkippedTests:
    """Writes the tests that skip to ``.pytest_cache/skipped``, for a run where more is installed.

    ``pytest @.pytest_cache/skipped`` runs them. With ``COGSPLAT_TESTS=all`` nothing may be missing:
    a test that skips for it fails the run.
    """

    def __init__(self, config: pytest.Config) -> None:
        self.skipped: dict[str, str] = config.stash[SKIPPED]

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        self._add(report)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._add(report)

    def _add(self, report: pytest.CollectReport | pytest.TestReport) -> None:
        if report.skipped and isinstance(report.longrepr, tuple):
            self.skipped[report.nodeid] = report.longrepr[2].removeprefix("Skipped: ")

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if hasattr(session.config, "workerinput"):
            return
        missing = {
            name: reason for name, reason in self.skipped.items() if reason.startswith(MISSING)
        }
        if os.environ.get("COGSPLAT_TESTS") == "all":
            for name, reason in missing.items():
                print(f"\n{name} may not skip here: {reason}")
            if missing:
                session.exitstatus = pytest.ExitCode.TESTS_FAILED
            return
        folder = Path(session.config.rootpath) / ".pytest_cache"
        folder.mkdir(exist_ok=True)
        # Without parameters, which may have other names where more is installed.
        names = dict.fromkeys(name.partition("[")[0] for name in missing)
        (folder / "skipped").write_text("\n".join(names), encoding="utf-8")


@pytest.fixture(scope="module", params=["numpy", "compiled"])
def kernels(request: pytest.FixtureRequest) -> Iterator[str]:
    """Decode with numpy alone, then with the compiled kernels: both must do the same."""
    way: str = request.param
    before = decoding_tiers.is_compiled()
    patch = pytest.MonkeyPatch()
    if way == "numpy":
        patch.setattr(decoding_tiers, "_load", lambda: None)
    elif not decoding_tiers._load():
        pytest.fail("expected kernels that can be imported")
    decoding_tiers.use_compiled(way == "compiled")
    yield way
    decoding_tiers.use_compiled(before)
    patch.undo()
