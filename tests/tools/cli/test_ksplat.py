"""Commands on a .ksplat, which is read only, laid out here as its viewer's description has it."""

import struct
from pathlib import Path

import numpy as np
import pytest
from running import SPLATS, Run, SmallScene

import cogsplat
from cogsplat.codec.geometry.sh import C0, COLOUR_OFFSET
from cogsplat.codec.splats import Splats


def level_0(splats: Splats) -> bytes:
    """Return a file of one section of floats, without SH above DC."""
    n = len(splats)
    row = np.dtype(
        [("means", "<f4", 3), ("scales", "<f4", 3), ("quats", "<f4", 4), ("rgba", "u1", 4)]
    )
    rows = np.zeros(n, row)
    rows["means"] = splats.means
    rows["scales"] = np.exp(splats.scales)
    rows["quats"] = splats.quats
    colours = splats.sh0 * C0 + COLOUR_OFFSET
    opacities = 1 / (1 + np.exp(-splats.opacities))
    rgba = np.concatenate([colours, opacities[:, None]], axis=1)
    rows["rgba"] = np.rint(255 * rgba.clip(0, 1)).astype(np.uint8)
    head = struct.pack("<BBxxIIIIHxx3f2f", 0, 1, 1, 1, n, n, 0, 0, 0, 0, -1.5, 1.5)
    part = struct.pack("<IIIIfHxxIIIIH", n, n, 0, 0, 0.0, 0, 0, n * row.itemsize, 0, 0, 0)
    return head.ljust(4096, b"\0") + part.ljust(1024, b"\0") + rows.tobytes()


@pytest.fixture(scope="module")
def ksplat(small: SmallScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ksplat") / "scene.ksplat"
    path.write_bytes(level_0(cogsplat.read(small.ply)))
    return path


def test_info_and_statistics(run: Run, ksplat: Path) -> None:
    report = run("info", ksplat, "--json").json
    assert (report["format"], report["splats"]) == ("ksplat", SPLATS)
    assert report["bytes"] == ksplat.stat().st_size
    report = run("info", ksplat, "--json", "--statistics").json["statistics"]
    assert (report["splats"], report["sh_degree"]) == (SPLATS, 0)
    assert report["invalid_splats"] == 0


def test_compare_and_render(run: Run, small: SmallScene, ksplat: Path, tmp_path: Path) -> None:
    plain = tmp_path / "plain.ply"
    assert run("convert", small.ply, plain, "--sh", 0).code == 0
    told = run("compare", plain, ksplat, "--cameras", small.cameras, "--json")
    assert told.code == 0
    assert told.json["test"]["psnr_db"] > 35
    out = tmp_path / "a.png"
    assert run("render", ksplat, out, "--cameras", small.cameras, "--view", 1).code == 0
    assert out.read_bytes().startswith(b"\x89PNG")


def test_convert_and_encode(run: Run, small: SmallScene, ksplat: Path, tmp_path: Path) -> None:
    spz, cogs = tmp_path / "a.spz", tmp_path / "a.cogs"
    assert run("convert", ksplat, spz, "--rotate", "90,0,0").code == 0
    assert len(cogsplat.read(spz)) == SPLATS
    common = ["--cameras", small.cameras, "--no-prune", "--json"]
    assert run("encode", ksplat, cogs, *common).json["splats"] == SPLATS
    assert len(cogsplat.decode(cogs)) == SPLATS
