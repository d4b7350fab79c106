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


def test_arrays_of_other_spaces_become_the_field_s():
    rng = np.random.default_rng(3)
    linear = rng.uniform(0.01, 2, (6, 3))
    unit = rng.uniform(0, 1, (6, 1))
    quats, sh = rng.normal(size=(6, 4)), rng.normal(size=(6, 9, 3))
    scene = Splats.from_arrays(
        rng.normal(size=(6, 3)).tolist(), linear, quats, unit, sh,
        scale_space="linear", opacity_space="unit", quat_order="xyzw",
    )  # fmt: skip
    np.testing.assert_allclose(np.exp(scene.scales), linear, rtol=1e-5)
    np.testing.assert_allclose(1 / (1 + np.exp(-scene.opacities)), unit[:, 0], rtol=1e-5)
    np.testing.assert_array_equal(scene.quats, quats[:, [3, 0, 1, 2]].astype(np.float32))
    np.testing.assert_array_equal(scene.sh0, sh[:, 0].astype(np.float32))
    np.testing.assert_array_equal(scene.shN, sh[:, 1:].astype(np.float32))
    ends = Splats.from_arrays(
        np.zeros((2, 3)), np.zeros((2, 3)), np.ones((2, 4)), [0.0, 1.0], np.zeros((2, 3)),
        opacity_space="unit",
    )  # fmt: skip
    assert ends.opacities.tolist() == [-np.inf, np.inf]


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"means": np.zeros((2, 4))}, "bad-shape"),
        ({"opacities": np.zeros((2, 2))}, "bad-shape"),
        ({"sh0": np.zeros((2, 5, 3))}, "bad-shape"),
        ({"sh0": np.zeros(2)}, "bad-shape"),
        ({"quats": [["a"] * 4] * 2}, "bad-dtype"),
        ({"scales": -np.ones((2, 3)), "scale_space": "linear"}, "bad-value"),
        ({"opacities": [0.5, 1.5], "opacity_space": "unit"}, "bad-value"),
        ({"opacities": [0.5, np.nan], "opacity_space": "unit"}, "bad-value"),
    ],
)
def test_arrays_that_fit_no_scene_are_refused(change, code):
    given = {
        "means": np.zeros((2, 3)), "scales": np.zeros((2, 3)), "quats": np.ones((2, 4)),
        "opacities": np.zeros(2), "sh0": np.zeros((2, 3)), **change,
    }  # fmt: skip
    with pytest.raises(DataError) as caught:
        Splats.from_arrays(**given)
    assert caught.value.code == code


def test_tensors_are_taken_as_arrays():
    class Tensor:
        """What of torch's tensors is used: detach, cpu, numpy."""

        def __init__(self, values):
            self.values = values

        def detach(self):
            return self

        def cpu(self):
            return self

        def numpy(self):
            return self.values

    shapes = {"means": (4, 3), "scales": (4, 3), "quats": (4, 4), "opacities": (4,)}
    shapes |= {"sh0": (4, 1, 3), "shN": (4, 3, 3)}
    rng = np.random.default_rng(1)
    arrays = {name: rng.normal(size=shape) for name, shape in shapes.items()}
    scene = Splats.from_gsplat({name: Tensor(values) for name, values in arrays.items()})
    assert scene.sh_degree == 1
    np.testing.assert_array_equal(scene.sh0, arrays["sh0"][:, 0].astype(np.float32))
    with pytest.raises(DataError, match="no quats among") as caught:
        Splats.from_gsplat({k: v for k, v in arrays.items() if k != "quats"})
    assert caught.value.code == "missing-array"


def test_lists_in_place_of_arrays_are_misuse():
    scene = empty(0, 2)
    with pytest.raises(TypeError, match="means is a list, expected a numpy array"):
        replace(scene, means=[[0, 0, 0]] * 2)


def test_rows_are_chosen_by_index_slice_mask_and_list():
    scene = empty(1, 10)
    scene.opacities[:] = np.arange(10)
    for rows, expected in (
        (slice(2, 5), [2, 3, 4]),
        (scene.opacities > 7, [8, 9]),
        ([3, 1], [3, 1]),
        (np.array([4]), [4]),
        (-1, [9]),
        (np.int64(2), [2]),
    ):
        assert scene[rows].opacities.tolist() == expected
    with pytest.raises(IndexError):
        scene[10]
    assert [len(one) for one in scene] == [1] * 10


def test_repr_is_one_short_line():
    assert repr(empty(2, 12_345)) == "<Splats: 12,345 of SH degree 2>"
    labelled = replace(empty(0, 1), extras={"object": np.zeros(1, np.uint8)})
    assert repr(labelled) == "<Splats: 1 of SH degree 0, extras object>"


def test_invalid_rows_are_dropped():
    scene = empty(0, 3)
    scene.means[1] = np.nan
    assert len(scene.drop_invalid()) == 2
