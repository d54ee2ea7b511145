"""The conversation of a user with the nodes, on a transport that delivers and hears nothing by itself."""

from __future__ import annotations

import pytest

from wbc_controller.settings.config import load
from wbc_controller.user import session
from wbc_controller.user.sentences import Request
from wbc_controller.user.session import NoAnswer, Session
from wbc_controller.wire.messages import decode, encode, message


class Line:
    """A transport with a reader at the other end, which answers a delivery with the mode it is given."""

    mode, domain = "", 0

    def __init__(self, *_):
        self.delivered, self.receive = [], {}

    def subscribe(self, topic, receive):
        self.receive[topic.key] = receive

    def deliver(self, topic, payload, *_):
        self.delivered.append(decode(payload, topic.type).data)
        if self.mode:
            self.receive["state"](encode(message("std_msgs/msg/String", data=self.mode)))
        return True

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
