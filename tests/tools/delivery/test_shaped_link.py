import asyncio
import time

from cogsplat.tools.delivery.shaped_link import MAX_LARGE_BLOCKS, LinkQuality, ShapedLink


def test_answers_share_the_bandwidth():
    link = ShapedLink(LinkQuality(bits_per_second=8e6))

    async def answer():
        for _ in range(10):
            await link.wait(10_000)

    async def three():
        await asyncio.gather(answer(), answer(), answer())

    start = time.monotonic()
    asyncio.run(three())
    assert time.monotonic() - start >= 0.3 - 0.001


def test_an_unlimited_link_never_waits_or_fails():
    link = ShapedLink(LinkQuality())

    async def use():
        await link.wait(1 << 40)
        return [await link.begin() for _ in range(100)]

    assert not any(asyncio.run(use()))
    assert [link.breaks_at(100) for _ in range(100)] == [None] * 100
    assert link.block_bytes(MAX_LARGE_BLOCKS) == 65536
    assert link.block_bytes(MAX_LARGE_BLOCKS + 1) == 32768
    assert ShapedLink(LinkQuality(bits_per_second=1e6)).block_bytes(1) == 750


def test_chance_has_its_share_and_its_seed():
    def run(seed):
        link = ShapedLink(LinkQuality(loss=0.3, fail_rate=0.2, seed=seed))

        async def begin():
            return [await link.begin() for _ in range(1000)]

        return asyncio.run(begin()), [link.breaks_at(500) for _ in range(1000)]

    failed, broken = run(1)
    assert 150 < sum(failed) < 250
    assert 240 < sum(at is not None for at in broken) < 360
    assert all(0 <= at < 500 for at in broken if at is not None)
    assert run(1) == (failed, broken)
    assert run(2) != (failed, broken)


def test_latency_is_waited_for():
    link = ShapedLink(LinkQuality(latency_seconds=0.05))
    start = time.monotonic()
    asyncio.run(link.begin())
    assert time.monotonic() - start >= 0.05
