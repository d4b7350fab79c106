import asyncio
import threading

import numpy as np
import pytest
from cogs_samples import assert_same, file_of
from fault_server import FaultServer, right, serving, slow

import cogsplat
from cogsplat.codec.errors import Cancelled


@pytest.fixture(scope="module", params=["vq", "transform"])
def data(request):
    return file_of(request.param, 6000, 3, 500)


def joined(updates, file):
    """Return the last update of each chunk, in the order of the file."""
    last = {update.chunk: update for update in updates}
    assert sorted(last) == list(range(file.num_chunks))
    return [last[chunk] for chunk in sorted(last)]


@pytest.mark.parametrize("options", [{}, {"sh_degree": 0}, {"sh_degree": 1, "refine": False}])
def test_the_last_updates_are_the_scene(data, options):
    with cogsplat.open(data) as file, file.stream(**options) as updates:
        seen = list(updates)
        last = joined(seen, file)
        assert all(update.is_complete for update in last)
        whole = file.decode(**options)
        start = 0
        for update in last:
            count = len(update.splats)
            assert_same(update.splats, whole, slice(start, start + count))
            start += count
    complete = [update.chunk for update in seen if update.is_complete]
    assert sorted(complete) == sorted(set(complete))


def test_chunks_come_coarse_first_over_a_network(data):
    with (
        serving(FaultServer(data, always=slow(2_000_000, 4096))) as server,
        cogsplat.open(server.url()) as file,
        file.stream() as updates,
    ):
        seen = list(updates)
        assert file.traffic.received_bytes <= len(data)
    assert len(seen) > file.num_chunks
    first = seen[0]
    assert (first.chunk, first.has_tail, first.is_complete) == (0, False, False)
    assert not first.splats.shN.any()
    with cogsplat.open(data) as local:
        head = local.decode([0], refine=False)
    assert np.array_equal(first.splats.means, head.means)


def test_chunks_that_are_here_come_once(data):
    with cogsplat.open(data) as file, file.stream() as updates:
        seen = list(updates)
        assert len(seen) == file.num_chunks
        assert all(update.is_complete for update in seen)


def test_priority_orders_chunks_and_leaves_some_out(data):
    wanted = {3: 5.0, 1: 7.0, 4: 0.0}
    with (
        serving(FaultServer(data)) as server,
        cogsplat.open(server.url()) as file,
        file.stream(priority=lambda chunk: wanted.get(chunk, -1.0)) as updates,
    ):
        complete = [update.chunk for update in updates if update.is_complete]
    assert complete == [1, 3, 4]


def test_async_iteration_gives_the_same(data):
    async def chunks():
        with cogsplat.open(data) as file, file.stream() as updates:
            return [(update.chunk, update.is_complete) async for update in updates]

    with cogsplat.open(data) as file, file.stream() as updates:
        assert asyncio.run(chunks()) == [(u.chunk, u.is_complete) for u in updates]


def test_a_cancelled_task_ends_the_requests(data):
    async def main(url):
        with cogsplat.open(url) as file, file.stream() as updates:

            async def use():
                async for _ in updates:
                    pass

            task = asyncio.create_task(use())
            await asyncio.sleep(0.1)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task

    with serving(FaultServer(data, [right], slow(2000, 100))) as server:
        asyncio.run(asyncio.wait_for(main(server.url()), 20))
    assert not [thread for thread in threading.enumerate() if "fetches" in thread.name]


def test_a_part_of_a_file_gives_what_is_there(data):
    size = len(data) * 2 // 3
    with cogsplat.open(data, size_bytes=size) as file, file.stream() as updates:
        seen = list(updates)
        assert {update.chunk for update in seen} == set(range(file.complete_chunks()))
        whole = file.decode()
    last = {update.chunk: update for update in seen}
    rows = np.concatenate([last[chunk].splats.means for chunk in sorted(last)])
    assert np.array_equal(rows, whole.means)


def test_misuse_and_ends(data):
    with cogsplat.open(data) as file:
        with pytest.raises(ValueError, match="SH degree"):
            file.stream(sh_degree=4)
        updates = file.stream()
        next(updates)
        updates.cancel()
        with pytest.raises(Cancelled):
            next(updates)
        updates = file.stream()
        updates.close()
        assert list(updates) == []
