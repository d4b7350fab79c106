"""Charts and picture strips of simulated traces."""

from xml.etree import ElementTree

import numpy as np

from cogsplat.tools.lab.streaming.comparison import Moment
from cogsplat.tools.lab.streaming.curves import picture_strips, psnr_chart

SEEN = {
    name: [
        Moment(seconds=n + 1.0, bytes=1000 * (n + 1), psnr_db=db, ssim=0.9, wasted_bytes=0)
        for n, db in enumerate(values)
    ]
    for name, values in (("file", [20.0, 30.0]), ("views", [25.0, 100.0]))
}


def test_a_chart_has_a_line_and_a_name_for_each_policy() -> None:
    page = psnr_chart(SEEN, "a title")
    root = ElementTree.fromstring(page)
    assert len([e for e in root.iter() if e.tag.endswith("polyline")]) == 2
    for text in ("a title", ">file<", ">views<", "60 dB"):
        assert text in page


def test_strips_stand_below_each_other() -> None:
    grey = np.full((30, 40, 3), 0.5, np.float32)
    white = np.ones((30, 40, 3), np.float32)
    pictures = {"": [grey, grey], "file": [white, grey], "views": [white, white]}
    page = np.asarray(picture_strips(pictures, SEEN, "a title"))
    one = np.asarray(picture_strips({"": [grey, grey]}, SEEN, "a title"))
    assert page.shape[1] == one.shape[1]
    assert page.shape[0] > 2.5 * one.shape[0]
    assert int((page == 255).all(axis=2).sum()) >= 3 * 30 * 40
