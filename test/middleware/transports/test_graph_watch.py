"""Other publishers: reported at each change, unnamed nodes after the second check."""

import threading

import pytest

from wbc_controller.errors import TransportError
from wbc_controller.middleware.topics import NEWEST_OUT, Direction, Endpoint
from wbc_controller.middleware.transports import graph_watch
from wbc_controller.middleware.transports.graph_watch import GraphWatch
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.middleware.transports.transport import UNNAMED

TOPICS = [Endpoint(key, "", f"/{key}", "std_msgs/msg/String", Direction.OUT, NEWEST_OUT) for key in ("odom", "effort")]


def test_each_change_is_reported_once():
    bus, told = MemoryBus(), []
    own, other = MemoryTransport(bus, "own"), MemoryTransport(bus, "other")
    watch = GraphWatch(own, TOPICS, told.append)
    watch.check()
    own.advertise(TOPICS[0])
    watch.check()
    assert told == []
    other.advertise(TOPICS[0])
    watch.check()
    watch.check()
    other.close()
    watch.check()
    assert told == [{"odom": ("/other",), "effort": ()}, {"odom": (), "effort": ()}]


def test_a_pending_name_is_not_reported_as_unnamed(monkeypatch):
    transport, told, graph = MemoryTransport(MemoryBus()), [], {"odom": (), "effort": ()}
    monkeypatch.setattr(transport, "publishers", lambda endpoint: graph[endpoint.key])
    watch = GraphWatch(transport, TOPICS, told.append)
    graph["odom"] = (UNNAMED,)
    watch.check()
    graph["odom"] = ("/guard",)
    watch.check()
    assert told == [{"odom": ("/guard",), "effort": ()}]
    graph["odom"] = (UNNAMED, "/guard")
    watch.check()
    assert len(told) == 1
    watch.check()
    assert told[1:] == [{"odom": (UNNAMED, "/guard"), "effort": ()}]


def test_the_thread_checks_until_stopped(monkeypatch):
    monkeypatch.setattr(graph_watch, "PERIOD", 0.001)
    bus, changed = MemoryBus(), threading.Event()
    own, other = MemoryTransport(bus, "own"), MemoryTransport(bus, "other")
    watch = GraphWatch(own, TOPICS, lambda others: changed.set())
    watch.start()
    assert not changed.is_set()
    other.advertise(TOPICS[1])
    assert changed.wait(20.0)
    watch.stop()
    changed.clear()
    other.close()
    assert not changed.wait(0.05)
    watch.stop()


def test_an_unreadable_graph_is_logged(monkeypatch, caplog):
    monkeypatch.setattr(graph_watch, "PERIOD", 0.001)
    own = MemoryTransport(MemoryBus(), "own")
    watch = GraphWatch(own, TOPICS, lambda others: None)
    watch.start()
    own.close()
    watch._thread.join(20.0)
    assert "the check for other publishers has ended" in caplog.text
    watch.stop()
    with pytest.raises(TransportError, match="/odom"):
        watch.check()
