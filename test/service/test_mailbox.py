import threading

from wbc_controller.service.clock import ManualClock
from wbc_controller.service.mailbox import Mailbox


def test_a_box_of_one_keeps_the_newest_and_when_it_came():
    clock = ManualClock(1.0)
    box = Mailbox(clock, 1)
    box.put(b"old")
    clock.time = 2.0
    box.put(b"new")
    assert box.take() == ([(2.0, b"new")], 0)
    assert box.take() == ([], 0)


def test_a_queue_keeps_the_order_and_turns_the_newest_away_when_it_is_full():
    box = Mailbox(ManualClock(), 3)
    for payload in (b"1", b"2", b"3", b"4", b"5"):
        box.put(payload)
    messages, turned_away = box.take()
    assert [payload for _, payload in messages] == [b"1", b"2", b"3"]
    assert turned_away == 2
    box.put(b"6")
    assert box.take() == ([(0.0, b"6")], 0)


def test_each_message_sets_the_event():
    arrived = threading.Event()
    box = Mailbox(ManualClock(), 1, arrived)
    assert not arrived.is_set()
    box.put(b"")
    assert arrived.is_set()


def test_nothing_is_lost_between_a_writing_and_a_reading_thread():
    box = Mailbox(ManualClock(), 50)
    sent = 20_000
    taken, turned_away = [], 0

    def write():
        for i in range(sent):
            box.put(str(i).encode())

    thread = threading.Thread(target=write)
    thread.start()
    while thread.is_alive():
        messages, lost = box.take()
        taken += [int(payload) for _, payload in messages]
        turned_away += lost
    messages, lost = box.take()
    taken += [int(payload) for _, payload in messages]
    assert len(taken) + turned_away + lost == sent
    assert taken == sorted(set(taken))
