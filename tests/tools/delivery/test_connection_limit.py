"""Connections are limited in number; the longest idle ones are closed, and none that work."""

import resource

import pytest

from cogsplat.tools.delivery import connection_limit
from cogsplat.tools.delivery.connection_limit import (
    CROWDED_IDLE_SECONDS,
    IDLE_SECONDS,
    MAX_CONNECTIONS,
    OpenConnections,
)


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still; its one entry is the time."""
    now = [1000.0]
    monkeypatch.setattr(connection_limit.time, "monotonic", lambda: now[0])
    return now


@pytest.fixture
def closed():
    return []


def test_there_is_room_below_the_limit_only(clock, closed):
    connections = OpenConnections(2)
    for key in "ab":
        assert connections.has_room()
        connections.add(key, lambda key=key: closed.append(key))
    assert not connections.has_room()
    connections.remove("a")
    connections.remove("a")
    assert connections.has_room()
    assert (len(connections), closed) == (1, [])


def test_the_longest_idle_ones_make_room(clock, closed, monkeypatch):
    monkeypatch.setattr(connection_limit, "_CLOSED_AT_ONCE", 1)
    connections = OpenConnections(3)
    for key in "abc":
        connections.add(key, lambda key=key: closed.append(key))
        clock[0] += 1
    connections["a"].progress()
    clock[0] += CROWDED_IDLE_SECONDS - 2.5
    assert not connections.has_room()
    assert closed == []
    clock[0] += 1
    for _ in range(3):
        assert not connections.has_room()
    # Each is closed once, and only those that were idle for long enough.
    assert closed == ["b"]
    clock[0] += CROWDED_IDLE_SECONDS
    connections.remove("b")
    connections.add("d", lambda: closed.append("d"))
    for _ in range(5):
        connections.has_room()
        connections.remove(closed[-1])
    assert closed == ["b", "c"]
    connections.add("e", lambda: closed.append("e"))
    connections.has_room()
    assert closed == ["b", "c", "a"]


def test_idle_connections_are_closed_in_time(clock, closed):
    connections = OpenConnections(10)
    for key in "ab":
        connections.add(key, lambda key=key: closed.append(key))
    clock[0] += IDLE_SECONDS - 1
    connections["b"].progress()
    connections.close_idle()
    assert closed == []
    clock[0] += 2
    connections.close_idle()
    assert closed == ["a"]


def test_a_connection_is_idle_only_while_its_peer_is_waited_for(clock):
    connection = OpenConnections(1).add("a", lambda: None)
    clock[0] += 3
    assert connection.idle_seconds() == 3
    with connection.working():
        clock[0] += 100
        assert connection.idle_seconds() == 0
        with connection.sending():
            clock[0] += 5
            assert connection.idle_seconds() == 5
            with connection.working():
                assert connection.idle_seconds() == 0
        assert connection.idle_seconds() == 0
    assert connection.idle_seconds() == 0
    clock[0] += 2
    assert connection.idle_seconds() == 2


@pytest.mark.parametrize(
    ("descriptors", "limit"),
    [(256, 192), (1024, MAX_CONNECTIONS), (10, 1), (resource.RLIM_INFINITY, MAX_CONNECTIONS)],
)
def test_the_limit_leaves_descriptors_for_files(monkeypatch, descriptors, limit):
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (descriptors, descriptors))
    assert connection_limit.connection_limit() == limit
