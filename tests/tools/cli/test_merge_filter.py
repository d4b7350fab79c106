"""merge and filter: which splats are left, and that nothing else of them changes."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from running import SPLATS, Run, SmallScene

import cogsplat
from cogsplat.codec.geometry.floaters import floaters
from cogsplat.codec.order.objects import labels_of
from cogsplat.codec.scoring import contribution as scoring
from cogsplat.codec.scoring.contribution import Scores
from cogsplat.codec.splats import Splats
from cogsplat.tools.lab.synthetic.terrace import synth


def same_rows(found: Splats, expected: Splats) -> None:
    for name in ("means", "scales", "quats", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)


@pytest.fixture
def labelled(tmp_path: Path) -> Path:
    """Return a scene of 300 splats whose attribute `row` numbers them."""
    path = tmp_path / "labelled.ply"
    cogsplat.write(replace(synth(300), extras={"row": np.arange(300, dtype="i4")}), path)
    return path


def test_merge_labels_each_scene_and_moves_it_as_convert_does(run: Run, tmp_path: Path) -> None:
    a, b, out, moved = (tmp_path / name for name in ("a.ply", "b.ply", "out.ply", "moved.ply"))
    cogsplat.write(synth(120), a)
    cogsplat.write(synth(80), b)
    edits = {"--scale": "2", "--rotate": "0,90,30", "--translate": "5,0,-3"}
    options = [word for option, value in edits.items() for word in (option, f"2:{value}")]
    told = run("merge", a, b, out, *options, "--json")
    assert (told.code, told.err) == (0, "")
    assert told.json["splats"] == 200
    assert told.json["objects"] == [
        {"object": 1, "source": str(a), "source_splats": 120},
        {"object": 2, "source": str(b), "source_splats": 80},
    ]
    plain = [word for option, value in edits.items() for word in (option, value)]
    assert run("convert", b, moved, *plain).code == 0
    merged = cogsplat.read(out)
    np.testing.assert_array_equal(labels_of(merged), np.repeat([1, 2], [120, 80]))
    same_rows(merged[:120], cogsplat.read(a))
    same_rows(merged[120:], cogsplat.read(moved))


def test_a_merged_scene_is_decoded_by_object(run: Run, small: SmallScene, tmp_path: Path) -> None:
    both, cogs, one = tmp_path / "both.ply", tmp_path / "both.cogs", tmp_path / "one.ply"
    assert run("merge", small.ply, small.ply, both, "--translate", "2:40,0,0").code == 0
    told = run(
        "encode", both, cogs, "--objects", "--cameras", small.cameras, "--no-prune", "--quiet"
    )
    assert told.code == 0, told.err
    assert run("decode", cogs, one, "--object", 2).code == 0
    found = cogsplat.read(one)
    assert len(found) == SPLATS
    x = cogsplat.read(small.ply).means[:, 0].astype(np.float64).mean() + 40
    assert found.means[:, 0].mean() == pytest.approx(x, abs=0.05)


@pytest.mark.usefixtures("few_planned_views")
def test_merging_into_cogs_cuts_chunks_by_object(run: Run, tmp_path: Path) -> None:
    a, both, one = tmp_path / "a.ply", tmp_path / "both.cogs", tmp_path / "one.ply"
    cogsplat.write(synth(400), a)
    told = run("merge", a, a, both, "--translate", "2:40,0,0", "--json")
    assert told.code == 0, told.err
    with cogsplat.open(both) as file:
        assert set(file.chunks.object.tolist()) == {1, 2}
    assert run("decode", both, one, "--object", 2).code == 0
    found = cogsplat.read(one)
    assert set(labels_of(found)) == {2}
    assert found.means[:, 0].min() > cogsplat.read(a).means[:, 0].min() + 30


def test_labels_of_parts_give_way_with_a_warning(run: Run, tmp_path: Path) -> None:
    a, out = tmp_path / "a.ply", tmp_path / "out.ply"
    cogsplat.write(replace(synth(5), extras={"object": np.full(5, 9, "u1")}), a)
    told = run("merge", a, a, out)
    assert told.code == 0
    assert "object labels are replaced" in told.err
    assert set(labels_of(cogsplat.read(out)).tolist()) == {1, 2}


def test_filter_keeps_what_the_values_say(run: Run, labelled: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.ply"
    scene = cogsplat.read(labelled)
    opacity = 1 / (1 + np.exp(-scene.opacities.astype(np.float64)))
    size = np.exp(scene.scales.astype(np.float64)).max(axis=1)
    least, small, large = np.quantile(opacity, 0.2), np.quantile(size, 0.1), np.quantile(size, 0.9)
    x = float(np.median(scene.means[:, 0]))
    keep = (opacity >= least) & (size >= small) & (size <= large) & (scene.means[:, 0] >= x)
    told = run(
        "filter", labelled, out, "--min-opacity", least, "--min-size", small, "--max-size", large,
        "--crop", f"{x},-1e9,-1e9,1e9,1e9,1e9", "--json",
    )  # fmt: skip
    assert (told.code, told.err) == (0, "")
    found = cogsplat.read(out)
    np.testing.assert_array_equal(found.extras["row"], np.flatnonzero(keep))
    same_rows(found, scene.take(keep))
    assert told.json["splats"] == keep.sum()
    assert told.json["left_out"] == {
        "invalid": 0,
        "min-opacity": int((opacity < least).sum()),
        "min-size": int((size < small).sum()),
        "max-size": int((size > large).sum()),
        "crop": int((scene.means[:, 0] < x).sum()),
    }


def test_filter_takes_floaters(run: Run, small: SmallScene, tmp_path: Path) -> None:
    scene = cogsplat.read(small.ply)
    lost = replace(scene[:1], means=np.array([[0.0, 900.0, 0.0]], np.float32))
    source, out = tmp_path / "dirty.ply", tmp_path / "clean.ply"
    means = np.concatenate([scene.means, lost.means])
    cogsplat.write(replace(scene.take(np.arange(SPLATS + 1) % SPLATS), means=means), source)
    told = run("filter", source, out, "--floaters", 8, "--cameras", small.cameras)
    assert told.code == 0, told.err
    assert "floaters" in told.out
    found = cogsplat.read(out)
    assert found.means[:, 1].max() < 900
    assert len(found) >= 0.98 * SPLATS


def highest(contribution: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """Return the rows of the `count` largest contributions, in the order of the file."""
    return np.sort(np.argsort(-contribution, kind="stable")[:count])


def test_filter_keeps_the_largest_contributions(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out, scores = tmp_path / "out.ply", tmp_path / "scores.npy"
    common = ["--cameras", small.cameras]
    told = run("filter", small.ply, out, "--keep", "25%", *common, "--json")
    assert (told.code, told.err) == (0, "")
    assert run("lab score", small.ply, scores, *common).code == 0
    contribution = np.load(scores)
    rows = highest(contribution, -(-SPLATS // 4))
    same_rows(cogsplat.read(out), cogsplat.read(small.ply).take(rows))
    share = contribution[rows].sum() / contribution.sum()
    assert told.json["kept_share_of_contribution"] == pytest.approx(share, abs=1e-5)
    assert told.json["left_out"] == {"invalid": 0, "keep": SPLATS - len(rows)}


def test_filter_keeps_a_number_of_what_other_limits_leave(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    """Contributions are those without the splats that were left out, which hid others."""
    half, once, twice = (tmp_path / name for name in ("half.ply", "once.ply", "twice.ply"))
    large = ["--max-size", np.exp(np.median(cogsplat.read(small.ply).scales.max(axis=1)))]
    keep = ["--keep", 300, "--cameras", small.cameras, "--json"]
    told = run("filter", small.ply, once, *large, *keep)
    assert run("filter", small.ply, half, *large).code == 0
    expected = run("filter", half, twice, *keep)
    assert (told.code, expected.code) == (0, 0)
    assert once.read_bytes() == twice.read_bytes()
    assert told.json["kept_share_of_contribution"] == expected.json["kept_share_of_contribution"]
    left = len(cogsplat.read(half))
    assert told.json["left_out"] == {"invalid": 0, "max-size": SPLATS - left, "keep": left - 300}


def test_floaters_and_the_largest_contributions_are_found_in_one_pass(
    run: Run, small: SmallScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out.ply"
    passes: list[Scores] = []
    score = scoring.score

    def counted(*values: Any, **named: Any) -> Scores:
        passes.append(score(*values, **named))
        return passes[-1]

    monkeypatch.setattr(scoring, "score", counted)
    common = ["--floaters", 1, "--keep", 300, "--cameras", small.cameras, "--json"]
    told = run("filter", small.ply, out, *common)
    assert (told.code, len(passes)) == (0, 1)
    scene = cogsplat.read(small.ply)
    left = ~floaters(scene.means, passes[0].contribution, 1)
    assert told.json["left_out"] == {
        "invalid": 0, "floaters": int((~left).sum()), "keep": int(left.sum()) - 300,
    }  # fmt: skip
    rows = np.flatnonzero(left)[highest(passes[0].contribution[left], 300)]
    same_rows(cogsplat.read(out), scene.take(rows))
    # Without the splats that another limit leaves out, the rest is scored anew.
    assert run("filter", small.ply, out, "--min-opacity", 0.2, *common, "--force").code == 0
    assert [len(scores.contribution) < SPLATS for scores in passes] == [False, False, True]


def test_keeping_without_rendering_goes_by_volume_and_opacity(
    run: Run, labelled: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.ply"
    told = run("filter", labelled, out, "--keep", 40, "--by", "antimatter", "--json")
    assert (told.code, told.err) == (0, "")
    assert told.json["kept_share_of_contribution"] is None
    scene = cogsplat.read(labelled)
    volume = np.exp(scene.scales.astype(np.float64).sum(axis=1))
    weight = volume / (1 + np.exp(-scene.opacities.astype(np.float64)))
    rows = np.sort(np.argsort(-weight)[:40])
    np.testing.assert_array_equal(cogsplat.read(out).extras["row"], rows)
    more = run("filter", labelled, out, "--keep", 9999, "--force")
    assert (more.code, len(cogsplat.read(out))) == (0, 300)
    assert "300 splats left, fewer than" in more.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["merge", "SCENE", "out.ply"], "two scenes or more"),
        (["merge", "SCENE", "SCENE", "out.ply", "--scale", "3:2"], "from 1 to 2"),
        (["merge", "SCENE", "SCENE", "out.ply", "--translate", "1,2,3"], "number of a scene"),
        (["filter", "SCENE", "out.ply"], "nothing to leave out"),
        (["filter", "SCENE", "out.ply", "--min-opacity", "2"], "min-opacity"),
        (
            ["filter", "SCENE", "out.ply", "--min-size", "1", "--cameras", "SCENE"],
            "COGS output, --floaters or --keep",
        ),
        (
            ["filter", "SCENE", "out.ply", "--keep", "9", "--by", "antimatter", "--cameras", "x"],
            "COGS output, --floaters or --keep",
        ),
        (["filter", "SCENE", "out.ply", "--min-size", "1", "--by", "antimatter"], "without --keep"),
        (["filter", "SCENE", "out.ply", "--keep", "0"], "expected splats such as"),
        (["filter", "SCENE", "out.jpg", "--keep", "10"], "out.jpg"),
    ],
)
def test_misuse_is_told(
    run: Run, labelled: Path, tmp_path: Path, words: list[str], said: str
) -> None:
    places = {"SCENE": labelled, "out.ply": tmp_path / "out.ply", "out.jpg": tmp_path / "out.jpg"}
    told = run(*(places.get(word, word) for word in words))
    assert told.code == 2
    assert said in told.err


def test_inputs_are_kept_and_nothing_left_is_refused(
    run: Run, labelled: Path, tmp_path: Path
) -> None:
    before = labelled.read_bytes()
    for words, rest in ((["merge", labelled], []), (["filter"], ["--min-size", "0.1"])):
        assert run(*words, labelled, labelled, *rest, "--force").code in (2, 4)
    assert labelled.read_bytes() == before
    out = tmp_path / "out.ply"
    told = run("filter", labelled, out, "--min-size", "1e9")
    assert (told.code, out.exists()) == (3, False)
    assert "nothing-left" in told.err
    told = run("merge", labelled, tmp_path / "absent.ply", out)
    assert told.code == 4
