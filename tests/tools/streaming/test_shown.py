"""What is drawn of a part of a file, against decoding that part."""

import numpy as np
import pytest

from cogsplat.codec.metrics import PSNR_CAP_DB, psnr
from cogsplat.codec.render.rasteriser import render
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.streaming.client import units_of
from cogsplat.tools.streaming.shown import ShownScene
from cogsplat.tools.synthetic.rooms import rooms_cameras

CAMERA = rooms_cameras(4)[3]


@pytest.fixture
def shown(house_file: CogsFile) -> ShownScene:
    return ShownScene(house_file, threads=1)


def test_all_of_it_is_the_whole(house_file: CogsFile, shown: ShownScene) -> None:
    units = units_of(house_file)
    whole = shown.picture(CAMERA)
    assert shown.psnr_db(units, range(len(units)), CAMERA, whole) == PSNR_CAP_DB
    nothing = shown.psnr_db(units, [], CAMERA, whole)
    assert nothing == pytest.approx(psnr(np.zeros_like(whole), whole))


def test_heads_alone_are_drawn_coarse_and_without_tails(
    house_file: CogsFile, shown: ShownScene
) -> None:
    units = units_of(house_file)
    heads = np.flatnonzero(units.kind == SegmentKind.HEAD).tolist()
    whole = shown.picture(CAMERA)
    coarse = house_file.decode(sh_degree=0, refine=False)
    expected = psnr(np.clip(render(coarse, CAMERA), 0.0, 1.0), whole)
    assert shown.psnr_db(units, heads, CAMERA, whole) == pytest.approx(expected)
    assert expected < PSNR_CAP_DB


def test_chunks_contribute_where_they_are_seen(house_file: CogsFile, shown: ShownScene) -> None:
    found = shown.contributions(CAMERA)
    assert found.shape == (house_file.num_chunks,)
    assert found.min() >= 0.0
    # Pixels are covered about once.
    assert 0.5 < found.sum() / (CAMERA.width * CAMERA.height) < 1.01
    assert (found < 0.01 * found.max()).any(), "a view does not show all rooms"
