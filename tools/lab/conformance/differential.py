"""Several decoders on seeded mutants of files: each must say the same of every one.

Verdict, reason code and, where a mutant is read, the bits of all arrays are compared. A decoder for
valid files alone is asked about the mutants that the others read.
"""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cogsplat.codec.errors import StorageError
from cogsplat.codec.progress import Progress, silent

from .file_mutations import Mutant, make_mutant
from .protocol import Answer, DecoderProcess, Hello, decode_request

# More splats take a decoder that is written to be read, not to be fast, too long.
_MOST_SPLATS_FOR_SLOW: Final = 2000


@dataclass(frozen=True)
class Disagreement:
    """A mutant of which two decoders say different things.

    Parameters
    ----------
    number : int
        Of the mutant in its run.
    mutant : Mutant
    verify : bool
        Whether all that a verifier checks was asked for.
    verdicts : tuple of str
        What each decoder said: a reason code, or the hash of its arrays.
    """

    number: int
    mutant: Mutant
    verify: bool
    verdicts: tuple[str, ...]


@dataclass(frozen=True)
class FuzzReport:
    """What a run over mutants found.

    Parameters
    ----------
    decoders : tuple of Hello
    most_memory : tuple of int
        The most memory that each decoder held at once, bytes; 0 where no system tells.
    mutants : int
    verdicts : dict of str to int
        How often each reason code was given, and ``accepted``.
    slowest_s : float
        Longest time until all decoders had answered for a mutant, seconds.
    disagreements : list of Disagreement
    """

    decoders: tuple[Hello, ...]
    most_memory: tuple[int, ...]
    mutants: int
    verdicts: dict[str, int]
    slowest_s: float
    disagreements: list[Disagreement]


def vector_files(vectors: Path) -> list[tuple[str, bytes]]:
    """Return names and bytes of the conformance files that are to be decoded.

    Raises
    ------
    StorageError
        ``not-found`` where there are none.
    """
    paths = sorted((vectors / "valid").glob("*.cogs"))
    if not paths:
        raise StorageError("not-found", f"{vectors / 'valid'}: no .cogs files, expected vectors")
    return [(path.stem, path.read_bytes()) for path in paths]


def fuzz(
    commands: Sequence[Sequence[str]],
    files: Sequence[tuple[str, bytes]],
    *,
    seed: int,
    count: int,
    first: int = 0,
    timeout_s: float = 30.0,
    progress: Progress = silent,
) -> FuzzReport:
    """Ask decoders about mutants ``first`` to ``first + count - 1`` of a seeded run.

    Parameters
    ----------
    commands : sequence of sequence of str
        Program and arguments of each decoder; see `protocol` for what they read and write.
    files : sequence of (str, bytes)
        Names and bytes of the valid files that mutants are made from.
    seed, count, first : int
    timeout_s : float
        Longest time for one answer, seconds; a decoder that takes longer has said something else
        than the others.
    progress : Progress
        Called with ``("mutants", mutants done, mutants)``.

    Returns
    -------
    FuzzReport

    Raises
    ------
    StorageError
        ``decoder`` where one cannot be started.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        decoders = [stack.enter_context(DecoderProcess(c, timeout_s)) for c in commands]
        panel = _Decoders(decoders, folder)
        verdicts: Counter[str] = Counter()
        disagreements = []
        slowest = 0.0
        for done, number in enumerate(range(first, first + count), start=1):
            mutant = make_mutant(files, seed, number)
            start = time.monotonic()
            verify = bool(number % 4)
            found = panel.verdicts(mutant, verify=verify)
            slowest = max(slowest, time.monotonic() - start)
            verdicts[found[0].split()[0]] += 1
            if len({verdict for verdict in found if verdict}) > 1:
                disagreements.append(Disagreement(number, mutant, verify, found))
            progress("mutants", done, count)
        return FuzzReport(
            decoders=panel.hellos,
            most_memory=tuple(decoder.most_memory() for decoder in decoders),
            mutants=count,
            verdicts=dict(verdicts.most_common()),
            slowest_s=slowest,
            disagreements=disagreements,
        )


class _Decoders:
    """Asks all decoders about a mutant, those that refuse nothing last."""

    def __init__(self, decoders: Sequence[DecoderProcess], folder: Path) -> None:
        self._decoders = decoders
        self.hellos = tuple(decoder.hello() for decoder in decoders)
        self._path = folder / "mutant.cogs"
        self._outs = [folder / f"arrays-{number}.f32" for number in range(len(decoders))]
        self._strict = [n for n, hello in enumerate(self.hellos) if hello.refuses]
        self._lenient = [n for n, hello in enumerate(self.hellos) if not hello.refuses]
        self._verifiers = all(self.hellos[n].level == "verifier" for n in self._strict)

    def verdicts(self, mutant: Mutant, *, verify: bool) -> tuple[str, ...]:
        """Return what each decoder says; an empty text where it was not asked."""
        self._path.write_bytes(mutant.data)
        found = [""] * len(self._decoders)
        verify = verify and self._verifiers
        answers = self._ask(self._strict, mutant, verify=verify)
        for number, verdict in answers.items():
            found[number] = verdict
        agreed = set(answers.values())
        # A decoder for valid files is asked only about files of which everything was checked.
        if verify and len(agreed) == 1 and self._is_small_and_whole(agreed.pop(), mutant):
            for number, verdict in self._ask(self._lenient, mutant, verify=False).items():
                found[number] = verdict
        return tuple(found)

    def _is_small_and_whole(self, verdict: str, mutant: Mutant) -> bool:
        word, *rest = verdict.split()
        return word == "accepted" and not mutant.partial and int(rest[0]) <= _MOST_SPLATS_FOR_SLOW

    def _ask(self, numbers: Sequence[int], mutant: Mutant, *, verify: bool) -> dict[int, str]:
        # All are asked before the first answer is waited for, so that they work at one time.
        for number in numbers:
            out = self._outs[number]
            out.unlink(missing_ok=True)
            request = decode_request(self._path, out, partial=mutant.partial, verify=verify)
            self._decoders[number].send(request)
        return {
            number: self._verdict(*self._decoders[number].receive(), self._outs[number])
            for number in numbers
        }

    @staticmethod
    def _verdict(answer: Answer | None, reason: str, out: Path) -> str:
        if answer is None:
            return f"nothing: {reason}"
        if answer.get("ok") is not True:
            return str(answer.get("code"))
        try:
            digest = hashlib.sha256(out.read_bytes()).hexdigest()
        except OSError:
            return "accepted, but no arrays were written"
        return f"accepted {answer.get('splats')} splats, arrays {digest[:16]}"
