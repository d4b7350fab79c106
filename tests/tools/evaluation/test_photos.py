from pathlib import Path

import hostile_files as hostile
import numpy as np
import pytest
from PIL import Image

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatError, DataError, FormatError
from cogsplat.codec.splats import empty
from cogsplat.tools.evaluation.photos import Photos, read_photos


def photos(folder: Path, name: str) -> Photos:
    view = Camera(8, 6, 8.0, 8.0, 4.0, 3.0, np.eye(3), np.zeros(3), name)
    return read_photos(folder, empty(0, 0), [view], (0.0, 0.0, 0.0), threads=1)


@pytest.mark.parametrize("name", ["a.png", "left/a.jpg", "a.webp"])
def test_photos_lie_where_cameras_say(tmp_path: Path, name: str) -> None:
    (tmp_path / "left").mkdir()
    Image.new("RGB", (8, 6), (64, 64, 64)).save(tmp_path / name, quality=100)
    found = photos(tmp_path, name)
    assert found.pictures[0].shape == (6, 8, 3)
    # Black against a grey of a quarter.
    assert found.source_db == pytest.approx(20 * np.log10(255 / 64), abs=0.3)


@pytest.mark.parametrize("name", ["../a.png", "/etc/passwd", "a\\b.png", "a\n.png", "", "C:a.png"])
def test_names_that_lead_out_of_the_folder(tmp_path: Path, name: str) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    Image.new("RGB", (8, 6)).save(tmp_path / "a.png")
    with pytest.raises(FormatError) as caught:
        photos(inner, name)
    assert caught.value.code == "photo-name"


def test_a_link_out_of_the_folder(tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    Image.new("RGB", (8, 6)).save(tmp_path / "a.png")
    (inner / "a.png").symlink_to(tmp_path / "a.png")
    with pytest.raises(CogsplatError) as caught:
        photos(inner, "a.png")
    assert caught.value.code == "photo-name"


def test_invalid_photos_are_refused(tmp_path: Path) -> None:
    hostile.eps(tmp_path / "a.jpg", side=8)
    hostile.png_with_text_bomb(tmp_path / "b.jpg", side=8, inflated=64 << 20)
    Image.new("RGB", (6, 8)).save(tmp_path / "c.jpg")
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        with pytest.raises(DataError) as caught:
            photos(tmp_path, name)
        assert caught.value.code == "photo"
