"""Beginnings of files that make up for what they lack, by the command line and in Python."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from running import Run, SmallScene

import cogsplat
from cogsplat.codec.encode import pipeline
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.formats.cogs import scene_writer as cogs
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.storage.source import FileSource, PrefixSource


def test_the_first_chunks_are_as_the_file_says(small: SmallScene) -> None:
    with cogsplat.open(small.cogs) as file:
        compensation = file.compensation()
        assert compensation.layers
        for chunks in range(1, file.num_chunks + 1):
            stored = file.decode(range(chunks))
            found = file.decode(range(chunks), compensate=True)
            expected = compensation.apply(stored, chunks)
            np.testing.assert_array_equal(found.scales, expected.scales)
            np.testing.assert_array_equal(found.opacities, expected.opacities)
        assert not np.array_equal(file.decode([0], compensate=True).scales, file.decode([0]).scales)


def test_other_chunks_are_not_compensated(small: SmallScene) -> None:
    with cogsplat.open(small.cogs) as file, pytest.raises(ValueError, match="expected a prefix"):
        file.decode([1], compensate=True)
    with pytest.raises(ValueError, match="expected a prefix"):
        cogsplat.decode(small.cogs, chunks=(1, 2), compensate=True)


def test_layers_are_there_with_the_chunks_they_are_about(small: SmallScene) -> None:
    with cogsplat.open(small.cogs) as file:
        whole = file.compensation()
        ends = file.offsets + file.segments.length
        heads = ends[file.segments.kind == SegmentKind.HEAD].tolist()
    for chunks, end in enumerate(heads, start=1):
        source = PrefixSource(FileSource(small.cogs), end)
        with cogsplat.open(source, partial=True) as file:
            assert file.complete_chunks() == chunks
            found = file.compensation()
            if chunks < len(heads):
                these = np.arange(chunks), np.full(chunks, chunks)
                np.testing.assert_array_equal(found.shifts_of(*these), whole.shifts_of(*these))


def test_compensated_beginnings_are_nearer_to_the_whole(run: Run, small: SmallScene) -> None:
    def psnr(*more: object) -> float:
        told = run("compare", small.ply, small.cogs, "--cameras", small.cameras, *more, "--json")
        test = told.json["test"]
        assert isinstance(test, dict)
        return float(test["psnr_db"])

    for chunks in ("0:1", "0:2"):
        raw = psnr("--chunks", chunks)
        assert psnr("--chunks", chunks, "--compensate") > raw + 0.5
    assert psnr("--compensate") == psnr()


def test_decode_writes_what_compensation_makes_of_a_beginning(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "out.ply"
    told = run("decode", small.cogs, out, "--chunks", "0:2", "--compensate", "-q")
    assert (told.code, told.err) == (0, "")
    expected = cogsplat.decode(small.cogs, chunks=(0, 2), compensate=True)
    found = cogsplat.read(out)
    np.testing.assert_array_equal(found.scales, expected.scales)
    np.testing.assert_array_equal(found.opacities, expected.opacities)


@pytest.mark.parametrize("more", [("--chunks", "1:2"), ("--object", "0")])
def test_parts_that_begin_nowhere_are_misuse(
    run: Run, small: SmallScene, tmp_path: Path, more: tuple[str, str]
) -> None:
    told = run("decode", small.cogs, tmp_path / "out.ply", "--compensate", *more)
    assert told.code == 2
    assert "--compensate" in told.err


def test_a_foreign_scene_has_no_beginnings(run: Run, small: SmallScene, tmp_path: Path) -> None:
    told = run("render", small.ply, tmp_path / "a.png", "--compensate")
    assert told.code == 2


def test_encode_can_do_without(run: Run, small: SmallScene, tmp_path: Path) -> None:
    out = tmp_path / "plain.cogs"
    told = run("encode", small.ply, out, "--cameras", small.cameras, "--no-compensation", "-q")
    assert (told.code, told.err) == (0, "")
    with cogsplat.open(out) as file:
        assert not file.compensation().layers
        first = file.decode([0])
        assert file.decode([0], compensate=True).scales.tobytes() == first.scales.tobytes()


def test_a_size_as_target_holds_with_compensation(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "sized.cogs"
    target = ("--target-size", "40000", "--chunk-splats", "400")
    told = run("encode", small.ply, out, "--cameras", small.cameras, *target, "-q")
    assert (told.code, told.err) == (0, "")
    assert 39000 < out.stat().st_size <= 40000
    with cogsplat.open(out) as file:
        assert file.compensation().layers


@pytest.mark.slow
def test_a_preview_stands_in_the_first_chunks_alone(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    plain, opened = tmp_path / "plain.cogs", tmp_path / "opened.cogs"
    words = ["--cameras", small.cameras, "--preset", "fast", "-q"]
    for path, more in ((plain, []), (opened, ["--preview", 0.05])):
        told = run("encode", small.ply, path, *words, *more)
        assert told.code == 0, told.err
    assert 1.0 < opened.stat().st_size / plain.stat().st_size < 1.08
    with cogsplat.open(opened) as file:
        file.verify()
        ending = file.chunks.until > 0
        assert ending.any()
        shown = int(file.chunks.splats[ending].sum())
        first = file.decode(range(int(ending.sum())), compensate=True)
    assert len(first) == shown
    with cogsplat.open(plain) as file:
        whole = file.decode()
    np.testing.assert_array_equal(cogsplat.decode(opened).means, whole.means)


def test_a_part_is_compensated_where_its_preview_has_ended(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out, part = tmp_path / "ending.cogs", tmp_path / "part.ply"
    encoded = pipeline.encode(
        cogsplat.read(small.ply),
        EncodeRequest(
            cameras=cogsplat.read_cameras(small.cameras),
            config=EncodeConfig(chunk_splats=400),
            preset="fast",
        ),
    )
    first = replace(encoded.chunks[0], until=3)
    cogs.save(replace(encoded, chunks=[first, *encoded.chunks[1:]]), out, writer="a test")
    with cogsplat.open(out) as file:
        assert file.num_chunks > 3
        splats = int(file.chunks.splats[:3].sum())
        expected = file.compensation().apply(file.decode([1, 2]), 3, [1, 2])
        assert not np.array_equal(expected.scales, file.decode([1, 2]).scales)
    told = run("decode", out, part, "--splats", splats, "--compensate", "-q")
    assert told.code == 0, told.err
    np.testing.assert_array_equal(cogsplat.read(part).scales, expected.scales)


@pytest.mark.parametrize(
    "words",
    [
        ["--no-compensation"],
        ["--cells"],
        ["--profile", "near-lossless"],
        ["--memory", "4GiB"],
    ],
)
def test_what_a_preview_cannot_stand_in_is_misuse(
    run: Run, small: SmallScene, tmp_path: Path, words: list[str]
) -> None:
    told = run("encode", small.ply, tmp_path / "a.cogs", "--preview", 0.02, *words)
    assert (told.code, "a preview " in told.err) == (2, True)
