"""Conformance test of a decoder: sends all vectors, and reports failures by clause."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import StorageError
from cogsplat.codec.progress import Progress, silent

from .protocol import LEVELS, Answer, DecoderProcess, Hello
from .tolerance import beyond_tolerance, picture_fault

Entry = Mapping[str, object]
Arrays = dict[str, NDArray[np.float32]]

# Code of a limit that other decoders may set higher (SPEC 9.2); decoding the file is no failure.
_LIMIT: Final = "decoded-size"


@dataclass(frozen=True)
class Failure:
    """A failed check of one vector.

    Parameters
    ----------
    vector : str
        Name such as ``valid/sh3`` or ``invalid/zstd-cut``; for a partial file, also the part.
    clauses : tuple of str
        SPEC clauses that the vector covers.
    expected, found : str
    """

    vector: str
    clauses: tuple[str, ...]
    expected: str
    found: str


@dataclass(frozen=True)
class Report:
    """Result of a conformance test.

    Parameters
    ----------
    decoder : Hello
    passed : int
        Number of checks that passed.
    failures : list of Failure
    by_clause : dict of str to (int, int)
        Checks passed and checks made, by SPEC clause.
    """

    decoder: Hello
    passed: int
    failures: list[Failure]
    by_clause: dict[str, tuple[int, int]] = field(default_factory=dict)


def run(
    command: Sequence[str],
    vectors: Path,
    *,
    timeout_s: float = 30.0,
    progress: Progress = silent,
) -> Report:
    """Test a decoder with all vectors.

    Parameters
    ----------
    command : sequence of str
        Program and arguments; see `protocol` for what it reads and writes.
    vectors : Path
        Folder with ``manifest.json`` and the vectors.
    timeout_s : float
        Time limit for one answer, seconds.
    progress : Progress
        Called with ``("vectors", files done, files)``.

    Returns
    -------
    Report

    Raises
    ------
    StorageError
        ``not-found``: there are no vectors; ``decoder``: the decoder cannot be started.
    """
    try:
        manifest = json.loads((vectors / "manifest.json").read_text(encoding="utf-8"))
    except OSError as error:
        raise StorageError(
            "not-found", f"{vectors / 'manifest.json'}: {error.strerror}, expected the vectors"
        ) from error
    with DecoderProcess(command, timeout_s) as decoder, tempfile.TemporaryDirectory() as folder:
        hello = decoder.hello()
        checker = _Checker(decoder, hello, vectors, Path(folder), list(manifest["arrays"]))
        invalid = manifest["invalid"] if hello.refuses else []
        folders = manifest["folders"] if hello.folders else []
        bad_folders = manifest["invalid_folders"] if hello.folders and hello.refuses else []
        drawings = manifest["drawings"] if hello.draws else []
        total = sum(map(len, (manifest["valid"], invalid, folders, bad_folders, drawings)))
        for done, entry in enumerate(manifest["valid"], start=1):
            checker.check_valid(entry)
            progress("vectors", done, total)
        for done, entry in enumerate(invalid, start=1 + len(manifest["valid"])):
            checker.check_invalid(entry)
            progress("vectors", done, total)
        files = {entry["name"]: entry for entry in manifest["valid"]}
        for entry in folders:
            checker.check_folder(entry, files)
        for entry in bad_folders:
            checker.check_invalid_folder(entry)
        for entry in drawings:
            checker.check_drawing(entry)
        progress("vectors", total, total)
    return checker.report()


class _Checker:
    """Comparison of one decoder's answers with the manifest."""

    def __init__(
        self, decoder: DecoderProcess, hello: Hello, vectors: Path, folder: Path, arrays: list[str]
    ) -> None:
        self._decoder = decoder
        self._hello = hello
        self._vectors = vectors
        self._out = folder / "arrays.f32"
        self._cut = folder / "prefix.cogs"
        self._arrays = arrays
        self._failures: list[Failure] = []
        self._clauses: dict[str, list[int]] = {}
        self._passed = 0

    def report(self) -> Report:
        """Return the result of all checks so far."""
        by_clause = {
            clause: (passed, made)
            for clause, (passed, made) in sorted(
                self._clauses.items(), key=lambda item: [int(n) for n in item[0].split(".")]
            )
        }
        return Report(self._hello, self._passed, self._failures, by_clause)

    def _record(self, vector: str, clauses: tuple[str, ...], expected: str, found: str) -> None:
        """Count one check for each clause. `found` describes its fault; "" if it passed."""
        right = not found
        self._passed += right
        for clause in clauses:
            sums = self._clauses.setdefault(clause, [0, 0])
            sums[0] += right
            sums[1] += 1
        if not right:
            self._failures.append(Failure(vector, clauses, expected, found))

    def check_valid(self, entry: Entry) -> None:
        """Check the decoding of a valid file, also without refinements and truncated."""
        name, clauses = str(entry["name"]), tuple(map(str, _list(entry["clauses"])))
        path = self._vectors / "valid" / f"{name}.cogs"
        whole = self._load_arrays(path.with_suffix(".f32"), entry)
        given, wrong = self._decode(path, verify=self._hello.level == "verifier")
        wrong = wrong or self._difference(given, whole)
        self._record(f"valid/{name}", clauses, f"{entry['splats']} splats", wrong)
        coarse, wrong = self._decode(path, refine=False)
        coarse_hash = str(entry.get("coarse_sha256", entry["arrays_sha256"]))
        exact = self._hello.level != "viewer"
        if not wrong and exact and hashlib.sha256(coarse).hexdigest() != coarse_hash:
            wrong = "rows without refinements have another SHA-256"
        self._record(f"valid/{name} without refinements", clauses, coarse_hash, wrong)
        if wrong or not exact or not self._hello.partial:
            # Expected rows of prefixes are built from the rows without refinements.
            return
        heads = self._split_arrays(coarse, whole)
        counts = _integers(entry["chunk_splats"])
        data = path.read_bytes()
        drawn = [str(digest) for digest in _list(entry.get("drawn", []))]
        for number, (size, chunks, tails, refined) in enumerate(_prefixes(entry)):
            self._cut.write_bytes(data[:size])
            given, wrong = self._decode(self._cut, partial=True)
            if wrong:
                pass
            elif drawn:
                if hashlib.sha256(given).hexdigest() != drawn[number]:
                    wrong = "the rows that are drawn have another SHA-256"
            else:
                expected = _prefix_rows(whole, heads, counts[:chunks], tails, refined)
                wrong = self._difference(given, expected)
            self._record(
                f"valid/{name}, first {size} bytes",
                (*clauses, "8.2"),
                f"{sum(counts[:chunks])} splats",
                wrong,
            )

    def _decode(
        self, path: Path, *, partial: bool = False, refine: bool = True, verify: bool = False
    ) -> tuple[bytes, str]:
        """Return the decoded arrays as bytes and "", or no bytes and the reason of the failure."""
        self._out.unlink(missing_ok=True)
        answer, reason = self._decoder.decode(
            path, self._out, partial=partial, refine=refine, verify=verify
        )
        return self._written(answer, reason)

    def _written(self, answer: Answer | None, reason: str) -> tuple[bytes, str]:
        """Return the bytes that a request has written and "", or no bytes and the reason."""
        if answer is None:
            return b"", reason
        if answer.get("ok") is not True:
            return b"", f"refused with {answer.get('code')!r}"
        if not self._out.is_file():
            return b"", f"no file {self._out.name} was written"
        return self._out.read_bytes(), ""

    def _load_arrays(self, path: Path, entry: Entry) -> Arrays:
        """Load a valid vector's expected arrays."""
        shapes = _dict(entry["shapes"])
        blank = {name: np.empty(shapes[name], np.float32) for name in self._arrays}
        return self._split_arrays(path.read_bytes(), blank)

    def _split_arrays(self, data: bytes, like: Arrays) -> Arrays:
        """Split decoded bytes into arrays with the shapes of `like`."""
        values, start = np.frombuffer(data, "<f4"), 0
        out: Arrays = {}
        for name in self._arrays:
            stop = start + like[name].size
            out[name] = values[start:stop].reshape(like[name].shape)
            start = stop
        return out

    def _difference(self, given: bytes, expected: Arrays) -> str:
        """Compare bytes of decoded arrays with `expected`; return the first difference or ""."""
        size = 4 * sum(values.size for values in expected.values())
        if len(given) != size:
            return f"{len(given)} bytes of arrays, expected {size}"
        for name, part in self._split_arrays(given, expected).items():
            values = expected[name]
            if self._hello.level == "viewer":
                wrong = beyond_tolerance(name, part, values, expected)
            else:
                wrong = part.view(np.uint32) != values.view(np.uint32)
            if wrong.any():
                first = tuple(int(n) for n in np.argwhere(wrong)[0])
                return (
                    f"{name}{list(first)} is {float(part[first])!r}, expected "
                    f"{float(values[first])!r}; {int(wrong.sum())} of {wrong.size} values differ"
                )
        return ""

    def check_invalid(self, entry: Entry) -> None:
        """Check that a must-reject file is refused with its code; a viewer may give any code."""
        if LEVELS.index(str(entry["level"])) > LEVELS.index(self._hello.level):
            return
        self._check_refusal(f"invalid/{entry['name']}", ".cogs", entry)

    def check_folder(self, entry: Entry, files: Mapping[str, Entry]) -> None:
        """Check a valid folder through each of its manifests."""
        for manifest, stands_for in _texts(entry["manifests"]).items():
            path = self._vectors / "folders" / str(entry["name"]) / manifest
            arrays = self._vectors / "valid" / f"{stands_for}.f32"
            given, wrong = self._decode(path, verify=self._hello.level == "verifier")
            whole = self._load_arrays(arrays, files[stands_for])
            wrong = wrong or self._difference(given, whole)
            self._record(
                f"folders/{entry['name']}/{manifest}", ("3.4",), f"as {stands_for}.cogs", wrong
            )

    def check_invalid_folder(self, entry: Entry) -> None:
        """Check that a must-reject folder is refused with its code; a viewer may give any code."""
        if entry["stage"] == "verify" and self._hello.level != "verifier":
            return
        self._check_refusal(f"invalid-folders/{entry['name']}", "/manifest.cogsm", entry)

    def check_drawing(self, entry: Entry) -> None:
        """Check a picture of a scene."""
        folder, camera = self._vectors / "drawings", entry["camera"]
        assert isinstance(camera, dict)
        expected = np.fromfile(folder / f"{entry['name']}.f32", "<f4")
        self._out.unlink(missing_ok=True)
        path = folder / f"{entry['scene']}.cogs"
        given, wrong = self._written(*self._decoder.draw(path, self._out, camera))
        if not wrong and len(given) != expected.nbytes:
            wrong = f"{len(given)} bytes of a picture, expected {expected.nbytes}"
        if not wrong:
            shape = (camera["height"], camera["width"], 3)
            wrong = picture_fault(
                np.frombuffer(given, "<f4").reshape(shape),
                expected.reshape(shape),
                is_viewer=self._hello.level == "viewer",
            )
        self._record(f"drawings/{entry['name']}", ("8.7",), str(entry["note"]), wrong)

    def _check_refusal(self, vector: str, rest: str, entry: Entry) -> None:
        """Check that the decoder refuses the file or manifest at path `vector` + `rest`."""
        verifies = self._hello.level == "verifier"
        code = str(entry["code"])
        path = self._vectors / f"{vector}{rest}"
        self._out.unlink(missing_ok=True)
        answer, reason = self._decoder.decode(path, self._out, verify=verifies)
        if answer is None:
            found = reason
        elif answer.get("ok") is not False:
            found = "" if code == _LIMIT else "decoded"
        elif self._hello.level == "viewer" or answer.get("code") == code:
            found = ""
        else:
            found = f"refused with {answer.get('code')!r}"
        self._record(vector, (str(entry["clause"]),), f"refused with {code!r}", found)


def _prefixes(entry: Entry) -> list[tuple[int, int, list[int], list[int]]]:
    """Return the prefixes of a manifest's entry: size, chunks, tails, refined."""
    found = entry["prefixes"]
    assert isinstance(found, list)
    return [(size, chunks, tails, refined) for size, chunks, tails, refined in found]


def _prefix_rows(
    whole: Arrays, heads: Arrays, counts: list[int], tails: list[int], refined: list[int]
) -> Arrays:
    """Return the expected arrays of a prefix, with refined chunks from `whole`, else from `heads`.

    The SH coefficients above DC are 0 in chunks that are not in `tails`.
    """
    rows = sum(counts)
    out = {name: values[:rows].copy() for name, values in heads.items()}
    start = 0
    for chunk, count in enumerate(counts):
        run = slice(start, start + count)
        start += count
        for name, values in whole.items():
            if name == "shN":
                out[name][run] = values[run] if chunk in tails else 0
            elif chunk in refined:
                out[name][run] = values[run]
    return out


def _list(value: object) -> list[object]:
    assert isinstance(value, list)
    return value


def _integers(value: object) -> list[int]:
    assert isinstance(value, list)
    return value


def _texts(value: object) -> dict[str, str]:
    assert isinstance(value, dict)
    return value


def _dict(value: object) -> dict[str, list[int]]:
    assert isinstance(value, dict)
    return value
