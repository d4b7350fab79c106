"""The index of reason codes against the source, SPEC and the codes that tests see raised."""

import re
from pathlib import Path

from cogsplat.codec import errors
from cogsplat.tools.lab import make_reason_codes
from cogsplat.tools.lab.make_reason_codes import reason_codes

ROOT = Path(__file__).resolve().parents[3]
ASSERTED = re.compile(r"""(?:\.code|\["code"\]) == "([a-z0-9-]+)\"""")

# Tests of the machinery raise these themselves.
MADE_UP = {"a-code", "bad"}


def test_the_page_is_what_the_source_gives() -> None:
    page = (ROOT / make_reason_codes.INDEX).read_text(encoding="utf-8")
    assert page == make_reason_codes.page(), "run python -m cogsplat.tools.lab.make_reason_codes"


def test_every_code_of_spec_and_every_code_that_tests_see_is_listed() -> None:
    listed = {found.code for found in reason_codes()}
    spec = (ROOT / "SPEC.md").read_text(encoding="utf-8").split("\n## 12 ")[1].split("\n## ")[0]
    of_spec = set(re.findall(r"^\| `([a-z0-9-]+)` \|", spec, re.MULTILINE))
    assert len(of_spec) > 50
    assert of_spec - listed == set()
    seen: set[str] = set()
    for path in (ROOT / "tests").rglob("*.py"):
        seen |= set(ASSERTED.findall(path.read_text(encoding="utf-8")))
    assert len(seen) > 50
    assert seen - listed - MADE_UP == set()


def test_exit_statuses_are_those_of_the_classes() -> None:
    for found in reason_codes():
        kinds = [getattr(errors, name) for name in found.errors if hasattr(errors, name)]
        if found.code in ("exists", "output-is-input", "usage"):
            assert found.exit_statuses == (2,)
        else:
            assert found.exit_statuses == tuple(sorted({kind.exit_code for kind in kinds}))


def test_a_new_code_is_found_wherever_it_stands(tmp_path: Path) -> None:
    for room in ("codec", "formats", "tools"):
        (tmp_path / room).mkdir()
    (tmp_path / "formats" / "new.py").write_text(
        "BAD_HEAD = 'new-head'\n"
        "_CODES = {'a': 'new-a', 'b': 'new-b'}\n"
        "def f(where):\n"
        "    raise LimitError('new-limit', f'{where}: found')\n"
        "    raise FormatError(BAD_HEAD, f'{where}: found')\n"
        "    raise table.error('key', 'found here', 'new-last')\n"
        "    read(where, code='new-keyword')\n"
        "    'not-a-code'.split('-')\n"
    )
    found = {code.code: code.errors for code in reason_codes(tmp_path)}
    assert set(found) == {"new-head", "new-a", "new-b", "new-limit", "new-last", "new-keyword"}
    assert found["new-limit"] == ("LimitError",)
