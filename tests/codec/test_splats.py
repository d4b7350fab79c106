from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.errors import CogsplatError, DataError
from cogsplat.codec.splats import SceneInfo, Splats, concatenate, empty, sh_coefficients

FIELDS = ("means", "scales", "quats", "opacities", "sh0", "shN")


def same(a, b):
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    assert a.info == b.info


@pytest.mark.parametrize(("degree", "k"), [(0, 1), (1, 4), (2, 9), (3, 16)])
def test_degrees_and_coefficients(degree, k):
    splats = oracle.scene(1, n=7, degree=degree)
    assert sh_coefficients(degree) == k
    assert splats.sh_degree == degree
    assert splats.shN.shape == (7, k - 1, 3)
    assert len(splats) == 7
    assert splats.nbytes == 7 * 4 * (14 + 3 * (k - 1))


@pytest.mark.parametrize("name", FIELDS)
def test_arrays_that_do_not_fit_are_refused(name):
    splats = oracle.scene(1, n=5)
    array = getattr(splats, name)
    for broken in (array[:-1], np.concatenate([array, array[:1]]), array[..., None], array[0]):
        with pytest.raises(DataError, match="expected") as caught:
            replace(splats, **{name: np.ascontiguousarray(broken)})
        assert caught.value.code == "bad-shape"
    for dtype in (np.float64, np.float16, np.int32, ">f4"):
        with pytest.raises(DataError, match=f"{name} is .*, expected float32") as caught:
            replace(splats, **{name: array.astype(dtype)})
        assert caught.value.code == "bad-dtype"


@pytest.mark.parametrize("count", [1, 2, 4, 7, 9, 14, 16, 24])
def test_counts_of_coefficients_that_are_no_degree_are_refused(count):
    with pytest.raises(DataError, match="shN has shape") as caught:
        replace(oracle.scene(1, n=5), shN=np.zeros((5, count, 3), np.float32))
    assert caught.value.code == "bad-shape"
    assert isinstance(caught.value, CogsplatError)


def test_construction_copies_only_what_is_not_in_c_order():
    splats = oracle.scene(2, n=6)
    again = replace(splats)
    assert all(np.shares_memory(getattr(splats, f), getattr(again, f)) for f in FIELDS)
    turned = replace(splats, means=np.asfortranarray(splats.means), shN=splats.shN[:, ::-1])
    assert turned.means.flags.c_contiguous
    assert turned.shN.flags.c_contiguous
    np.testing.assert_array_equal(turned.means, splats.means)
    np.testing.assert_array_equal(turned.shN, splats.shN[:, ::-1])


def test_scenes_are_frozen():
    splats = empty(0)
    with pytest.raises(AttributeError):
        splats.means = np.zeros((0, 3), np.float32)  # type: ignore[misc]


def test_taking_rows():
    splats = oracle.scene(3, n=8, info=SceneInfo(kernel_px=0.1))
    rows = np.array([5, 0, 5])
    taken = splats.take(rows)
    np.testing.assert_array_equal(taken.quats, splats.quats[rows])
    assert taken.info == splats.info
    assert not np.shares_memory(taken.means, splats.means)
    mask = np.arange(8) % 2 == 0
    same(splats.take(mask), splats.take(np.flatnonzero(mask)))
    views = splats.take(slice(2, 6))
    assert all(np.shares_memory(getattr(splats, f), getattr(views, f)) for f in FIELDS)
    assert len(splats.take(np.zeros(0, np.int64))) == 0


def test_cutting_the_degree():
    splats = oracle.scene(4, n=5, degree=3)
    for degree in range(3):
        cut = splats.with_sh_degree(degree)
        assert cut.sh_degree == degree
        np.testing.assert_array_equal(cut.shN, splats.shN[:, : sh_coefficients(degree) - 1])
        assert cut.shN.flags.c_contiguous
        assert cut.means is splats.means
    assert splats.with_sh_degree(3) is splats
    low = splats.with_sh_degree(1)
    assert low.with_sh_degree(2) is low
    for degree in (-1, 4):
        with pytest.raises(ValueError, match="expected 0 to 3"):
            splats.with_sh_degree(degree)


def test_rows_that_cannot_be_drawn_are_marked():
    splats = oracle.scene(5, n=40)
    expected = np.zeros(40, bool)
    row = 0
    for name in FIELDS:
        for value in (np.nan, np.inf, -np.inf):
            array = getattr(splats, name).reshape(40, -1)
            array[row, row % array.shape[1]] = value
            expected[row] = np.isnan(value) or name != "opacities"
            row += 1
    splats.quats[row] = 0
    expected[row] = True
    np.testing.assert_array_equal(splats.invalid_rows(), expected)
    with pytest.raises(DataError, match=r"17 of 40 splats .* first is row 0") as caught:
        splats.require_valid()
    assert caught.value.code == "invalid-rows"
    clean = splats.take(~expected)
    assert clean.require_valid() is clean


def test_tiny_and_huge_quaternions_are_drawn():
    splats = empty(0, 4)
    splats.quats[:] = [[1e-45, 0, 0, 0], [0, 3e38, 3e38, 0], [0, 0, 0, -1e-38], [0, 0, 0, 0]]
    assert splats.invalid_rows().tolist() == [False, False, False, True]


@pytest.mark.parametrize("degree", range(4))
def test_empty_scenes(degree):
    nothing = empty(degree)
    assert (len(nothing), nothing.sh_degree, nothing.nbytes) == (0, degree, 0)
    assert nothing.invalid_rows().shape == (0,)
    assert nothing.require_valid() is nothing
    some = empty(degree, 3, SceneInfo(axes="RUB"))
    assert not some.invalid_rows().any()
    assert some.quats.tolist() == [[1, 0, 0, 0]] * 3
    assert some.info.axes == "RUB"


def test_joining_gives_back_what_was_cut():
    splats = oracle.scene(6, n=9, info=SceneInfo(origin=(1.0, 2.0, 3.0)))
    parts = [splats.take(slice(a, b)) for a, b in ((0, 4), (4, 4), (4, 9))]
    same(concatenate(parts), splats)
    with pytest.raises(ValueError, match="dimension"):
        concatenate([splats, splats.with_sh_degree(1)])
    assert isinstance(concatenate(parts), Splats)


EXTRAS = {
    "label": np.arange(5, dtype=np.uint16),
    "normal": np.arange(15, dtype=np.float64).reshape(5, 3),
    "größe": np.full(5, -1, np.int8),
}


def test_extras_go_where_their_rows_go():
    splats = replace(oracle.scene(1, n=5), extras=EXTRAS)
    assert splats.nbytes == oracle.scene(1, n=5).nbytes + 5 * (2 + 24 + 1)
    rows = np.array([3, 0, 3])
    taken = splats.take(rows)
    assert list(taken.extras) == list(EXTRAS)
    for name, values in EXTRAS.items():
        np.testing.assert_array_equal(taken.extras[name], values[rows])
        assert taken.extras[name].dtype == values.dtype
    joined = concatenate([splats, taken])
    np.testing.assert_array_equal(joined.extras["label"], [0, 1, 2, 3, 4, 3, 0, 3])
    assert joined.extras["normal"].shape == (8, 3)
    assert set(splats.with_sh_degree(0).extras) == set(EXTRAS)
    assert not splats.without_extras().extras
    assert splats.without_extras().means is splats.means
    plain = oracle.scene(1, n=5)
    assert plain.without_extras() is plain
    assert np.shares_memory(splats.take(slice(1, 3)).extras["normal"], splats.extras["normal"])


def test_extras_are_a_copy_of_the_mapping():
    given = dict(EXTRAS)
    splats = replace(oracle.scene(1, n=5), extras=given)
    given.clear()
    assert set(splats.extras) == set(EXTRAS)


@pytest.mark.parametrize(
    ("extras", "code"),
    [
        ({"a": np.zeros(4, np.uint8)}, "bad-shape"),
        ({"a": np.zeros((5, 0), np.uint8)}, "bad-shape"),
        ({"a": np.zeros((5, 17), np.uint8)}, "bad-shape"),
        ({"a": np.zeros((5, 1, 1), np.uint8)}, "bad-shape"),
        ({"a": np.array(1, np.uint8)}, "bad-shape"),
        ({"a": np.zeros(5, np.int64)}, "bad-dtype"),
        ({"a": np.zeros(5, np.float16)}, "bad-dtype"),
        ({"a": np.zeros(5, bool)}, "bad-dtype"),
        ({"a": np.zeros(5, ">f4")}, "bad-dtype"),
        ({"": np.zeros(5, np.uint8)}, "bad-extra"),
        ({"x" * 256: np.zeros(5, np.uint8)}, "bad-extra"),
        ({"\ud800": np.zeros(5, np.uint8)}, "bad-extra"),
        ({f"a{k}": np.zeros(5, np.uint8) for k in range(257)}, "bad-extra"),
    ],
)
def test_extras_that_do_not_fit_are_refused(extras, code):
    with pytest.raises(DataError, match="expected") as caught:
        replace(oracle.scene(1, n=5), extras=extras)
    assert caught.value.code == code


@pytest.mark.parametrize(
    "other",
    [
        {},
        {"a": np.zeros(5, np.int8)},
        {"a": np.zeros((5, 1), np.uint8)},
        {"b": np.zeros(5, np.uint8)},
    ],
)
def test_only_scenes_of_the_same_extras_are_joined(other):
    first = replace(oracle.scene(1, n=5), extras={"a": np.zeros(5, np.uint8)})
    with pytest.raises(DataError, match=r"part 1 .* expected 'a' u1") as caught:
        concatenate([first, replace(first, extras=other)])
    assert caught.value.code == "extras-mismatch"
