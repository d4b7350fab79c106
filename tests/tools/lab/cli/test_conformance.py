"""conformance run: our own decoders pass, broken ones fail the clause that they break."""

import queue
import shlex
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from running import Run, broken_decoder

from cogsplat.tools.lab.conformance import protocol
from cogsplat.tools.lab.conformance.decoder import KINDS


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_our_decoders_pass_all_vectors(run: Run, kind: str) -> None:
    decoder = shlex.join([sys.executable, "-m", "cogsplat.tools.lab.conformance.decoder", kind])
    told = run("lab conformance", "run", "--decoder", decoder, "--json")
    assert told.code == 0, told.out
    assert told.json["failed"] == 0
    passed = told.json["passed"]
    assert isinstance(passed, int)
    assert passed > (500 if kind != "reference" else 100)


@pytest.mark.parametrize(
    ("fault", "clause"),
    [
        # One bit of one value.
        (
            "if request.get('refine') and answer.get('splats'):\n"
            "        data = bytearray(open(request['out'], 'rb').read()); data[0] ^= 1\n"
            "        open(request['out'], 'wb').write(data)",
            "6.4",
        ),
        # The right verdict with the wrong code.
        ("answer.update(code='zstd-frame') if not answer.get('ok', True) else None", "5.3"),
        # What is broken is taken.
        ("answer = answer if answer.get('ok', True) else {'ok': True}", "5.3"),
        # Refinements are never applied.
        (
            "request.update(refine=False); "
            "answer = decoder.answer_request('numpy', request) if 'path' in request else answer",
            "7.4",
        ),
        # A cut file is refused.
        ("answer = {'ok': False, 'code': 'file-truncated'} if request.get('partial') else answer",
         "8.2"),
        # Splats are thicker than they were trained.
        (
            "answer = decoder.answer_request('reference', {**request, 'path': "
            "request['path'].replace('viewpoint.cogs', 'kernel.cogs')}) "
            "if request['op'] == 'draw' else answer",
            "8.7",
        ),
        # A picture of no pixels.
        ("open(request['out'], 'wb').close() if request['op'] == 'draw' else None", "8.7"),
        # Nothing is written.
        ("open(request['out'], 'wb').close() if answer.get('splats') else None", "6.4"),
        # The decoder dies.
        ("sys.exit(3) if answer.get('splats') else None", "6.4"),
    ],
)  # fmt: skip
def test_a_broken_decoder_fails_the_clause_that_it_breaks(
    run: Run, tmp_path: Path, few_vectors: Path, fault: str, clause: str
) -> None:
    decoder = broken_decoder(tmp_path, fault)
    told = run("lab conformance", "run", "--decoder", decoder, "--vectors", few_vectors, "--json")
    assert told.code == 3, told.err
    clauses = told.json["clauses"]
    assert isinstance(clauses, dict)
    broken = {name for name, sums in clauses.items() if sums["passed"] < sums["checks"]}
    assert clause in broken


def test_people_are_told_the_clause(run: Run, tmp_path: Path, few_vectors: Path) -> None:
    decoder = broken_decoder(tmp_path, "sys.exit(3) if answer.get('splats') else None")
    human = run("lab conformance", "run", "--decoder", decoder, "--vectors", few_vectors)
    assert human.code == 3
    assert "SPEC 6.4" in human.out or ", 6.4" in human.out


@pytest.mark.parametrize(
    ("told", "brightness", "code"),
    [
        ({}, 1.0, 0),
        ({}, 1.005, 3),
        # A viewer may be off by that.
        ({"level": "viewer"}, 1.005, 0),
        ({"level": "viewer"}, 1.2, 3),
        # Without the key, no picture is asked for.
        ({"draws": False}, 0.0, 0),
    ],
)
def test_pictures_are_compared_by_the_level(
    run: Run, tmp_path: Path, few_vectors: Path,
    told: dict[str, object], brightness: float, code: int,
) -> None:  # fmt: skip
    decoder = broken_decoder(
        tmp_path,
        "import numpy\n"
        "    if request['op'] == 'draw':\n"
        f"        numpy.multiply({brightness}, numpy.fromfile(request['out'], '<f4'), "
        "dtype='<f4').tofile(request['out'])\n"
        f"    answer.update({told!r} if request['op'] == 'hello' else {{}})",
    )
    found = run("lab conformance", "run", "--decoder", decoder, "--vectors", few_vectors, "--json")
    assert found.code == code, found.out
    assert ("8.7" in found.json["clauses"]) == told.get("draws", True)  # type: ignore[operator]
    if code and not told:
        assert "where the picture has" in found.out


def test_a_decoder_that_hangs_fails(
    run: Run, tmp_path: Path, few_vectors: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hanging = tmp_path / "hanging"

    class PatientQueue(queue.Queue[str | None]):
        """Answers of a decoder, with the time limit only while the decoder hangs.

        A busy machine may take longer than the limit for an answer that comes.
        """

        def get(self, block: bool = True, timeout: float | None = None) -> str | None:
            assert timeout == 0.2
            while True:
                has_hung = hanging.exists()
                try:
                    return super().get(block, timeout)
                except queue.Empty:
                    if has_hung:
                        hanging.unlink()
                        raise

    found = SimpleNamespace(Queue=PatientQueue, Empty=queue.Empty)
    monkeypatch.setattr(protocol, "queue", found)
    decoder = broken_decoder(
        tmp_path,
        f"(open({str(hanging)!r}, 'w').close(), time.sleep(600)) if request.get('partial') "
        "else None",
    )
    told = run(
        "lab conformance", "run", "--decoder", decoder, "--vectors", few_vectors,
        "--timeout", "0.2", "--json",
    )  # fmt: skip
    assert told.code == 3
    assert "no answer within 0.2 s" in told.out


def test_what_is_no_decoder_is_said(run: Run, tmp_path: Path, few_vectors: Path) -> None:
    for decoder in ("/nothing/here", shlex.join([sys.executable, "-c", "print('hello')"])):
        told = run("lab conformance", "run", "--decoder", decoder, "--vectors", few_vectors)
        assert told.code == 4
        assert "decoder" in told.err
    told = run("lab conformance", "run", "--decoder", "true", "--vectors", tmp_path / "none")
    assert told.code == 4
    assert "manifest.json" in told.err


def test_decoders_are_compared_over_mutants(run: Run, tmp_path: Path, few_vectors: Path) -> None:
    ours = shlex.join([sys.executable, "-m", "cogsplat.tools.lab.conformance.decoder", "numpy"])
    extra = next((few_vectors / "valid").glob("*.cogs"))
    told = run(
        "lab conformance", "fuzz", "--decoder", ours, "--decoder", ours, "--vectors", few_vectors,
        "--count", "30", extra,
    )  # fmt: skip
    assert told.code == 0, told.err
    assert "30 mutants" in told.out
    assert "0 disagreements" in told.out
    worse = broken_decoder(tmp_path, "answer.update(code='not-cogs') if 'code' in answer else None")
    arguments = (
        "lab conformance", "fuzz", "--decoder", ours, "--decoder", worse, "--vectors", few_vectors,
        "--count", "30",
    )  # fmt: skip
    told = run(*arguments, "--json", "--keep", tmp_path / "kept")
    assert told.code == 3
    found = told.json["disagreements"]
    assert isinstance(found, list)
    assert {f"1-{case['number']}.cogs" for case in found} == {
        path.name for path in (tmp_path / "kept").iterdir()
    }
    human = run(*arguments)
    assert human.code == 3
    assert ": not-cogs" in human.out


def test_one_decoder_alone_is_not_compared(run: Run) -> None:
    told = run("lab conformance", "fuzz", "--decoder", "true")
    assert told.code == 2
    assert "two or more" in told.err
