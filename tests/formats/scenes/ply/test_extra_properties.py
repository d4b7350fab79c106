"""Extra properties of a PLY: round trips, types, and doubles in map coordinates."""

import itertools
import warnings
from dataclasses import replace

import numpy as np
import plyfile
import pytest
from cogs_samples import ARRAYS, scene
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.splats import EXTRA_DTYPES
from cogsplat.formats.scenes.ply.extra_properties import split_origin
from cogsplat.formats.scenes.ply.ply_scene import read_ply, write_ply, write_ply_parts

N = 700


def extras_of(count, seed=3):
    rng = np.random.default_rng(seed)
    return {
        f"a_{dtype}": rng.integers(0, 2**63, count, np.uint64).astype(dtype)
        for dtype in EXTRA_DTYPES
    }


def same_extras(found, expected):
    assert list(found) == list(expected)
    for name, values in expected.items():
        assert found[name].dtype == values.dtype, name
        np.testing.assert_array_equal(found[name], values, name)


def as_plyfile(path, table, **how):
    element = plyfile.PlyElement.describe(table, "vertex")
    plyfile.PlyData([element], **how).write(path)


def table_of(path):
    return plyfile.PlyData.read(path)["vertex"].data


@pytest.mark.parametrize("count", [0, 1, N])
@pytest.mark.parametrize("degree", [0, 3])
def test_every_type_round_trips(tmp_path, count, degree):
    splats = replace(scene(count, degree), extras=extras_of(count))
    write_ply(splats, tmp_path / "a.ply")
    read = read_ply(tmp_path / "a.ply")
    same_extras(read.extras, splats.extras)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(read, name), getattr(splats, name), name)
    table = table_of(tmp_path / "a.ply")
    for name, values in splats.extras.items():
        assert table[name].dtype == values.dtype
        np.testing.assert_array_equal(table[name], values)


def test_floats_alone_round_trip(tmp_path):
    extras = {"curvature": np.linspace(-1, 1, N, dtype=np.float32)}
    write_ply(replace(scene(N, 1), extras=extras), tmp_path / "a.ply")
    same_extras(read_ply(tmp_path / "a.ply").extras, extras)


@pytest.mark.parametrize(
    "how", [{"text": True}, {"byte_order": ">"}, {"byte_order": "<"}], ids=["text", "big", "little"]
)
def test_other_layouts_bring_them_too(tmp_path, how):
    splats = replace(scene(50, 1), extras=extras_of(50))
    write_ply(splats, tmp_path / "a.ply")
    as_plyfile(tmp_path / "b.ply", np.array(table_of(tmp_path / "a.ply")), **how)
    same_extras(read_ply(tmp_path / "b.ply").extras, splats.extras)


def test_normals_that_are_zero_are_padding(tmp_path):
    write_ply(scene(9), tmp_path / "a.ply")
    assert not read_ply(tmp_path / "a.ply").extras
    normals = {
        "nx": np.zeros(9, np.float32),
        "ny": np.zeros(9, np.float32),
        "nz": np.arange(9, dtype=np.float32),
    }
    write_ply(replace(scene(9), extras=normals), tmp_path / "b.ply")
    same_extras(read_ply(tmp_path / "b.ply").extras, normals)
    names = table_of(tmp_path / "b.ply").dtype.names
    assert names[:7] == ("x", "y", "z", "nx", "ny", "nz", "f_dc_0")
    assert len(names) == len(set(names))


def test_normals_of_another_type_keep_their_place(tmp_path):
    normals = {name: np.full(4, 7, np.int16) for name in ("nz", "nx", "ny")}
    write_ply(replace(scene(4), extras=normals), tmp_path / "a.ply")
    found = read_ply(tmp_path / "a.ply").extras
    assert list(found) == ["nx", "ny", "nz"]
    assert all(values.dtype == np.int16 and (values == 7).all() for values in found.values())


def test_components_become_columns(tmp_path):
    wide = np.arange(12, dtype=np.uint16).reshape(4, 3)
    write_ply(replace(scene(4), extras={"class": wide}), tmp_path / "a.ply")
    same_extras(
        read_ply(tmp_path / "a.ply").extras, {f"class_{k}": wide[:, k].copy() for k in range(3)}
    )


def test_invalid_property_names_give_a_warning(tmp_path):
    numbers = np.arange(4, dtype=np.int8)
    extras = {
        "two words": numbers,
        "größe": numbers,
        "opacity": numbers,
        "kept": numbers,
        "a_0": numbers,
        "a": numbers.reshape(4, 1),
    }
    with pytest.warns(CogsplatWarning, match=r"ply cannot hold .*'two words', .*'größe', .*'op"):
        write_ply(replace(scene(4), extras=extras), tmp_path / "a.ply")
    same_extras(read_ply(tmp_path / "a.ply").extras, {"kept": numbers, "a_0": numbers})


def test_too_many_extras_give_a_warning(tmp_path):
    write_ply(scene(3), tmp_path / "a.ply")
    table = np.array(table_of(tmp_path / "a.ply"))
    more = np.zeros(
        3, [*table.dtype.descr, *((f"p{k}", "u1") for k in range(300)), ("n" * 300, "u1")]
    )
    for name in table.dtype.names:
        more[name] = table[name]
    as_plyfile(tmp_path / "b.ply", more, byte_order="<")
    with pytest.warns(CogsplatWarning, match="extra properties are skipped"):
        read = read_ply(tmp_path / "b.ply")
    assert "n" * 300 not in read.extras
    assert "p0" in read.extras


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_values_of_any_bits_survive(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("ply") / "a.ply"
    dtype = data.draw(st.sampled_from(EXTRA_DTYPES))
    width = int(dtype[1])
    octets = data.draw(hnp.arrays(np.uint8, (5, width)))
    values = octets.view(dtype).reshape(5)
    write_ply(replace(scene(5, 0), extras={"any": values}), path)
    assert read_ply(path).extras["any"].tobytes() == values.tobytes()


def as_doubles(path, shift, name="x"):
    splats = scene(N, 0)
    write_ply(splats, path)
    table = table_of(path)
    kinds = [(n, "f8" if n in "xyz" else "f4") for n in table.dtype.names]
    wide = np.zeros(N, kinds)
    for n in table.dtype.names:
        wide[n] = table[n]
    wide[name] += shift
    as_plyfile(path, wide, byte_order="<")
    return splats


def test_doubles_far_off_become_an_origin(tmp_path):
    splats = as_doubles(tmp_path / "a.ply", 512_345.25)
    with pytest.warns(CogsplatWarning, match=r"about \(512345, 0, 0\), which becomes the origin"):
        read = read_ply(tmp_path / "a.ply")
    assert read.info.origin == (512345.0, 0.0, 0.0)
    expected = splats.means.astype(np.float64)
    expected[:, 0] += 0.25
    np.testing.assert_allclose(read.means, expected, rtol=0, atol=3e-7)
    # What is written is read back the same, without a second move.
    write_ply(read, tmp_path / "b.ply")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = read_ply(tmp_path / "b.ply")
    assert again.info == read.info
    np.testing.assert_array_equal(again.means, read.means)


@pytest.mark.parametrize("shift", [0.0, 900.0])
def test_doubles_near_zero_stay(tmp_path, shift):
    as_doubles(tmp_path / "a.ply", shift)
    assert read_ply(tmp_path / "a.ply").info.origin == (0.0, 0.0, 0.0)


def test_an_origin_in_a_comment_is_added_to(tmp_path):
    as_doubles(tmp_path / "a.ply", -70_000.0, "z")
    data = (tmp_path / "a.ply").read_bytes()
    said = data.replace(b"element vertex", b"comment cogsplat origin 1 2 3\nelement vertex", 1)
    (tmp_path / "a.ply").write_bytes(said)
    with pytest.warns(CogsplatWarning, match="origin"):
        assert read_ply(tmp_path / "a.ply").info.origin == (1.0, 2.0, -69_997.0)


@pytest.mark.parametrize(
    "means",
    [
        np.zeros((0, 3)),
        np.full((4, 3), np.nan),
        np.full((4, 3), np.inf),
        np.array([[1e308, 0, 0], [-1e308, 0, 0], [1e308, 0, 0]]),
        np.random.default_rng(1).normal(0, 1e6, (50, 3)),
    ],
)
def test_what_has_no_far_centre_stays(means):
    kept, origin = split_origin(means, "here")
    assert kept is means
    assert origin == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("absolute", [False, True])
def test_parts_are_written_as_the_whole(tmp_path, absolute):
    rng = np.random.default_rng(8)
    labels = rng.integers(0, 9, 700).astype(np.int16)
    whole = replace(scene(700, 2), extras={"object": labels, "flow": rng.normal(size=(700, 2))})
    write_ply(whole, tmp_path / "whole.ply", absolute=absolute)
    cuts = (0, 300, 300, 301, 700)
    parts = [whole.take(slice(a, b)) for a, b in itertools.pairwise(cuts)]
    like = write_ply_parts(iter(parts), 700, tmp_path / "parts.ply", absolute=absolute)
    assert (tmp_path / "parts.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
    assert len(like) == 0
    assert like.sh_degree == 2
    assert set(like.extras) == {"object", "flow"}


@pytest.mark.parametrize("count", [1, 699, 701])
def test_parts_of_other_counts_leave_no_file(tmp_path, count):
    with pytest.raises(ValueError, match=f"700 rows in all parts, expected {count}"):
        write_ply_parts([scene(300, 0), scene(400, 0)], count, tmp_path / "out.ply")
    with pytest.raises(ValueError, match="no parts"):
        write_ply_parts([], 0, tmp_path / "out.ply")
    assert list(tmp_path.iterdir()) == []
