"""Requests of a user and their outcomes, on a transport double."""

from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from wbc_controller.apps.terminal import session
from wbc_controller.apps.terminal.request_parser import Request, parse_request
from wbc_controller.apps.terminal.session import NoAnswer, Session
from wbc_controller.middleware.codec import decode, diagnostics, encode, message
from wbc_controller.settings.config import load


class TransportDouble:
    """Transport with a controller that acknowledges each message.

    It sends its next status after a subscription of the diagnostics and after each message; a stream takes one at a
    time, first that of another node.
    """

    domain = 0

    def __init__(self, mode, statuses):
        self.delivered, self._mode, self._receive = [], mode, {}
        self._statuses = [diagnostics(1, 0, "wbc_controller: control loop", "", "go2", values) for values in statuses]

    def publishers(self, topic):
        return ("/wbc_controller",)

    def subscribe(self, topic, receive):
        self._receive[topic.key] = receive
        if topic.key == "state" and self._mode:
            receive(encode(message("std_msgs/msg/String", data=self._mode)))
        self._diagnose(topic)

    def stream(self, topic, depth):
        other = diagnostics(1, 0, "other", "", "", {"mode": "active", "walking/phase": "stand"})
        left = [encode(status) for status in (other, *self._statuses)]
        return SimpleNamespace(take=lambda: [left.pop(0)] if left else [])

    def advertise(self, topic):
        def publish(payload):
            content = decode(payload, topic.type)
            self.delivered.append(content.linear.x if topic.key == "cmd_vel" else content.data)
            self._diagnose(topic)

        return Mock(side_effect=publish)

    def _diagnose(self, topic):
        if self._statuses and topic.key in ("diagnostics", "record"):
            self._receive["diagnostics"](encode(self._statuses.pop(0)))

    def close(self):
        pass


@pytest.fixture
def join(monkeypatch):
    """Return a function that joins a controller in a mode, which sends some statuses."""
    monkeypatch.setattr(Session.until, "__defaults__", (0.01,))
    monkeypatch.setattr(session, "_STATUS_PATIENCE", 0.2)

    def join(settings, mode, *statuses):
        monkeypatch.setattr(session, "DdsTransport", lambda *_: TransportDouble(mode, statuses))
        return Session(settings, patience=0.01)

    return join


@pytest.mark.parametrize("mode", ["fault ESTOP: emergency stop by command", ""])
def test_emergency_stop_is_sent_first(join, mode):
    stop = Request("controller", "command", "", "estop", lambda _: message("std_msgs/msg/String", data="estop"))
    with join(load("go2").settings, mode) as user:
        if mode:
            assert user.execute(stop).text == f"the controller is {mode}"
        else:
            with pytest.raises(NoAnswer, match="was delivered, but the controller has not confirmed it"):
                user.execute(stop)
        assert user._transport.delivered == ["estop"]


WRITTEN = "1", "file written"


@pytest.mark.parametrize(
    ("before", "behind", "done", "text"),
    [
        (("0", "the last 10 s are kept"), WRITTEN, True, "file written"),
        (WRITTEN, ("2", "file written"), True, "file written"),
        (("", "nothing is recorded"), None, False, "refused: nothing is recorded"),
        (WRITTEN, WRITTEN, None, "no answer from the recorder; its last status: file written"),
    ],
)
def test_recorder_answers_a_requested_recording(join, before, behind, done, text):
    statuses = [
        {"requests_taken": "0", "recorder": said[1], **({"recorder_said": said[0]} if said[0] else {})}
        for said in (before, behind)
        if said is not None
    ]
    settings = load("go2").settings
    with join(settings, "active", *statuses) as user:
        if done is None:
            with pytest.raises(NoAnswer, match=text):
                user.execute(parse_request(["record", "it"], settings))
        else:
            answer = user.execute(parse_request(["record", "it"], settings))
            assert (answer.done, answer.text) == (done, text)
        assert user._transport.delivered == ([] if behind is None else ["it"])


@pytest.mark.parametrize(
    ("robot", "word", "values", "sent"),
    [
        ("g1", "hold", [("active", "single support"), ("active", "stop"), ("active", "stand")], [0.0, 0.0, True]),
        ("g1", "hold", [("damping", "single support")], [True]),
        ("g1", "hold", [], [True]),  # no controller
        ("g1", "release", [("active", "single support")], [False]),
        ("go2", "hold", [("active", "single support"), ("active", "stand")], [0.0, True]),
        ("standing_go2", "hold", [("active", "single support")], [True]),
    ],
)
def test_a_walking_robot_stands_before_the_hoist_lifts_it(join, robot, word, values, sent):
    settings = load("go2").replace({"walking": None}).settings if robot == "standing_go2" else load(robot).settings
    with join(settings, "", *({"mode": mode, "walking/phase": phase} for mode, phase in values)) as user:
        user.execute(parse_request([word], settings))
        assert user._transport.delivered == sent
