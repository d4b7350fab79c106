import itertools
import math
from dataclasses import replace

import numpy as np
import oracle
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cogsplat.codec.errors import DataError
from cogsplat.codec.geometry.rotations import matrices, unit
from cogsplat.codec.geometry.transforms import (
    axes_change,
    convert_axes,
    is_axes,
    rotate_sh,
    sh_rotation,
    transform,
    transform_camera,
)
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.splats import SceneInfo, Splats, empty

ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")
FRAMES = sorted(
    "".join(letters)
    for triple in itertools.product("RL", "UD", "FB")
    for letters in itertools.permutations(triple)
)


def directions(count: int = 200) -> np.ndarray:
    drawn = np.random.default_rng(1).standard_normal((count, 3))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def colours(shN: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Independent of codec: SH from associated Legendre functions, (directions, N, 3)."""
    degree = math.isqrt(shN.shape[1] + 1) - 1
    return np.einsum("dk,nkc->dnc", oracle.real_sh(towards, degree)[:, 1:], shN)


def covariances(splats: Splats) -> np.ndarray:
    spread = matrices(unit(splats.quats)) * np.exp(splats.scales.astype(np.float64))[:, None, :]
    return spread @ spread.transpose(0, 2, 1)


def assert_same_picture(actual: np.ndarray, expected: np.ndarray) -> None:
    assert expected.max() > 0.3, "nothing to see"
    off = np.abs(actual - expected).max(axis=2)
    # float32 puts single pixels on the other side of the 1/255 cut.
    assert np.mean(off > 1e-4) <= 0.002, f"{np.mean(off > 1e-4):.2%} of the pixels are off"
    assert off.max() < 0.01


def test_there_are_48_frames() -> None:
    assert len(FRAMES) == len(set(FRAMES)) == 48
    assert all(is_axes(name) for name in FRAMES)
    assert not any(is_axes(name) for name in ("", "RD", "RDFB", "RLF", "rdf", "RRF", "XYZ"))


def test_known_changes() -> None:
    spz = axes_change("RDF", "RUB")
    assert spz.order == (0, 1, 2)
    assert spz.signs == (1, -1, -1)
    assert spz.handedness == 1
    assert spz.quat_signs == (1, -1, -1)
    assert axes_change("RDF", "RUF").handedness == -1
    z_up = axes_change("RDF", "RFU")
    np.testing.assert_array_equal(z_up.matrix @ [1.0, 2.0, 3.0], [1.0, 3.0, -2.0])
    assert z_up.handedness == 1
    assert not z_up.only_flips


@pytest.mark.parametrize("target", FRAMES)
def test_gaussians_and_colours_move_with_their_axes(target: str) -> None:
    splats = oracle.scene(3, n=20)
    turned = convert_axes(splats, target)
    matrix = axes_change("RDF", target).matrix
    assert turned.info.axes == target
    np.testing.assert_array_equal(turned.means, (splats.means @ matrix.T).astype(np.float32))
    np.testing.assert_allclose(
        covariances(turned), matrix @ covariances(splats) @ matrix.T, rtol=1e-6, atol=1e-9
    )
    towards = directions()
    np.testing.assert_allclose(
        colours(turned.shN, towards @ matrix.T), colours(splats.shN, towards), atol=1e-5
    )
    np.testing.assert_array_equal(turned.opacities, splats.opacities)
    np.testing.assert_array_equal(turned.sh0, splats.sh0)


@pytest.mark.parametrize("target", FRAMES)
def test_converting_back_gives_the_same_scene(target: str) -> None:
    splats = replace(oracle.scene(4, n=20), info=SceneInfo(origin=(1.5, -2.0, 7.25)))
    back = convert_axes(convert_axes(splats, target), "RDF")
    assert back.info == splats.info
    for name in ARRAYS:
        exact = name != "shN" or axes_change("RDF", target).only_flips
        tolerance = 0.0 if exact else 2e-6
        np.testing.assert_allclose(
            getattr(back, name), getattr(splats, name), rtol=0, atol=tolerance, err_msg=name
        )


def test_origin_turns_with_the_means() -> None:
    splats = replace(empty(0, 1), info=SceneInfo(origin=(1.0, 2.0, 3.0)))
    splats.means[:] = (4, 5, 6)
    turned = convert_axes(splats, "BRU")
    np.testing.assert_array_equal(turned.means, [[-6, 4, -5]])
    assert turned.info.origin == (-3.0, 1.0, -2.0)


@pytest.mark.parametrize("degree", range(4))
def test_same_frame_is_the_same_scene(degree: int) -> None:
    splats = oracle.scene(5, n=3, degree=degree)
    assert convert_axes(splats, "RDF") is splats
    assert convert_axes(splats, "LUB").sh_degree == degree


def test_bad_axes() -> None:
    with pytest.raises(ValueError, match="axes 'RDX'"):
        convert_axes(empty(0), "RDX")
    with pytest.raises(DataError) as caught:
        convert_axes(replace(empty(0), info=SceneInfo(axes="RLF")), "RDF")
    assert caught.value.code == "bad-scene-info"


def test_nan_and_infinite_rows_stay_in_their_rows() -> None:
    splats = oracle.scene(6, n=6)
    splats.means[1, 2] = np.nan
    splats.opacities[2] = np.inf
    splats.shN[3, 4, 1] = np.inf
    for target in ("RUB", "FRU"):
        turned = convert_axes(splats, target)
        assert turned.invalid_rows().tolist() == [False, True, False, True, False, False]
        assert turned.opacities[2] == np.inf
    moved = transform(splats, 2.0, Rotation.random(random_state=1).as_matrix(), (1.0, 2.0, 3.0))
    assert moved.invalid_rows().tolist() == [False, True, False, True, False, False]


@pytest.mark.parametrize("target", ["RUB", "RFU", "LDF", "FUR"])
def test_picture_in_other_axes(target: str) -> None:
    splats, camera = oracle.scene(7, n=150), oracle.camera(angle=1)
    change = axes_change("RDF", target)
    turned = convert_axes(splats, target)
    # A mirrored world is seen by a mirrored camera, whose image has left and right exchanged.
    mirror = np.diag([change.handedness, 1.0, 1.0])
    rotation = mirror @ camera.rotation @ change.matrix.T
    cx = camera.cx if change.handedness > 0 else camera.width - camera.cx
    seen = render(
        turned,
        replace(camera, rotation=rotation, translation=mirror @ camera.translation, cx=cx),
    )
    assert_same_picture(seen[:, :: change.handedness], render(splats, camera))


@pytest.mark.parametrize("scale", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("seed", range(2))
def test_picture_of_a_transformed_scene(scale: float, seed: int) -> None:
    splats, camera = oracle.scene(seed, n=150), oracle.camera(angle=seed)
    rotation = Rotation.random(random_state=seed).as_matrix()
    how = (scale, rotation, (1.0, -2.0, 0.5))
    # The kernel of 0.3 px and the near plane have no effect here: nothing is closer.
    seen = render(transform(splats, *how), transform_camera(camera, *how))
    assert_same_picture(seen, render(splats, camera))


def test_transform_moves_origin_and_means_together() -> None:
    splats = replace(oracle.scene(1, n=10), info=SceneInfo(origin=(1e6, -2e6, 3e6)))
    rotation = Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_matrix()
    moved = transform(splats, 2.0, rotation, (10.0, 20.0, 30.0))
    before = np.array(splats.info.origin) + splats.means
    after = np.array(moved.info.origin) + moved.means
    np.testing.assert_allclose(after, 2 * before @ rotation.T + [10, 20, 30], rtol=0, atol=1e-5)
    np.testing.assert_allclose(
        covariances(moved), 4 * rotation @ covariances(splats) @ rotation.T, rtol=1e-5, atol=1e-6
    )


def test_transform_there_and_back() -> None:
    splats, rotation = oracle.scene(2, n=50), Rotation.random(random_state=5).as_matrix()
    there = transform(splats, 4.0, rotation, (1.0, 2.0, 3.0))
    back = transform(there, 0.25, rotation.T, tuple(-0.25 * rotation.T @ [1.0, 2.0, 3.0]))
    same = np.sign((back.quats * splats.quats).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(back.quats * same, splats.quats, atol=1e-6)
    for name in ("means", "scales", "shN"):
        np.testing.assert_allclose(getattr(back, name), getattr(splats, name), atol=5e-6)


def test_the_identity_changes_nothing() -> None:
    splats = oracle.scene(3, n=20)
    same = transform(splats)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(same, name), getattr(splats, name), name)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), degree=st.integers(0, 3), mirrored=st.booleans())
def test_turned_coefficients_give_turned_colours(seed: int, degree: int, mirrored: bool) -> None:
    rotation = Rotation.random(random_state=seed).as_matrix() * (-1 if mirrored else 1)
    rng = np.random.default_rng(seed)
    shN = rng.uniform(-1, 1, (7, (degree + 1) ** 2 - 1, 3)).astype(np.float32)
    turned = rotate_sh(shN, rotation)
    assert turned.dtype == np.float32
    towards = directions()
    np.testing.assert_allclose(
        colours(turned, towards @ rotation.T), colours(shN, towards), rtol=0, atol=1e-5
    )


@pytest.mark.parametrize("degree", range(4))
def test_sh_rotation_is_orthogonal_and_composes(degree: int) -> None:
    a, b = Rotation.random(2, random_state=0).as_matrix()
    one = np.eye((degree + 1) ** 2 - 1)
    np.testing.assert_array_equal(sh_rotation(np.eye(3), degree), one)
    np.testing.assert_allclose(sh_rotation(a, degree) @ sh_rotation(a, degree).T, one, atol=1e-12)
    np.testing.assert_allclose(
        sh_rotation(a @ b, degree), sh_rotation(a, degree) @ sh_rotation(b, degree), atol=1e-12
    )


def test_misuse() -> None:
    splats = empty(0, 1)
    for scale in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="positive finite"):
            transform(splats, scale)
        with pytest.raises(ValueError, match="positive finite"):
            transform_camera(oracle.camera(), scale)
    for rotation in (np.diag([1.0, 1.0, -1.0]), 2 * np.eye(3), np.full((3, 3), np.nan)):
        with pytest.raises(ValueError, match="expected a proper one"):
            transform(splats, 1.0, rotation)
    with pytest.raises(ValueError, match="shape"):
        transform(splats, 1.0, np.eye(4))
    with pytest.raises(ValueError, match="translation"):
        transform(splats, translation=(0.0, math.nan, 0.0))


def test_normals_turn_with_the_scene():
    splats = oracle.scene(3, n=20)
    rng = np.random.default_rng(2)
    normals = rng.normal(size=(20, 3))
    names = ("nx", "ny", "nz")
    extras = {name: normals[:, k].astype(np.float32) for k, name in enumerate(names)}
    splats = replace(splats, extras={**extras, "label": np.arange(20, dtype=np.uint8)})
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = transform(splats, 2.0, turn, (1.0, 2.0, 3.0)).extras
    np.testing.assert_array_equal(turned["nx"], -extras["ny"])
    np.testing.assert_array_equal(turned["ny"], extras["nx"])
    np.testing.assert_array_equal(turned["label"], splats.extras["label"])
    mirrored = convert_axes(splats, "RUB").extras
    np.testing.assert_array_equal(mirrored["nx"], extras["nx"])
    np.testing.assert_array_equal(mirrored["ny"], -extras["ny"])
    np.testing.assert_array_equal(mirrored["nz"], -extras["nz"])
    # Integer attributes with these names are labels, not normals.
    whole = {name: np.arange(20, dtype=np.int32) for name in names}
    kept = transform(replace(splats, extras=whole), 1.0, turn).extras
    np.testing.assert_array_equal(kept["nx"], whole["nx"])
