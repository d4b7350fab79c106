from pathlib import Path

import hostile_files as hostile
import numpy as np
import pytest
from PIL import Image

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.tools.pictures.mask_images import read_masks


def camera(name: str, width: int = 4, height: int = 3) -> Camera:
    return Camera(width, height, 4.0, 4.0, 2.0, 1.5, np.eye(3), np.zeros(3), name)


def refused(folder: Path, view: Camera) -> str:
    with pytest.raises(DataError) as caught:
        read_masks(folder, [view])
    assert str(folder / "v.png") in caught.value.message
    return caught.value.code


@pytest.mark.parametrize(("mode", "dtype"), [("L", np.uint8), ("I;16", np.uint16), ("1", bool)])
def test_masks_are_found_by_the_names_of_cameras(
    tmp_path: Path, mode: str, dtype: type[np.generic]
) -> None:
    labels = np.arange(12).reshape(3, 4).astype(dtype)
    Image.fromarray(labels).save(tmp_path / "v.png")
    views, masks = read_masks(tmp_path, [camera("folder/v.jpg"), camera("other.jpg")])
    assert [view.name for view in views] == ["folder/v.jpg"]
    assert masks[0].dtype == np.uint32
    assert np.array_equal(masks[0], labels.astype(np.uint32))


@pytest.mark.parametrize("format_", ["EPS", "PSD", "GIF", "TIFF", "PPM", "BMP", "text"])
def test_only_png_is_tried_whatever_the_name(tmp_path: Path, format_: str) -> None:
    path = tmp_path / "v.png"
    if format_ == "EPS":
        hostile.eps(path, side=4)
    elif format_ == "PSD":
        path.write_bytes(b"8BPS\0\1" + bytes(8) + (3).to_bytes(4) + (4).to_bytes(4) + bytes(64))
    elif format_ == "text":
        path.write_text("labels")
    else:
        Image.new("L", (4, 3)).save(path, format_)
    assert refused(tmp_path, camera("v")) == "mask"


def test_comments_that_inflate_without_end(tmp_path: Path) -> None:
    hostile.png_with_text_bomb(tmp_path / "v.png", side=4, inflated=64 << 20)
    assert refused(tmp_path, camera("v", 4, 4)) == "mask"


def test_damaged_and_huge_pictures(tmp_path: Path) -> None:
    path = tmp_path / "v.png"
    Image.new("L", (4, 3)).save(path)
    data = path.read_bytes()
    path.write_bytes(data[:-30])
    assert refused(tmp_path, camera("v")) == "mask"
    # So many pixels that Pillow warns, and twice as many, which it refuses.
    for side in (10_000, 20_000):
        path.write_bytes(data[:16] + side.to_bytes(4) * 2 + data[24:])
        assert refused(tmp_path, camera("v")) == "mask"


@pytest.mark.parametrize(("size", "mode"), [((3, 4), "L"), ((4, 3), "RGB"), ((4, 3), "RGBA")])
def test_other_sizes_and_modes(tmp_path: Path, size: tuple[int, int], mode: str) -> None:
    Image.new(mode, size).save(tmp_path / "v.png")
    assert refused(tmp_path, camera("v")) == "mask"
