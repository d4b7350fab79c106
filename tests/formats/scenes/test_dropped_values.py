"""Values that a format cannot store, listed in one warning."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.splats import SceneInfo, empty
from cogsplat.formats.scenes.dropped_values import dropped_extras, dropped_info, warn_dropped


def test_a_default_scene_drops_no_values() -> None:
    assert dropped_info(SceneInfo()) == []
    assert dropped_extras(empty(0)) == []


def test_every_field_of_the_information_is_named() -> None:
    info = SceneInfo(origin=(1.0, 2.0, 3.0), colour_space="linear", kernel_px=0.1, antialiased=True)
    result = dropped_info(info)
    assert len(result) == 4
    for word, line in zip(("origin", "linear", "0.1", "anti-aliasing"), result, strict=True):
        assert word in line
    assert len(dropped_info(info, antialiased=True)) == 3
    # Axes are converted by every writer, so that they are never lost.
    assert dropped_info(replace(SceneInfo(), axes="RUB")) == []


def test_the_names_of_many_attributes_are_cut() -> None:
    few = empty(0)
    one = replace(few, extras={"label": np.zeros(0, np.uint8)})
    assert dropped_extras(one) == ["the attributes label"]
    many = replace(few, extras={f"a{i}": np.zeros(0, np.uint8) for i in range(9)})
    assert dropped_extras(many) == ["the attributes a0, a1, a2, a3, a4, a5 and 3 more"]


def test_dropped_values_give_one_warning() -> None:
    with pytest.warns(CogsplatWarning) as caught:
        warn_dropped("out.spz", "SPZ", ["the origin", "the kernel"])
    assert [str(w.message) for w in caught] == ["out.spz: SPZ cannot hold the origin, the kernel"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_dropped("out.spz", "SPZ", [])
