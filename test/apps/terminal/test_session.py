"""The conversation of a user with the nodes, on a transport that delivers and hears nothing by itself."""

from __future__ import annotations

import pytest

from wbc_controller.apps.terminal import session
from wbc_controller.apps.terminal.request_parser import Request, parse_request
from wbc_controller.apps.terminal.session import NoAnswer, Session
from wbc_controller.middleware.codec import decode, diagnostics, encode, message
from wbc_controller.settings.config import load


class Line:
    """A transport with a reader at the other end, which answers a delivery with the mode it is given."""

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

    def deliver(self, topic, payload, *_):
        self.delivered.append(decode(payload, topic.type).data)
        for values in self.answers[len(self.delivered) : len(self.delivered) + 1]:
            self.diagnose(values)
        return True

    def diagnose(self, values):
        self.receive["diagnostics"](encode(diagnostics(1, 0, "wbc_controller: control loop", "active", "go2", values)))

    def close(self):
        pass


@pytest.mark.parametrize("mode", ["fault ESTOP: emergency stop by command", ""])
def test_an_emergency_stop_waits_for_no_word_of_the_controller(monkeypatch, mode):
    monkeypatch.setattr(session, "DdsTransport", Line)
    monkeypatch.setattr(Line, "mode", mode)
    stop = Request("controller", "command", "", "estop", lambda _: message("std_msgs/msg/String", data="estop"))
    with Session(load("go2").settings, patience=0.01) as user:
        if mode:
            assert user.ask(stop).sentence == f"the controller is {mode}"
        else:
            monkeypatch.setattr(Session.until, "__defaults__", (0.01,))
            with pytest.raises(NoAnswer, match="is delivered; the controller has not confirmed it"):
                user.ask(stop)
        assert user._transport.delivered == ["estop"]


class Recording(Line):
    """A controller that says what its recorder has said, before the request and behind it."""

    mode, before = "active", {}

    def subscribe(self, topic, receive):
        super().subscribe(topic, receive)
        if topic.key == "diagnostics":
            self.diagnose(self.before)


@pytest.mark.parametrize(
    ("before", "behind", "done", "sentence"),
    [
        (("0", "the last 10 s are kept"), ("1", "it is written"), True, "it is written"),
        (("1", "it is written"), ("2", "it is written"), True, "it is written"),
        (("", "nothing is recorded"), None, False, "refused: nothing is recorded"),
        (("1", "it is written"), ("1", "it is written"), None, "does not answer; its last status: it is written"),
    ],
)
def test_a_recording_that_is_asked_for_is_answered_by_the_recorder(monkeypatch, before, behind, done, sentence):
    def values(said):
        return {"requests_taken": "0", "recorder": said[1], **({"recorder_said": said[0]} if said[0] else {})}

    monkeypatch.setattr(session, "DdsTransport", Recording)
    monkeypatch.setattr(Recording, "before", values(before))
    monkeypatch.setattr(Recording, "answers", ({}, values(behind)) if behind is not None else ())
    monkeypatch.setattr(Session.until, "__defaults__", (0.01,))
    config = load("go2")
    with Session(config.settings, patience=0.01) as user:
        if done is None:
            with pytest.raises(NoAnswer, match=sentence):
                user.ask(parse_request(["record", "it"], config.settings))
        else:
            answer = user.ask(parse_request(["record", "it"], config.settings))
            assert (answer.done, answer.sentence) == (done, sentence)
        assert user._transport.delivered == ([] if behind is None else ["it"])
