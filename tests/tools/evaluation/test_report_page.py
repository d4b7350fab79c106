import base64
import io
from html import escape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from running import SPLATS, Run, SmallScene

import cogsplat
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.scoring import view_quality
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.tools.evaluation.byte_inventory import stored_sizes
from cogsplat.tools.evaluation.prefix_quality import PREFIX_FRACTIONS, decode_fraction, measure
from cogsplat.tools.pictures.png import to_image, write_png

# Tags that HTML leaves open.
_VOID = {"meta", "img", "link", "br", "hr", "input"}


class Balanced(HTMLParser):
    """Check that every tag is closed, and collect what the page would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.fetched: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in _VOID:
            self.open.append(tag)
        self.fetched += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def photos(small: SmallScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Renders of the source as if they had been taken of the real thing."""
    folder = tmp_path_factory.mktemp("photos")
    scene = cogsplat.read(small.ply)
    for camera in cogsplat.read_cameras(small.cameras):
        path = folder / camera.name
        # Names of cameras made up here have no extension: PNG all the same.
        write_png(to_image(render(scene, camera)), path)
    return folder


def test_a_report_stands_alone(run: Run, small: SmallScene, photos: Path, tmp_path: Path) -> None:
    out, page = tmp_path / "a&b.cogs", tmp_path / "report.html"
    result = run(
        "encode", small.ply, out, "--cameras", small.cameras, "--eval-every", 4, "--report", page,
        "--images", photos, "--preset", "fast", "--json",
    )  # fmt: skip
    assert (result.code, result.err) == (0, "")
    text = page.read_text()
    parser = Balanced()
    parser.feed(text)
    assert parser.open == []
    assert all(link.startswith("data:image/png;base64,") for link in parser.fetched)
    # Three views three times, and one as the bytes arrive.
    assert len(parser.fetched) == 9 + len(PREFIX_FRACTIONS)
    for link in parser.fetched:
        data = base64.b64decode(link.removeprefix("data:image/png;base64,"))
        with Image.open(io.BytesIO(data)) as image:
            assert image.size == (64, 48)
    assert "a&amp;b.cogs" in text
    assert "url(" not in text
    assert "<script" not in text
    whole = result.json["prefixes"][-1]  # type: ignore[index]
    for figure in (f"{whole['held_out_db']:.2f} dB", f"{whole['photos_db']:.2f} dB"):
        assert figure in text
    with cogsplat.open(out) as file:
        for count in file.chunks.splats:
            assert f"<td>{count:,}</td>" in text
        sizes = stored_sizes(file)
    assert sum(size.stored_bytes for size in sizes) == out.stat().st_size
    for size in sizes:
        names = f"<td class=l>{size.segment}</td><td class=l>{escape(size.label)}</td>"
        assert f"{names}<td>{size.stored_bytes:,}</td>" in text
    assert "never given to the encoder" in text


def test_the_summary_shows_quality_at_several_lengths(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    arguments = ["encode", small.ply, tmp_path / "o.cogs", "--cameras", small.cameras]
    result = run(*arguments, "--eval-every", 4, "--measure")
    assert result.code == 0
    assert all(f"{share:.0%}" in result.out for share in PREFIX_FRACTIONS)
    assert "roam" in result.out
    assert "bits/splat" in result.out
    plain = run(*arguments, "--force")
    assert "roam" not in plain.out


def test_measures_agree_with_compare(small: SmallScene) -> None:
    source = cogsplat.read(small.ply)
    cameras = hold_out(cogsplat.read_cameras(small.cameras), 4)[1]
    found = measure(small.cogs, source, cameras)
    size = small.cogs.stat().st_size
    assert [q.size_bytes for q in found] == [int(share * size) for share in PREFIX_FRACTIONS]
    splats = [q.splats for q in found]
    assert splats == sorted(splats)
    whole = view_quality.compare(source, cogsplat.decode(small.cogs), cameras)
    assert found[-1].held_out_db == view_quality.mean_psnr_db(whole.test)
    assert found[-1].worst_db == whole.worst.psnr_db
    assert found[-1].roam_ssim == view_quality.mean_ssim(whole.roaming)
    assert found[-1].photos_db is None


def test_a_share_is_what_the_first_bytes_hold(small: SmallScene) -> None:
    assert len(decode_fraction(small.cogs, 0.001)) == 0
    half = decode_fraction(small.cogs, 0.5)
    expected = cogsplat.decode(small.cogs, size_bytes=small.cogs.stat().st_size // 2)
    np.testing.assert_array_equal(half.means, expected.means)
    np.testing.assert_array_equal(half.shN, expected.shN)


def test_reports_are_refused_before_any_work(run: Run, small: SmallScene, tmp_path: Path) -> None:
    out, page = tmp_path / "o.cogs", tmp_path / "there.html"
    page.write_text("mine")
    result = run("encode", small.ply, out, "--cameras", small.cameras, "--report", page)
    assert result.code == 2
    assert "[exists]" in result.err
    assert page.read_text() == "mine"
    assert not out.exists()
    result = run("encode", small.ply, out, "--cameras", small.cameras, "--images", tmp_path)
    assert result.code == 4
    assert not out.exists()


# Targets and presets, from the command line.


def test_a_size_is_met_by_the_whole_file(run: Run, small: SmallScene, tmp_path: Path) -> None:
    for wanted, limit in (("40KB", 40_000), ("8%", small.ply.stat().st_size * 8 // 100)):
        out = tmp_path / f"{limit}.cogs"
        arguments = ["--cameras", small.cameras, "--target-size", wanted, "--no-prune", "--json"]
        result = run("encode", small.ply, out, *arguments)
        assert result.code == 0, result
        assert result.json["bytes"] == out.stat().st_size
        assert 0.97 * limit <= out.stat().st_size <= limit


def test_a_target_psnr_is_met_in_the_views_of_compare(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "o.cogs"
    arguments = ["--cameras", small.cameras, "--target-psnr", 34, "--no-prune", "--json"]
    result = run("encode", small.ply, out, *arguments)
    assert result.code == 0, result
    assert result.json["predicted_psnr_db"] == pytest.approx(34, abs=0.1)
    seen = run("compare", small.ply, out, "--cameras", small.cameras, "--json").json["test"]
    assert seen["psnr_db"] == pytest.approx(34, abs=0.1)  # type: ignore[index]


def test_chunks_say_what_they_show(small: SmallScene) -> None:
    with cogsplat.open(small.cogs) as file:
        quality = file.chunks.quality
        assert len(quality) == file.num_chunks
        assert (quality > 5).all()
        assert quality[-1] == quality.max()
        assert int(file.chunks.splats.sum()) <= SPLATS


@pytest.mark.parametrize(
    "arguments",
    [
        ["--target-psnr", 30, "--target-size", "1MB"],
        ["--target-psnr", 30, "--quality", 30],
        ["--target-size", "1MB", "--profile", "near-lossless"],
        ["--target-psnr", 3],
        ["--target-size", "0.1B"],
        ["--preset", "slow"],
    ],
)
def test_aims_that_contradict_are_misuse(
    run: Run, small: SmallScene, tmp_path: Path, arguments: list[object]
) -> None:
    assert run("encode", small.ply, tmp_path / "o.cogs", *arguments).code == 2
    assert list(tmp_path.iterdir()) == []


def test_the_report_has_the_prediction_close_up(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    page = tmp_path / "r.html"
    arguments = ["--cameras", small.cameras, "--preset", "fast", "--report", page]
    assert run("encode", small.ply, tmp_path / "o.cogs", *arguments).code == 0
    text = page.read_text(encoding="utf-8")
    assert "left out of the given cameras" in text
    assert "from 40% of the distance" in text


def test_a_size_too_small_is_refused(run: Run, small: SmallScene, tmp_path: Path) -> None:
    arguments = ["--cameras", small.cameras, "--target-size", 900]
    result = run("encode", small.ply, tmp_path / "o.cogs", *arguments)
    assert result.code == 3
    assert "[target-out-of-reach]" in result.err
    assert "splats would fit" in result.err
    assert "`cogsplat tune`" in result.err
    assert "`cogsplat filter --keep`" in result.err
    assert list(tmp_path.iterdir()) == []
