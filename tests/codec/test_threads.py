import os
import subprocess
import sys
import threading

import pytest
from threadpoolctl import threadpool_info

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


def test_threads_are_used_again():
    for _ in range(2):
        list(ordered_map(lambda k: k, range(10), 3))
    before = threading.active_count()
    for _ in range(20):
        list(ordered_map(lambda k: k, range(10), 3))
    assert threading.active_count() == before


def test_work_inside_of_work_has_threads_of_its_own():
    gate = threading.Barrier(2, timeout=10)

    def inner(item):
        gate.wait()
        return item

    def outer(item):
        return sum(ordered_map(inner, range(2), 2)) + item

    # One after the other meets at the gate: each pair of inner items needs two threads at once.
    assert list(ordered_map(outer, range(1), 2)) == [1]
    assert list(ordered_map(outer, range(3), 1)) == [1, 2, 3]


def test_threads_that_an_interrupt_left_half_started_end_with_the_work(monkeypatch):
    """Python registers a thread that is to end with the process only after it has started."""
    started = []
    start = threading.Thread.start

    def interrupted(thread):
        start(thread)
        started.append(thread)
        raise KeyboardInterrupt

    monkeypatch.setattr(threading.Thread, "start", interrupted)
    with pytest.raises(KeyboardInterrupt):
        list(ordered_map(lambda k: k, range(10), 97))
    (thread,) = started
    thread.join(10)
    assert not thread.is_alive()


def test_nothing_runs_on_once_the_caller_has_left():
    running, gate = threading.Event(), threading.Event()
    done = []

    def work(item):
        if item:
            running.set()
            gate.wait(10)
            done.append(item)
        return item

    results = ordered_map(work, range(100), 2)
    assert next(results) == 0
    running.wait(10)
    gate.set()
    results.close()
    finished = len(done)
    assert list(ordered_map(lambda k: k, range(10), 2)) == list(range(10))
    assert len(done) == finished < 10


@pytest.mark.skipif(not hasattr(os, "fork"), reason="only POSIX has fork")
def test_a_forked_process_starts_threads_of_its_own():
    code = (
        "import os, sys, warnings\n"
        "from cogsplat.codec.threads import ordered_map\n"
        "work = lambda: list(ordered_map(abs, range(4), 2))\n"
        "work()\n"
        "warnings.simplefilter('ignore')\n"
        "child = os.fork()\n"
        "if child == 0:\n"
        "    os._exit(0 if work() == [0, 1, 2, 3] else 1)\n"
        "sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0


def blas_threads():
    return [each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"]


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
