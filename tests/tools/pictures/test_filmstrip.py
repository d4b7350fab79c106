"""The film-strip: sizes, pixels where they belong, captions that fit."""

import numpy as np
import pytest

from cogsplat.tools.pictures.filmstrip import filmstrip


def panels(count: int, height: int = 60, width: int = 80) -> list[np.ndarray]:
    rng = np.random.default_rng(5)
    return [rng.random((height, width, 3)).astype(np.float32) for _ in range(count)]


def test_strip_holds_every_picture_unchanged_and_in_order() -> None:
    images = panels(3)
    strip = np.asarray(filmstrip(images, [["a"], ["b"], ["c"]], title="three"))
    found = []
    for image in images:
        expected = (image * 255.0 + 0.5).astype(np.uint8)
        rows, columns = np.nonzero((strip == expected[0, 0]).all(axis=2))
        places = [
            (int(x), int(y))
            for x, y in zip(columns, rows, strict=True)
            if np.array_equal(strip[y : y + 60, x : x + 80], expected)
        ]
        assert len(places) == 1
        found += places
    assert [x for x, _ in found] == sorted(x for x, _ in found)
    assert len({y for _, y in found}) == 1


def test_captions_and_title_take_room_and_leave_marks() -> None:
    bare = filmstrip(panels(2), [[], []])
    told = filmstrip(panels(2), [["5 % of the bytes", "41 KiB"], ["all", ""]], title="A scene")
    assert told.width == bare.width
    assert told.height > bare.height
    below = np.asarray(told)[-20:]
    assert len(np.unique(below.reshape(-1, 3), axis=0)) > 3


def test_long_captions_stay_under_their_picture() -> None:
    strip = np.asarray(filmstrip(panels(2, 60, 200), [["wide " * 7], [""]]))
    gap_and_right = strip[-12:, 12 + 200 + 1 :]
    assert (gap_and_right == gap_and_right[0, 0]).all()


def test_out_of_range_and_nan_pixels_are_drawn_as_black_or_white() -> None:
    image = np.zeros((40, 40, 3))
    image[0, 0], image[0, 1], image[0, 2] = 7.0, -3.0, np.nan
    strip = np.asarray(filmstrip([image], [[]]))
    margin = (strip.shape[1] - 40) // 2
    np.testing.assert_array_equal(strip[margin, margin : margin + 3, 0], [255, 0, 0])


@pytest.mark.parametrize(
    ("images", "captions"),
    [
        ([], []),
        (panels(2), [["one"]]),
        ([*panels(1), *panels(1, 30, 80)], [["a"], ["b"]]),
        ([np.zeros((4, 4))], [["grey"]]),
    ],
)
def test_misuse_is_a_value_error(images: list[np.ndarray], captions: list[list[str]]) -> None:
    with pytest.raises(ValueError, match="expected"):
        filmstrip(images, captions)
