"""Small mistakes that tests make in a decoder on purpose, and what is made of files with them."""

import __future__

import hashlib
import inspect
import json
import textwrap
from dataclasses import dataclass
from pathlib import Path
from types import FunctionType

from cogsplat.codec.errors import CogsplatError
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.storage.source import BytesSource
from cogsplat.tools.lab.conformance import reference_decoder

VECTORS = Path(__file__).resolve().parents[1] / "vectors"
MANIFEST = json.loads((VECTORS / "manifest.json").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Mutant:
    """A change of one function.

    Parameters
    ----------
    name : str
        What the mistake is.
    function : function
    old, new : str
        Text that occurs once in the function, and what stands in its place.
    clauses : tuple of str
        Vectors of these clauses are tried.
    """

    name: str
    function: FunctionType
    old: str
    new: str
    clauses: tuple[str, ...]


def apply(mutant, monkeypatch):
    """Change a function in place, so that every reference to it sees the change."""
    source = textwrap.dedent(inspect.getsource(mutant.function))
    assert source.count(mutant.old) == 1, f"{mutant.name}: {mutant.old!r} does not occur once"
    scope = {}
    changed = source.replace(mutant.old, mutant.new)
    flags = __future__.annotations.compiler_flag
    exec(compile(changed, mutant.name, "exec", flags), mutant.function.__globals__, scope)
    code = scope[mutant.function.__name__].__code__
    # A method's code knows its class by the cell of `super`, of which none of these makes use.
    assert code.co_freevars == ()
    monkeypatch.setattr(mutant.function, "__code__", code)


def vectors_of(folder, clauses):
    entries = [
        e for e in MANIFEST[folder] if set(clauses) & {e.get("clause"), *e.get("clauses", ())}
    ]
    return [(e, (VECTORS / folder / f"{e['name']}.cogs").read_bytes()) for e in entries]


def told(data):
    """All that the second decoder makes of a valid file; the bits of every number count."""
    try:
        return repr((reference_decoder.decode(data), reference_decoder.decode(data, refine=False)))
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        return repr(error)


def outcome(entry, data):
    """Return the reason code of a file, or a hash of everything that is read of it."""
    digest = hashlib.sha256()
    try:
        with open_cogs(BytesSource(data)) as file:
            splats = file.decode()
            for name in ("means", "scales", "quats", "opacities", "sh0", "shN"):
                digest.update(getattr(splats, name).tobytes())
            if entry.get("stage", "verify") == "verify":
                file.verify()
                for chunks in range(1, file.num_chunks + 1):
                    found = file.decode(range(chunks), compensate=True)
                    digest.update(found.scales.tobytes() + found.opacities.tobytes())
    except CogsplatError as error:
        return error.code
    except ValueError as error:
        return repr(error)
    return digest.hexdigest()
