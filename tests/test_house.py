"""Rules of the house that no linter knows: CONTRIBUTING.md states them."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("codec", "formats", "tools")

MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))
ALL = [*MODULES, *TESTS, *(ROOT / "cogsplat").glob("*.py")]

SHAPELESS = {"utils", "util", "common", "helpers", "helper", "misc"}
LATER = re.compile(r"\b(TO" r"DO|FIX" r"ME|XX" r"X|HA" r"CK)\b")
CITED = re.compile(r"\bSPEC,? (?:section |clause )?(\d+(?:\.\d+)*)")
CLAUSE = re.compile(r"[1-9]\d?(?:\.\d{1,2})+")
HEADING = re.compile(r"^#{1,6} +(\d+(?:\.\d+)*)\.?(?=[ \t])", re.MULTILINE)


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_the_rules_look_at_something() -> None:
    assert len(MODULES) > 10
    assert {path.parent.name for path in MODULES} >= set(PACKAGES)


@pytest.mark.parametrize("path", ALL, ids=name_of)
def test_module_is_one_subject_long(path: Path) -> None:
    lines = len(path.read_text(encoding="utf-8").splitlines())
    assert lines <= 700, f"{lines} lines: split it by subject"


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_module_is_named_after_a_subject(path: Path) -> None:
    words = set(path.stem.split("_")) | set(path.parent.name.split("_"))
    assert not words & SHAPELESS


@pytest.mark.parametrize("path", ALL, ids=name_of)
def test_nothing_is_left_for_later(path: Path) -> None:
    found = LATER.findall(path.read_text(encoding="utf-8"))
    assert found == []


def undocumented(node: ast.AST, outer: str) -> Iterator[str]:
    """Yield public functions, classes and methods under a node that have no docstring."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            continue
        if child.name.startswith("_"):
            continue
        name = f"{outer}{child.name}"
        decorators = {ast.unparse(decorator) for decorator in child.decorator_list}
        if ast.get_docstring(child) is None and not decorators & {"overload", "typing.overload"}:
            yield name
        if isinstance(child, ast.ClassDef):
            yield from undocumented(child, f"{name}.")


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_everything_public_says_what_it_does(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert ast.get_docstring(tree), "the module itself"
    assert list(undocumented(tree, "")) == []


def clauses_cited(path: Path) -> set[str]:
    """Return clause numbers that a file names in its text or hands to an error."""
    text = path.read_text(encoding="utf-8")
    cited = set(CITED.findall(text))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call):
            values = [*node.args, *(keyword.value for keyword in node.keywords)]
            cited |= {
                value.value
                for value in values
                if isinstance(value, ast.Constant)
                and isinstance(value.value, str)
                and CLAUSE.fullmatch(value.value)
            }
    return cited


def test_clauses_are_found_where_they_are_cited(tmp_path: Path) -> None:
    source = tmp_path / "cites.py"
    source.write_text(
        '"""Reads heads (SPEC 4.2)."""\n# SPEC section 7, SPEC 0.1.2\nrefuse("a", clause="5.3")\n'
        'refuse("b", "c", "6.10")\nrefuse("9", "0.1", 1.5)\n',
        encoding="utf-8",
    )
    assert clauses_cited(source) == {"4.2", "7", "0.1.2", "5.3", "6.10"}
    assert HEADING.findall("# 1 One\n## 2.3. Two\n### 4.5.6 Three\ntext 9 no\n# None\n") == [
        "1",
        "2.3",
        "4.5.6",
    ]


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_cited_clauses_exist(path: Path) -> None:
    cited = clauses_cited(path)
    if cited:
        headings = set(HEADING.findall((ROOT / "SPEC.md").read_text(encoding="utf-8")))
        assert cited - headings == set()
