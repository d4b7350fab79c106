"""Merging: every splat keeps its world position."""

from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.errors import CogsplatWarning, DataError
from cogsplat.codec.geometry.merging import merge
from cogsplat.codec.splats import SceneInfo
from cogsplat.tools.lab.synthetic.terrace import synth


def test_rows_keep_their_values_and_their_order() -> None:
    first, second = synth(40), synth(30).with_sh_degree(1)
    merged = merge([first, second])
    assert (len(merged), merged.sh_degree) == (70, first.sh_degree)
    for name in ("means", "scales", "quats", "opacities", "sh0"):
        parts = [getattr(first, name), getattr(second, name)]
        np.testing.assert_array_equal(getattr(merged, name), np.concatenate(parts), name)
    np.testing.assert_array_equal(merged.shN[40:, :3], second.shN)
    assert not merged.shN[40:, 3:].any()


def test_axes_and_origins_are_those_of_the_first_part() -> None:
    scene = synth(20)
    far = replace(
        scene,
        means=scene.means * np.float32([1, -1, -1]),
        info=SceneInfo(origin=(1000.0, -2000.0, -3000.0), axes="RUB"),
    )
    first = replace(scene, info=SceneInfo(origin=(999.0, 2000.0, 3000.0), axes="RDF"))
    merged = merge([first, far])
    assert merged.info == first.info
    # RUB (1000, -2000, -3000) is RDF (1000, 2000, 3000): 1 off the first origin along x.
    expected = scene.means.astype(np.float64) + np.array([1.0, 0.0, 0.0])
    np.testing.assert_array_equal(merged.means[20:], expected.astype(np.float32))


def test_extras_that_differ_between_parts_are_omitted() -> None:
    a = replace(synth(3), extras={"t": np.arange(3, dtype="u1"), "n": np.zeros(3, "f4")})
    b = replace(synth(2), extras={"t": np.arange(2, dtype="u1"), "n": np.zeros(2, "f8")})
    with pytest.warns(CogsplatWarning, match="attributes n are not alike"):
        merged = merge([a, b])
    assert list(merged.extras) == ["t"]
    np.testing.assert_array_equal(merged.extras["t"], [0, 1, 2, 0, 1])


def test_incompatible_parts_warn_or_are_refused() -> None:
    scene = synth(2)
    with pytest.raises(DataError, match="colours in linear") as refused:
        merge([scene, replace(scene, info=SceneInfo(colour_space="linear"))])
    assert refused.value.code == "colour-spaces-differ"
    with pytest.warns(CogsplatWarning, match="kernel of 0.1"):
        merge([scene, replace(scene, info=SceneInfo(kernel_px=0.1))])
    with pytest.raises(DataError, match="2 centres") as far:
        merge([scene, replace(scene, info=SceneInfo(origin=(1e300, 0.0, 0.0)))])
    assert far.value.code == "moved-too-far"
    with pytest.raises(ValueError, match="at least one"):
        merge([])
