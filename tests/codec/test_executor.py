"""Executor of this process: results in order for any number of threads."""

import threading

import pytest

from cogsplat.codec.executor import LocalThreads


@pytest.mark.parametrize("threads", [1, 3])
def test_results_come_in_the_order_of_the_items(threads):
    shared = object()
    seen = []

    def work(item, *given):
        seen.append(threading.get_ident())
        return item * item, given

    found = list(LocalThreads(threads).map(work, range(20), shared, 7))
    assert found == [(item * item, (shared, 7)) for item in range(20)]
    assert len(seen) == 20


def test_what_a_call_raises_reaches_the_caller_at_its_place():
    found = LocalThreads(2).map(lambda item, top: top // item, [2, 1, 0], 10)
    assert [next(found), next(found)] == [5, 10]
    with pytest.raises(ZeroDivisionError):
        next(found)
