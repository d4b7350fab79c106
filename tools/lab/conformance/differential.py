"""Differential fuzzing: several decoders decode seeded mutants of files and must agree.

Agreement means the same reason code, or the same bits in all arrays. A decoder that does not refuse
invalid files decodes only the mutants that all other decoders accept.
"""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cogsplat.codec.errors import StorageError
from cogsplat.codec.progress import Progress, silent

from .file_mutations import Mutant, make_mutant
from .protocol import Answer, DecoderProcess, Hello, decode_request

# Largest mutant, in splats, for decoders that refuse nothing: the reference decoder is slow.
_MOST_SPLATS_FOR_SLOW: Final = 2000


@dataclass(frozen=True)
class Disagreement:
    """A mutant that two decoders judge differently.

    Parameters
    ----------
    number : int
        Number of the mutant in its run.
    mutant : Mutant
    verify : bool
        Whether the requests included a verifier's checks.
    verdicts : tuple of str
        Verdict of each decoder: a reason code, or splat count and hash of its arrays.
    """

    number: int
    mutant: Mutant
    verify: bool
    verdicts: tuple[str, ...]


@dataclass(frozen=True)
class FuzzReport:
    """Result of a fuzzing run.

    Parameters
    ----------
    decoders : tuple of Hello
    peak_memory : tuple of int
        Peak resident memory of each decoder, bytes; 0 where the system does not report it.
    mutants : int
        Number of mutants.
    verdicts : dict of str to int
        Count of each reason code of the first decoder, and of ``accepted``.
    slowest_s : float
        Longest time until all decoders had answered for a mutant, seconds.
    disagreements : list of Disagreement
    """

    decoders: tuple[Hello, ...]
    peak_memory: tuple[int, ...]
    mutants: int
    verdicts: dict[str, int]
    slowest_s: float
    disagreements: list[Disagreement]


def vector_files(vectors: Path) -> list[tuple[str, bytes]]:
    """Return names and bytes of the valid conformance files.

    Raises
    ------
    StorageError
        ``not-found``: the folder holds none.
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
    """Decode mutants ``first`` to ``first + count - 1`` of a seeded run with several decoders.

    Parameters
    ----------
    commands : sequence of sequence of str
        Program and arguments of each decoder; see `protocol` for what they read and write.
    files : sequence of (str, bytes)
        Names and bytes of the valid files that mutants are made from.
    seed : int
        Seed of the run.
    count : int
        Number of mutants.
    first : int
        Number of the first mutant.
    timeout_s : float
        Time limit for one answer, seconds; exceeding it counts as a disagreement.
    progress : Progress
        Called with ``("mutants", mutants done, mutants)``.

    Returns
    -------
    FuzzReport

    Raises
    ------
    StorageError
        ``decoder``: a decoder cannot be started.
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
            peak_memory=tuple(decoder.peak_memory() for decoder in decoders),
            mutants=count,
            verdicts=dict(verdicts.most_common()),
            slowest_s=slowest,
            disagreements=disagreements,
        )


class _Decoders:
    """Decoders of a run; the decoders that do not refuse invalid files decode last."""

    def __init__(self, decoders: Sequence[DecoderProcess], folder: Path) -> None:
        self._decoders = decoders
        self.hellos = tuple(decoder.hello() for decoder in decoders)
        self._path = folder / "mutant.cogs"
        self._outs = [folder / f"arrays-{number}.f32" for number in range(len(decoders))]
        self._strict = [n for n, hello in enumerate(self.hellos) if hello.refuses]
        self._lenient = [n for n, hello in enumerate(self.hellos) if not hello.refuses]
        self._verifiers = all(self.hellos[n].level == "verifier" for n in self._strict)

    def verdicts(self, mutant: Mutant, *, verify: bool) -> tuple[str, ...]:
        """Return the verdict of each decoder on a mutant; "" for one that did not decode it."""
        self._path.write_bytes(mutant.data)
        found = [""] * len(self._decoders)
        verify = verify and self._verifiers
        answers = self._ask(self._strict, mutant, verify=verify)
        if not verify and self._verifiers and self._may_differ(answers):
            # Readers may leave to verifiers how Huffman streams end (SPEC 6.3).
            answers = self._ask(self._strict, mutant, verify=True)
        for number, verdict in answers.items():
            found[number] = verdict
        agreed = set(answers.values())
        # Decoders that do not refuse invalid files get only mutants that a verifier accepts.
        if verify and len(agreed) == 1 and self._is_small_and_whole(agreed.pop(), mutant):
            for number, verdict in self._ask(self._lenient, mutant, verify=False).items():
                found[number] = verdict
        return tuple(found)

    @staticmethod
    def _may_differ(answers: Mapping[int, str]) -> bool:
        """Tell whether verdicts are only ``accepted`` and ``zstd-frame``, and both occur."""
        return {verdict.split()[0] for verdict in answers.values()} == {"accepted", "zstd-frame"}

    def _is_small_and_whole(self, verdict: str, mutant: Mutant) -> bool:
        """Tell whether a mutant was accepted, is whole, and is small enough for slow decoders."""
        word, *rest = verdict.split()
        return word == "accepted" and not mutant.partial and int(rest[0]) <= _MOST_SPLATS_FOR_SLOW

    def _ask(self, numbers: Sequence[int], mutant: Mutant, *, verify: bool) -> dict[int, str]:
        """Let decoders of given numbers decode a mutant; return the verdict of each by number."""
        # All requests are sent before the first answer is read, so that decoders run in parallel.
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
        """Return the verdict of an answer: reason code, or splat count and hash of the arrays."""
        if answer is None:
            return f"nothing: {reason}"
        if answer.get("ok") is not True:
            return str(answer.get("code"))
        try:
            digest = hashlib.sha256(out.read_bytes()).hexdigest()
        except OSError:
            return "accepted, but no arrays were written"
        return f"accepted {answer.get('splats')} splats, arrays {digest[:16]}"
