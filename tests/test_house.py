"""Rules of the house that no linter knows; CONTRIBUTING.md states them.

Each test reads every file and lists all that is wrong.
"""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("codec", "formats", "tools")

MODULES = sorted(
    path
    for package in PACKAGES
    for path in (ROOT / package).rglob("*.py")
    if "node_modules" not in path.parts
)
FACADE = ROOT / "cogsplat/__init__.py"
TESTS = sorted((ROOT / "tests").rglob("*.py"))
TEXT = {path: path.read_text(encoding="utf-8") for path in [*MODULES, FACADE, *TESTS]}

MAX_LINES = 700
SHAPELESS = {"utils", "util", "common", "helpers", "helper", "misc"}
LATER = re.compile(r"\b(TO" r"DO|FIX" r"ME|XX" r"X|HA" r"CK)\b")
CITED = re.compile(r"\bSPEC,? (?:section |clause )?(\d+(?:\.\d+)*)")
CLAUSE = re.compile(r"[1-9]\d?(?:\.\d{1,2})+")
HEADING = re.compile(r"^#{1,6} +(\d+(?:\.\d+)*)\.?(?=[ \t])", re.MULTILINE)

# PyTorch is optional: only the bridge to it and the CUDA renderer may import it.
TORCH = re.compile(r"codec/(fit/autograd|render/cuda_(device|pairs|views))\.py")


@cache
def tree_of(path: Path) -> ast.Module:
    """Return the syntax tree of a file, parsed once and not in every process that lists tests."""
    return ast.parse(TEXT[path])


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def module_of(path: Path) -> str:
    """Return a file's module, as it is imported."""
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    parts = parts if parts[0] == "cogsplat" else ["cogsplat", *parts]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {module_of(path): path for path in [*MODULES, FACADE]}


def room_of(module: str) -> str:
    """Return the folder that a module belongs to: ``cogsplat.codec.order``."""
    parts = module.split(".")
    inside = (ROOT.joinpath(*parts[1:3])).is_dir() and len(parts) > 2
    return ".".join(parts[: 3 if inside else 2])


def imports_of(importer: str, tree: ast.AST, *, is_package: bool) -> Iterator[tuple[str, str]]:
    """Yield module and name of each import from the package, in function bodies as well.

    The name is empty where a whole module is imported.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names if alias.name in FILES)
        elif isinstance(node, ast.ImportFrom):
            parts = importer.split(".")
            start = parts[: len(parts) + is_package - node.level] if node.level else []
            source = ".".join([*start, *([node.module] if node.module else [])])
            for alias in node.names:
                if f"{source}.{alias.name}" in FILES:
                    yield f"{source}.{alias.name}", ""
                elif source in FILES:
                    yield source, alias.name


@cache
def imports() -> dict[str, set[tuple[str, str]]]:
    """Return what each module imports from the package."""
    return {
        module: set(imports_of(module, tree_of(path), is_package=path.name == "__init__.py"))
        for module, path in FILES.items()
    }


def test_imports_are_found() -> None:
    source = (
        "import numpy as np\nfrom cogsplat.codec.geometry import morton as m\n"
        "from ..splats import Splats\ndef f():\n    from cogsplat import open\n"
    )
    assert set(imports_of("cogsplat.codec.order.here", ast.parse(source), is_package=False)) == {
        ("cogsplat.codec.geometry.morton", ""),
        ("cogsplat.codec.splats", "Splats"),
        ("cogsplat", "open"),
    }
    assert room_of("cogsplat.codec.encode.profiles.vq") == "cogsplat.codec.encode"
    assert room_of("cogsplat.codec.splats") == "cogsplat.codec"
    assert sum(len(found) for found in imports().values()) > 1000


def cycles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the groups of modules that import each other in circles (Tarjan's algorithm)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(graph.get(node, ())):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                found.append(sorted(group))

    for node in sorted(graph):
        if node not in index:
            visit(node)
    return found


def test_modules_import_each_other_in_no_circle() -> None:
    assert cycles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == [["b", "c"]]
    # The facade is left out: commands import it, and it imports what they run when it is called.
    graph = {
        module: {source for source, _ in found} - {module, "cogsplat"}
        for module, found in imports().items()
        if module != "cogsplat"
    }
    assert cycles(graph) == []


def test_the_product_takes_nothing_from_the_lab() -> None:
    lab = "cogsplat.tools.lab"
    wrong = [
        f"{module} imports {source}"
        for module, found in imports().items()
        if not module.startswith(lab)
        for source, _ in found
        if source.startswith(lab)
    ]
    assert wrong == []


def test_no_private_name_crosses_a_room() -> None:
    wrong = [
        f"{module} imports {source}.{name}"
        for module, found in imports().items()
        for source, name in found
        if name.startswith("_") and not name.startswith("__")
        if room_of(module) != room_of(source)
    ]
    assert wrong == []


def test_only_tools_import_the_facade() -> None:
    wrong = [
        module
        for module, found in imports().items()
        if module.startswith(("cogsplat.codec", "cogsplat.formats"))
        if any(source == "cogsplat" for source, _ in found)
    ]
    assert wrong == []


def test_training_and_cuda_alone_import_torch() -> None:
    wrong = [
        name_of(path)
        for path in MODULES
        if re.search(r"^\s*(import|from) (torch|gsplat)\b", TEXT[path], re.MULTILINE)
        if not TORCH.fullmatch(name_of(path))
    ]
    assert wrong == []


def test_packages_hold_a_docstring_only() -> None:
    wrong = [
        name_of(path)
        for path in MODULES
        if path.name == "__init__.py" and len(tree_of(path).body) > 1
    ]
    assert wrong == []


def test_a_basename_means_one_thing() -> None:
    names: dict[str, list[str]] = {}
    for path in MODULES:
        if path.name != "__init__.py" and path.parts[-2] != "cli":
            names.setdefault(path.name, []).append(name_of(path))
    assert [found for found in names.values() if len(found) > 1] == []


def test_a_module_has_one_subject() -> None:
    lines = {name_of(path): len(text.splitlines()) for path, text in TEXT.items()}
    assert {name: count for name, count in lines.items() if count > MAX_LINES} == {}
    shapeless = [
        name_of(path)
        for path in MODULES
        if {*path.stem.split("_"), *path.parent.name.split("_")} & SHAPELESS
    ]
    assert shapeless == []


def test_nothing_is_left_for_later() -> None:
    assert [name_of(path) for path, text in TEXT.items() if LATER.search(text)] == []


def undocumented(node: ast.AST, outer: str) -> Iterator[str]:
    """Yield public functions, classes and methods under a node that have no docstring."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            continue
        if child.name.startswith("_"):
            continue
        name = f"{outer}{child.name}"
        decorators = {ast.unparse(decorator) for decorator in child.decorator_list}
        exempt = decorators & {"overload", "typing.overload", "override"}
        if ast.get_docstring(child) is None and not exempt:
            yield name
        if isinstance(child, ast.ClassDef):
            yield from undocumented(child, f"{name}.")


def test_everything_public_says_what_it_does() -> None:
    wrong = {name_of(path): list(undocumented(tree_of(path), "")) for path in MODULES}
    wrong |= {name_of(path): ["module"] for path in MODULES if not ast.get_docstring(tree_of(path))}
    assert {name: found for name, found in wrong.items() if found} == {}


def clauses_cited(text: str) -> set[str]:
    """Return clause numbers that a file names in its text or hands to an error."""
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


def test_clauses_are_found_where_they_are_cited() -> None:
    source = (
        '"""Reads heads (SPEC 4.2)."""\n# SPEC section 7, SPEC 0.1.2\nrefuse("a", clause="5.3")\n'
        'refuse("b", "c", "6.10")\nrefuse("9", "0.1", 1.5)\n'
    )
    assert clauses_cited(source) == {"4.2", "7", "0.1.2", "5.3", "6.10"}
    assert HEADING.findall("# 1 One\n## 2.3. Two\n### 4.5.6 Three\ntext 9 no\n# None\n") == [
        "1",
        "2.3",
        "4.5.6",
    ]


def test_cited_clauses_exist() -> None:
    headings = set(HEADING.findall((ROOT / "SPEC.md").read_text(encoding="utf-8")))
    wrong = {name_of(path): clauses_cited(TEXT[path]) - headings for path in MODULES}
    assert {name: found for name, found in wrong.items() if found} == {}
