"""Controls of walking."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import viser

from wbc_controller.apps.page.request_sender import RequestSender
from wbc_controller.apps.terminal.request_parser import Request
from wbc_controller.middleware.setpoints import velocity_message
from wbc_controller.settings import WalkingSettings

#: Messages per second of a held button.
RATE = 10.0
#: Label, first value, and default maximum of each slider, m/s or rad/s.
_SLIDERS = (("Forward [m/s]", 0.2, 0.5), ("To the left [m/s]", 0.0, 0.3), ("Turn left [rad/s]", 0.0, 0.5))


class WalkControls:
    """Folder `Walking`. A released button and a closed page send nothing: the robot stops by its timeout."""

    def __init__(self, server: viser.ViserServer, settings: WalkingSettings, sender: RequestSender) -> None:
        self._sender = sender
        gui, largest = server.gui, (settings.max_speed, settings.max_side_speed, settings.max_turn_rate)
        with gui.add_folder("Walking"):
            walk = gui.add_button("Walk", color="green", hint="Hold to walk at this velocity; release to stop.")
            stand = gui.add_button("Stand", color="gray", hint="Stop after the next steps.")
            self._sliders: list[Any] = []
            for (label, first, default), limit in zip(_SLIDERS, largest, strict=True):
                most = default if limit is None else limit
                self._sliders.append(gui.add_slider(label, -most, most, 0.01, min(first, most)))
        walk.on_hold(self._held, callback_hz=RATE)
        stand.on_click(lambda event: sender.request(_request((0.0, 0.0, 0.0), "the robot stops walking")))

    async def _held(self, event: Any) -> None:
        velocity = [slider.value for slider in self._sliders]
        self._sender.drag("walk", event.client_id, _request(velocity, "walk"))


def _request(velocity: Sequence[float], summary: str) -> Request:
    return Request("controller", "cmd_vel", "", summary, lambda _: velocity_message(velocity))
