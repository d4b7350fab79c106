"""Pictures as PNG: every level of 8 bits, clipped, rounded to the nearest."""

from pathlib import Path

import numpy as np
from PIL import Image

from cogsplat.tools.pictures.png import to_image, write_png


def test_every_level_is_its_own_and_the_nearest_is_chosen() -> None:
    levels = np.arange(256)
    ramp = np.repeat((levels / 255.0)[None, :, None], 3, axis=2)
    assert (np.asarray(to_image(ramp))[0, :, 1] == levels).all()
    between = np.asarray(to_image(ramp + 0.4 / 255.0))[0, :, 0]
    assert (between == levels).all()
    above = np.asarray(to_image(ramp + 0.6 / 255.0))[0, :, 2]
    assert (above == np.minimum(levels + 1, 255)).all()


def test_what_no_picture_shows_is_clipped() -> None:
    row = np.array([[[-1.0, 2.0, np.nan], [-np.inf, np.inf, 0.0]]])
    assert np.asarray(to_image(row)).tolist() == [[[0, 255, 0], [0, 255, 0]]]


def test_files_are_pngs_of_the_returned_size(tmp_path: Path) -> None:
    pixels = np.random.default_rng(4).random((5, 7, 3))
    size = write_png(to_image(pixels), tmp_path / "a.png")
    assert size == (tmp_path / "a.png").stat().st_size
    with Image.open(tmp_path / "a.png") as image:
        assert image.format == "PNG"
        assert image.size == (7, 5)
        assert (np.asarray(image) == np.asarray(to_image(pixels))).all()
