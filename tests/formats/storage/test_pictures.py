from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cogsplat.codec.errors import DataError, StorageError
from cogsplat.formats.storage.pictures import read_picture


@pytest.mark.parametrize("format_", ["PNG", "WEBP"])
def test_pixels_are_as_they_were_written(tmp_path: Path, format_: str) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (3, 5, 3)).astype(np.uint8)
    path = tmp_path / "a.bin"
    Image.fromarray(pixels).save(path, format_, lossless=True)
    found = read_picture(path, (5, 3), code="photo", formats=("PNG", "WEBP"), convert="RGB")
    assert found.dtype == np.uint8
    assert np.array_equal(found, pixels)


@pytest.mark.parametrize(
    ("size", "formats", "modes", "said"),
    [
        ((5, 3), ("JPEG",), (), r"expected a picture \(JPEG\)"),
        ((3, 5), ("PNG",), (), "5x3 px of mode L, expected its camera's 3x5"),
        ((5, 3), ("PNG",), ("P", "1"), "of mode L, expected .* and one number per pixel"),
    ],
)
def test_other_formats_sizes_and_modes_are_refused(
    tmp_path: Path,
    size: tuple[int, int],
    formats: tuple[str, ...],
    modes: tuple[str, ...],
    said: str,
) -> None:
    path = tmp_path / "a.png"
    Image.new("L", (5, 3)).save(path)
    with pytest.raises(DataError, match=said) as caught:
        read_picture(path, size, code="mask", formats=formats, modes=modes)
    assert caught.value.code == "mask"


def test_a_picture_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(StorageError) as caught:
        read_picture(tmp_path / "a.png", (1, 1), code="photo", formats=("PNG",))
    assert caught.value.code == "not-found"
