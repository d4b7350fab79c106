import pytest
from encoding import unseen

from cogsplat.codec.encode.memory import LEAST_RESIDENT, burst_bytes, memory_need
from cogsplat.codec.errors import LimitError

MILLION = 1_000_000


def test_ten_million_splats_fit_into_ten_gigabytes():
    need = memory_need(10 * MILLION, 3, unseen(threads=2))
    assert need.scene == 10 * MILLION * 236
    assert need.out_of_core < 4 * 10**9
    assert need.resident_bytes(10 * 10**9) > 6 * 10**9
    assert need.resident_bytes(need.in_memory) is None


@pytest.mark.parametrize("degree", [0, 3])
def test_the_least_that_works_leaves_room_for_a_few_pages(degree):
    need = memory_need(MILLION, degree, unseen(threads=2))
    assert need.resident_bytes(need.out_of_core) == LEAST_RESIDENT
    assert need.resident_bytes(need.out_of_core + 1000) == LEAST_RESIDENT + 1000
    with pytest.raises(LimitError, match="expected at least") as refused:
        need.resident_bytes(need.out_of_core - 1)
    assert refused.value.code == "memory-cap"


def test_more_splats_extras_and_a_scene_that_is_held_take_more():
    config = unseen(threads=2)
    plain = memory_need(MILLION, 3, config)
    more = memory_need(2 * MILLION, 3, config)
    labelled = memory_need(MILLION, 3, config, extra_bytes=4)
    held = memory_need(MILLION, 3, config, held_bytes=236 * MILLION)
    assert more.in_memory > plain.in_memory
    assert more.out_of_core > plain.out_of_core
    assert labelled.in_memory == plain.in_memory + 4 * MILLION
    assert held.out_of_core == plain.out_of_core + 236 * MILLION
    assert held.in_memory == plain.in_memory


@pytest.mark.parametrize("more", [{"order": "gain"}, {"compensate": True}])
def test_an_order_by_gain_and_compensation_take_more(more):
    plain = memory_need(MILLION, 3, unseen(threads=2))
    need = memory_need(MILLION, 3, unseen(threads=2, **more))
    assert need.in_memory > plain.in_memory
    assert plain.out_of_core < need.out_of_core < 0.9 * 10**9


def test_codebooks_are_not_trained_out_of_core():
    need = memory_need(MILLION, 3, unseen(profile="vq"))
    assert need.out_of_core is None
    assert need.resident_bytes(need.in_memory) is None
    with pytest.raises(LimitError, match="profile vq") as refused:
        need.resident_bytes(need.in_memory - 1)
    assert refused.value.code == "memory-cap"


def test_a_small_scene_takes_no_more_out_of_core_than_in_memory():
    need = memory_need(1000, 3, unseen())
    assert need.out_of_core == need.in_memory


def test_a_view_on_each_core_takes_more_up_to_where_all_cores_share_one():
    two, eight = (memory_need(MILLION, 3, unseen(threads=count)) for count in (2, 8))
    assert eight.in_memory > two.in_memory
    assert eight.out_of_core == two.out_of_core
    two, eight = (memory_need(3 * MILLION, 3, unseen(threads=count)) for count in (2, 8))
    assert eight.in_memory == two.in_memory


def test_room_for_bursts_is_left_in_the_least_memory_that_works():
    for splats in (1000, MILLION, 1000 * MILLION):
        assert 0 < burst_bytes(splats) < memory_need(splats, 0, unseen(threads=2)).out_of_core
