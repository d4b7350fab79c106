import threading

import pytest

from cogsplat.codec.threads import one_blas_thread, ordered_map, thread_count


def test_zero_threads_means_at_least_one():
    assert thread_count(0) >= 1
    assert thread_count(7) == 7


def test_negative_threads_are_refused():
    with pytest.raises(ValueError, match="-1 threads"):
        thread_count(-1)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_the_order_of_the_items(threads):
    assert list(ordered_map(lambda k: k * k, range(50), threads)) == [k * k for k in range(50)]


def test_slow_first_item_does_not_let_others_overtake():
    gate = threading.Event()

    def work(item):
        if item == 0:
            gate.wait(10)
        if item == 2:
            gate.set()
        return item

    assert list(ordered_map(work, range(5), 2)) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("threads", [1, 3])
def test_items_are_taken_as_they_are_needed(threads):
    taken = []

    def items():
        for k in range(100):
            taken.append(k)
            yield k

    results = ordered_map(lambda k: k, items(), threads)
    assert next(results) == 0
    assert len(taken) <= threads + 2
    results.close()


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_reaches_the_caller_and_ends_the_work(threads):
    started = []

    def work(item):
        started.append(item)
        if item == 3:
            raise RuntimeError("three")
        return item

    with pytest.raises(RuntimeError, match="three"):
        list(ordered_map(work, range(1000), threads))
    assert len(started) < 20


def blas_threads():
    info = pytest.importorskip("threadpoolctl").threadpool_info()
    return [library["num_threads"] for library in info if library["user_api"] == "blas"]


def test_blas_works_on_one_thread_in_a_block_and_in_threads_that_it_starts():
    before = blas_threads()
    ones = [1] * len(before)
    with one_blas_thread():
        with one_blas_thread():
            assert blas_threads() == ones
        assert blas_threads() == ones
        assert list(ordered_map(lambda _: blas_threads(), range(4), 2)) == [ones] * 4
    assert blas_threads() == before


def test_blas_has_its_threads_back_after_an_error():
    before = blas_threads()
    with pytest.raises(ZeroDivisionError), one_blas_thread():
        1 / 0  # noqa: B018 - raises
    assert blas_threads() == before
