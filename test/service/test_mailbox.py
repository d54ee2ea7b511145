import threading

from wbc_controller.service.clock import ManualClock
from wbc_controller.service.mailbox import Mailbox


def test_it_keeps_the_newest_and_when_it_came():
    clock = ManualClock(1.0)
    box = Mailbox(clock)
    box.put(b"old")
    clock.time = 2.0
    box.put(b"new")
    assert box.take() == [(2.0, b"new")]
    assert box.take() == []


def test_it_keeps_as_many_as_it_has_room_for():
    clock = ManualClock()
    box = Mailbox(clock, depth=3)
    for i in range(5):
        clock.time = float(i)
        box.put(bytes([i]))
    assert box.take() == [(2.0, b"\2"), (3.0, b"\3"), (4.0, b"\4")]


def test_each_message_sets_the_event():
    arrived = threading.Event()
    box = Mailbox(ManualClock(), arrived)
    assert not arrived.is_set()
    box.put(b"")
    assert arrived.is_set()
