"""Decoders are compared over mutants; ours, in two languages, say the same of all of them."""

import os
import shlex
import sys
from pathlib import Path

import pytest
from mutants import VECTORS
from running import broken_decoder, installed

from cogsplat.codec.errors import StorageError
from cogsplat.tools.lab.conformance.differential import fuzz, vector_files

COUNT = int(os.environ.get("COGSPLAT_FUZZ", "200"))
"""Mutants; CI makes more of them, and ``cogsplat lab conformance fuzz`` any number."""


def ours(kind: str) -> list[str]:
    return [sys.executable, "-m", "cogsplat.tools.lab.conformance.decoder", kind]


@pytest.mark.slow
def test_all_our_decoders_say_the_same_of_every_mutant(web_package: Path) -> None:
    web = [installed("node"), str(web_package / "scripts" / "conformance_decoder.mjs")]
    commands = [ours("numpy"), web, ours("reference")]
    report = fuzz(commands, vector_files(VECTORS), seed=2, count=COUNT)
    assert [(d.number, d.verdicts) for d in report.disagreements] == []
    assert report.mutants == sum(report.verdicts.values()) == COUNT
    assert report.verdicts["accepted"] > COUNT / 10
    assert report.peak_memory[0] < 1 << 30


@pytest.mark.parametrize(
    "fault",
    [
        # Another code, another bit, and nothing at all.
        "answer.update(code='file-trailing') if answer.get('code') == 'root-crc' else None",
        "open(request['out'], 'ab').write(b'0') if answer.get('ok') else None",
        "sys.exit(3) if answer.get('code') == 'root-truncated' else None",
    ],
)
def test_a_decoder_that_differs_is_found(tmp_path: Path, fault: str) -> None:
    commands = [ours("numpy"), shlex.split(broken_decoder(tmp_path, fault))]
    report = fuzz(commands, vector_files(VECTORS), seed=1, count=60)
    assert report.disagreements
    for case in report.disagreements:
        assert case.verdicts[0] != case.verdicts[1]
    again = fuzz(
        commands, vector_files(VECTORS), seed=1, count=1, first=report.disagreements[0].number
    )
    assert again.disagreements[0].mutant == report.disagreements[0].mutant


def test_readers_may_differ_where_only_verifiers_must_refuse(tmp_path: Path) -> None:
    fault = "answer.update(ok=False, code='zstd-frame') if answer.get('ok') and {} else None"
    for asked, differs in (("not request['verify']", False), ("request['verify']", True)):
        strict = shlex.split(broken_decoder(tmp_path, fault.format(asked)))
        report = fuzz([ours("numpy"), strict], vector_files(VECTORS), seed=1, count=24)
        assert bool(report.disagreements) == differs
        assert report.verdicts["accepted"]


def test_a_decoder_that_hangs_has_said_something_else(tmp_path: Path) -> None:
    hangs = broken_decoder(tmp_path, "time.sleep(60) if 'path' in request else None")
    commands = [ours("numpy"), shlex.split(hangs)]
    report = fuzz(commands, vector_files(VECTORS), seed=1, count=1, timeout_s=10.0)
    ((case),) = report.disagreements
    assert case.verdicts[1].startswith("nothing: no answer within 10 s")


def test_a_decoder_for_valid_files_is_asked_about_what_the_others_read() -> None:
    commands = [ours("numpy"), ours("reference")]
    report = fuzz(commands, vector_files(VECTORS), seed=4, count=80)
    assert report.disagreements == []
    assert [decoder.refuses for decoder in report.decoders] == [True, False]


def test_folders_without_vectors_are_said(tmp_path: Path) -> None:
    with pytest.raises(StorageError) as refused:
        vector_files(tmp_path)
    assert refused.value.code == "not-found"
    assert shlex.quote(str(tmp_path)) in refused.value.message
