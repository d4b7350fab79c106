"""A scene's information as PLY comments: what is written is read, what is wrong is refused."""

import pytest

from cogsplat.codec.errors import DataError, FormatError
from cogsplat.codec.splats import SceneInfo
from cogsplat.formats.scenes.ply.comments import parse_scene_info, scene_comments


@pytest.mark.parametrize(
    "info",
    [
        SceneInfo(),
        SceneInfo(origin=(1 / 3, -2e7, 5e-324)),
        SceneInfo(axes="LUF"),
        SceneInfo(colour_space="linear"),
        SceneInfo(kernel_px=0.1),
        SceneInfo(antialiased=True),
        SceneInfo((1.0, 2.0, 3.0), "RUB", "linear", 0.0, True),
    ],
)
def test_comments_survive_a_round_trip(info: SceneInfo) -> None:
    assert parse_scene_info(scene_comments(info), "here") == info


def test_a_default_scene_has_no_comments() -> None:
    assert scene_comments(SceneInfo()) == []


def test_comments_of_others_are_skipped_and_the_mip_mark_is_known() -> None:
    others = ["made by hand", "cogsplat future 3", "SplatRenderMode: default", ""]
    assert parse_scene_info(others, "here") == SceneInfo()
    assert parse_scene_info([*others, "SplatRenderMode: mip"], "here").antialiased


@pytest.mark.parametrize(
    "comment",
    [
        "cogsplat origin 1 2",
        "cogsplat origin 1 2 nan",
        "cogsplat axes RRB",
        "cogsplat axes RU",
        "cogsplat colour_space cmyk",
        "cogsplat kernel_px -0.1",
        "cogsplat kernel_px inf",
        "cogsplat antialiased yes",
        "cogsplat axes",
    ],
)
def test_values_that_a_key_cannot_have_are_refused(comment: str) -> None:
    with pytest.raises(FormatError, match="here: ") as caught:
        parse_scene_info([comment], "here")
    assert caught.value.code == "ply-bad-comment"


def test_what_would_be_refused_is_not_written() -> None:
    with pytest.raises(DataError) as caught:
        scene_comments(SceneInfo(kernel_px=-1.0))
    assert caught.value.code == "bad-scene-info"
