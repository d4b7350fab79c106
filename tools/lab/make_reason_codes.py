"""Write ``docs/reference/reason-codes.md``, the index of all reason codes, from the source.

Run ``python -m cogsplat.tools.lab.make_reason_codes`` after adding a code. A code is recognised
next to its message, among the arguments of a call or in a tuple. It is also recognised as the value
of a name that ends in ``CODE`` or begins with ``BAD_``.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
INDEX: Final = Path("docs") / "reference" / "reason-codes.md"

_CODE: Final = re.compile(r"[a-z][a-z0-9]*(?:-[a-z0-9]+)+")

# Codes of one word, which the pattern above cannot tell from other words.
_ONE_WORD: Final = frozenset(
    {"cancelled", "exists", "io", "mask", "memory", "permission", "photo", "usage"}
)

# Exit status of the command line, by error class of `codec.errors`.
_EXIT: Final = {
    "FormatError": 3,
    "TruncatedError": 3,
    "UnsupportedError": 3,
    "DataError": 3,
    "MissingExtraError": 4,
    "StorageError": 4,
    "LimitError": 5,
    "Cancelled": 130,
}

# Class and exit status of codes that the source does not pass to their class.
_STATED_ELSEWHERE: Final = {
    "broken-pipe": ("StorageError", 4),
    "cancelled": ("Cancelled", 130),
    "mask": ("DataError", 3),
    "photo": ("DataError", 3),
    "exists": ("StorageError", 2),
    "output-is-input": ("StorageError", 2),
    "usage": ("misuse of the command line", 2),
}

_TOP: Final = """# Reason codes

Every refusal has a reason code, which stays the same when its message is reworded:
`CogsplatError.code` in Python, in brackets behind the message on the command line, `error.code`
with `--json`. Codes of the `.cogs` format are listed with their clauses in
[section 12 of SPEC.md](../../SPEC.md#12-reason-codes) and are the same in every implementation; the
others are of this library.

The command line exits with the status of the class: 2 for misuse; 3 for invalid data
(`FormatError`, `TruncatedError`, `UnsupportedError`, `DataError`); 4 where input or output failed
(`StorageError`) or an extra is not installed (`MissingExtraError`); 5 where a limit was reached
(`LimitError`); 130 where the work was interrupted (`Cancelled`).

`python -m cogsplat.tools.lab.make_reason_codes` writes this page from the source.
"""


@dataclass(frozen=True)
class ReasonCode:
    """A reason code, with its error classes and its files.

    Parameters
    ----------
    code : str
    errors : tuple of str
        Names of the error classes of `codec.errors` with this code.
    modules : tuple of str
        Source files that contain it, relative to the root of the tree.
    """

    code: str
    errors: tuple[str, ...]
    modules: tuple[str, ...]

    @property
    def exit_statuses(self) -> tuple[int, ...]:
        """Exit statuses of the command line for this code."""
        if self.code in _STATED_ELSEWHERE:
            return (_STATED_ELSEWHERE[self.code][1],)
        return tuple(sorted({_EXIT[error] for error in self.errors}))


def reason_codes(root: Path = ROOT) -> list[ReasonCode]:
    """Return the reason codes that the source contains, in alphabetical order."""
    errors: dict[str, set[str]] = {}
    modules: dict[str, set[str]] = {}
    for room in ("codec", "formats", "tools"):
        for path in sorted((root / room).rglob("*.py")):
            # Builders of must-reject files mention codes without raising them.
            if {"conformance", "node_modules"} & {*path.parts} or path.name == Path(__file__).name:
                continue
            for code, error in _codes_in(ast.parse(path.read_text(encoding="utf-8"))):
                modules.setdefault(code, set()).add(path.relative_to(root).as_posix())
                if error in _EXIT:
                    errors.setdefault(code, set()).add(error)
    return [
        ReasonCode(
            code,
            (_STATED_ELSEWHERE[code][0],)
            if code in _STATED_ELSEWHERE
            else tuple(sorted(errors.get(code, {"FormatError"}))),
            tuple(sorted(found)),
        )
        for code, found in sorted(modules.items())
    ]


def page(root: Path = ROOT) -> str:
    """Return the index as Markdown."""
    spec = set(re.findall(r"^\| `([a-z0-9-]+)` \|", _section_12(root), re.MULTILINE))
    groups: dict[bool, list[ReasonCode]] = {True: [], False: []}
    for found in reason_codes(root):
        groups[found.code in spec].append(found)
    lines = [_TOP]
    for of_spec, title in ((True, "Codes of SPEC.md"), (False, "Codes of this library")):
        lines += [f"## {title}\n", "| code | class | exit |", "|---|---|---|"]
        for found in groups[of_spec]:
            exits = ", ".join(map(str, found.exit_statuses))
            row = (f"`{found.code}`", ", ".join(found.errors), exits)
            lines.append(f"| {' | '.join(row)} |")
        lines.append("")
    return "\n".join(lines)


def main() -> int:
    """Write the index; return the exit code."""
    (ROOT / INDEX).write_text(page(), encoding="utf-8", newline="\n")
    return 0


def _section_12(root: Path) -> str:
    text = (root / "SPEC.md").read_text(encoding="utf-8")
    return text.split("\n## 12 ", 1)[1].split("\n## ", 1)[0]


def _codes_in(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Yield the codes of a module, each with the name of the class or function it is passed to."""
    named = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                if isinstance(target, ast.Name) and re.search("CODES?$|^_?BAD_", target.id):
                    named[target.id] = _texts(node.value)
    for codes in named.values():
        for code in codes:
            yield code, ""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            function = node.func
            name = function.id if isinstance(function, ast.Name) else ""
            name = function.attr if isinstance(function, ast.Attribute) else name
            arguments = node.args
        elif isinstance(node, ast.Tuple):
            name, arguments = "", node.elts
        else:
            continue
        has_code = name in _CALLS_WITH_CODE or name in _EXIT or any(map(_is_message, arguments))
        for argument in arguments if has_code else ():
            codes = _texts(argument)
            if isinstance(argument, ast.Name):
                codes = named.get(argument.id, [])
            for code in codes:
                yield code, name
        for keyword in node.keywords if isinstance(node, ast.Call) else ():
            for code in _texts(keyword.value) if keyword.arg == "code" else ():
                yield code, ""


# Functions whose calls pass a code without a message.
_CALLS_WITH_CODE: Final = frozenset({"__init__", "_print_error", "refuse", "sibling"})


def _texts(node: ast.expr | None) -> list[str]:
    """Return the codes among the possible values of an expression."""
    if isinstance(node, ast.IfExp):
        return [*_texts(node.body), *_texts(node.orelse)]
    if isinstance(node, ast.Dict):
        return [code for value in node.values for code in _texts(value)]
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        is_code = _CODE.fullmatch(node.value) or node.value in _ONE_WORD
        return [node.value] if is_code else []
    return []


def _is_message(node: ast.expr) -> bool:
    if isinstance(node, ast.JoinedStr | ast.BinOp):
        return True
    return isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value


if __name__ == "__main__":
    sys.exit(main())
