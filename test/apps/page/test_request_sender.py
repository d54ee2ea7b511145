"""Requests of the pages are sent at a bounded rate, in order, and never repeated."""

from unittest.mock import Mock

import pytest
from waiting import until

from wbc_controller.apps.page.request_sender import MAX_AGE, PERIOD, RequestSender
from wbc_controller.apps.terminal.session import NoAnswer
from wbc_controller.settings.files import find_configuration, load_settings

SETTINGS = load_settings(find_configuration("g1"))


class Rig:
    def __init__(self):
        self.sent, self.told, self.now = [], [], 100.0
        self.sender = RequestSender(SETTINGS, self.send, lambda *told: self.told.append(told), lambda: self.now)

    def send(self, request):
        self.sent.append((request.key, request.subject, request.summary))

    def drag(self, x, client=1, task="com"):
        self.sender.drag(f"setpoint {task}", client, [task, "to", f"{x}", "0", "0.6"])

    def send_due_drags(self, later=0.0):
        self.now += later
        self.sender.send_due_drags()
        said, self.sent = [said for _, _, said in self.sent], []
        return said


@pytest.fixture
def rig():
    return Rig()


def test_newest_drag_is_sent_once_per_period(rig):
    sent = []
    for i in range(100):  # 1 s of events, 100 per second
        rig.drag(i / 100.0)
        sent += rig.send_due_drags(0.01)
    assert 19 <= len(sent) <= 21
    sent += rig.send_due_drags(PERIOD)
    assert "com goes to 0.99 0 0.6" in sent[-1]


def test_drags_are_sent_once_and_separately_unless_stale_or_closed(rig):
    rig.drag(0.1)
    assert len(rig.send_due_drags()) == 1
    assert [rig.send_due_drags(0.1) for _ in range(50)] == [[]] * 50
    rig.drag(0.1)
    rig.drag(0.2, task="left_hand", client=2)
    assert len(rig.send_due_drags()) == 2
    rig.drag(0.1, client=1)
    rig.drag(0.2, client=2, task="left_hand")
    rig.sender.drop_drags(1)
    (said,) = rig.send_due_drags(0.1)
    assert said.startswith("left_hand")
    rig.drag(0.1)
    assert rig.send_due_drags(MAX_AGE + 0.01) == []


def test_emergency_stop_overtakes_requests_and_drops_drags(rig):
    rig.sender.send_words("activate")  # it stays in the queue: the thread is not running
    rig.drag(0.1)
    rig.sender.send_words("estop")
    assert [said for _, _, said in rig.sent] == ["estop"]
    rig.sent.clear()
    assert rig.send_due_drags(1.0) == []


def test_requests_are_sent_in_order_and_invalid_ones_reported(rig):
    rig.sender.start()
    for words in ("weight com 30", "task left_hand on", "left_hand nowhere", "contact left_foot off"):
        rig.sender.send_words(*words.split())
    until(lambda: len(rig.told) == 4, patience=10.0)
    rig.sender.close()
    assert [key for key, _, _ in rig.sent] == ["weight", "task_enable", "contact_enable"]
    assert [words for words, error in rig.told if error] == ["left_hand nowhere"]


def test_error_does_not_end_the_sender(rig, monkeypatch, caplog):
    rig.sender.start()
    with monkeypatch.context() as patch:
        fails = Mock(side_effect=ValueError("cannot read"))
        patch.setattr("wbc_controller.apps.page.request_sender.parse_request", fails)
        rig.drag(0.1)
        until(lambda: rig.told, patience=10.0)
        rig.sender.send_words("activate")
    assert [words for words, _ in rig.told] == ["com to 0.1 0 0.6", "activate"]
    assert all("parsing failed: cannot read" in error for _, error in rig.told)
    assert caplog.text.count("parsing of the request") == 2
    rig.sender.send_words("deactivate")
    until(lambda: len(rig.told) == 3, patience=10.0)
    rig.sender.close()
    assert [said for _, _, said in rig.sent] == ["deactivate"]


def test_missing_controller_is_reported(rig):
    nobody = Mock(side_effect=NoAnswer("no controller is there"))
    sender = RequestSender(SETTINGS, nobody, lambda *told: rig.told.append(told))
    sender.send_words("estop")
    assert rig.told == [("estop", "no controller is there")]


def test_full_queue_is_reported(rig):
    for _ in range(300):
        rig.sender.send_words("activate")
    assert {error for _, error in rig.told} == {"dropped: the queue of 200 requests is full"}
    rig.sender.close()
