import pytest

from cogsplat.codec.errors import LimitError
from cogsplat.formats.storage.limits import Limits

MIB = 1 << 20


def code_of(limits: Limits, splats: int, **more: int) -> str:
    given = {"sh_degree": 0, "source_bytes": 1000} | more
    try:
        limits.require_scene(splats, **given, where="a")
    except LimitError as error:
        return error.code
    return ""


def test_small_scenes_pass_whatever_their_file() -> None:
    rows = 48 * MIB // 56
    assert code_of(Limits(), rows, source_bytes=0) == ""
    assert code_of(Limits(), rows + 1, source_bytes=0) == "decoded-size"


@pytest.mark.parametrize(("degree", "row_bytes"), [(0, 56), (1, 92), (2, 152), (3, 236)])
def test_larger_scenes_need_bytes_of_the_file(degree: int, row_bytes: int) -> None:
    rows = 64 * MIB // row_bytes
    assert code_of(Limits(), rows, sh_degree=degree, source_bytes=MIB) == ""
    assert code_of(Limits(), rows + 1, sh_degree=degree, source_bytes=MIB) == "decoded-size"


def test_what_is_held_beside_the_arrays_counts() -> None:
    limits = Limits(small_bytes=5600)
    assert code_of(limits, 100, source_bytes=0) == ""
    assert code_of(limits, 100, source_bytes=0, extra_bytes=1) == "decoded-size"
    assert code_of(limits, 50, source_bytes=0, copies=2) == ""
    assert code_of(limits, 50, source_bytes=0, copies=3) == "decoded-size"


def test_memory_and_splats_are_limits_for_large_files_too() -> None:
    huge = 1 << 40
    assert code_of(Limits(splats=10), 10, source_bytes=huge) == ""
    assert code_of(Limits(splats=10), 11, source_bytes=huge) == "too-many-splats"
    assert code_of(Limits(decoded_bytes=560), 10, source_bytes=huge) == ""
    assert code_of(Limits(decoded_bytes=560), 11, source_bytes=huge) == "decoded-size"


def test_cameras() -> None:
    Limits(cameras=3).require_cameras(3, "a")
    with pytest.raises(LimitError) as caught:
        Limits(cameras=3).require_cameras(4, "a")
    assert (caught.value.code, caught.value.exit_code) == ("too-many-cameras", 5)


def test_a_negative_limit_is_a_mistake_of_the_caller() -> None:
    with pytest.raises(ValueError, match="limit splats of -1"):
        Limits(splats=-1)
