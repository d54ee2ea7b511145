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
    """Transport double with a reader, which answers deliveries with given values."""

    mode, domain = "", 0

    def __init__(self, *_):
        self.delivered, self.receive = [], {}

    answers = ()

    def subscribe(self, topic, receive):
        self.receive[topic.key] = receive
        if topic.key == "state" and self.mode:
            receive(encode(message("std_msgs/msg/String", data=self.mode)))

    def publishers(self, topic):
        return ("/wbc_controller",)

    def advertise(self, topic):
        def publish(payload):
            self.delivered.append(decode(payload, topic.type).data)
            for values in self.answers[len(self.delivered) : len(self.delivered) + 1]:
                self.diagnose(values)

        return Mock(side_effect=publish)  # with a reader that acknowledges each message

    def diagnose(self, values):
        self.receive["diagnostics"](encode(diagnostics(1, 0, "wbc_controller: control loop", "active", "go2", values)))

    def close(self):
        pass


@pytest.mark.parametrize("mode", ["fault ESTOP: emergency stop by command", ""])
def test_emergency_stop_is_sent_first(monkeypatch, mode):
    monkeypatch.setattr(session, "DdsTransport", TransportDouble)
    monkeypatch.setattr(TransportDouble, "mode", mode)
    stop = Request("controller", "command", "", "estop", lambda _: message("std_msgs/msg/String", data="estop"))
    with Session(load("go2").settings, patience=0.01) as user:
        if mode:
            assert user.execute(stop).text == f"the controller is {mode}"
        else:
            monkeypatch.setattr(Session.until, "__defaults__", (0.01,))
            with pytest.raises(NoAnswer, match="was delivered, but the controller has not confirmed it"):
                user.execute(stop)
        assert user._transport.delivered == ["estop"]


class RecorderDouble(TransportDouble):
    """Controller double with the recorder's status before and after the request."""

    mode, before = "active", {}

    def subscribe(self, topic, receive):
        super().subscribe(topic, receive)
        if topic.key == "diagnostics":
            self.diagnose(self.before)


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
def test_recorder_answers_a_requested_recording(monkeypatch, before, behind, done, text):
    def values(said):
        return {"requests_taken": "0", "recorder": said[1], **({"recorder_said": said[0]} if said[0] else {})}

    monkeypatch.setattr(session, "DdsTransport", RecorderDouble)
    monkeypatch.setattr(RecorderDouble, "before", values(before))
    monkeypatch.setattr(RecorderDouble, "answers", ({}, values(behind)) if behind is not None else ())
    monkeypatch.setattr(Session.until, "__defaults__", (0.01,))
    config = load("go2")
    with Session(config.settings, patience=0.01) as user:
        if done is None:
            with pytest.raises(NoAnswer, match=text):
                user.execute(parse_request(["record", "it"], config.settings))
        else:
            answer = user.execute(parse_request(["record", "it"], config.settings))
            assert (answer.done, answer.text) == (done, text)
        assert user._transport.delivered == ([] if behind is None else ["it"])


class WalkingDouble(TransportDouble):
    """Double of a walking robot with a mock robot; `sent` lists velocities and hoist requests."""

    values = ()

    def __init__(self, *_):
        super().__init__()
        self.sent = []

    def stream(self, topic, depth):
        texts = [encode(diagnostics(1, 0, "other", "", "", {"mode": "active", "walking/phase": "stand"}))]
        texts += [encode(diagnostics(1, 0, "wbc_controller: control loop", "", "", each)) for each in self.values]
        return SimpleNamespace(take=lambda: [texts.pop(0)] if texts else [])

    def advertise(self, topic):
        def publish(payload):
            content = decode(payload, topic.type)
            self.sent.append(content.linear.x if topic.key == "cmd_vel" else content.data)

        return Mock(side_effect=publish)


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
def test_a_walking_robot_stands_before_the_hoist_lifts_it(monkeypatch, robot, word, values, sent):
    monkeypatch.setattr(session, "DdsTransport", WalkingDouble)
    monkeypatch.setattr(session, "_STATUS_PATIENCE", 0.2)
    monkeypatch.setattr(WalkingDouble, "values", [{"mode": mode, "walking/phase": phase} for mode, phase in values])
    settings = load("go2").replace({"walking": None}).settings if robot == "standing_go2" else load(robot).settings
    with Session(settings, patience=0.01) as user:
        user.execute(parse_request([word], settings))
        assert user._transport.sent == sent
