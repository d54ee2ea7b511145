"""Pushes of the mock robot by drags on its links."""

from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
import viser

from wbc_controller.apps.page.drawing import Drawing
from wbc_controller.apps.page.request_sender import RequestSender
from wbc_controller.apps.page.snapshot import Robot
from wbc_controller.apps.terminal.request_parser import Request
from wbc_controller.middleware.codec import wrench_stamped
from wbc_controller.records import Array

KEY = "shift"  # modifier key; a drag without it turns the view
_FORCE_PER_METRE, _MAX_FORCE = 0.8, 1.0  # force per length of a pull, 1/m, and largest force, in weights of the robot
_MIN_LENGTH = 0.02  # length below which a pull is ignored, m
_COLOR = (255, 120, 30)


class LinkPushes:
    """Accepts pulls from all pages while `enabled`."""

    def __init__(self, server: viser.ViserServer, robot: Robot, drawing: Drawing, sender: RequestSender) -> None:
        self._server, self._robot, self._sender = server, robot, sender
        self._drawing = drawing
        self._pulls: dict[int, Any] = {}
        self.enabled = False
        for handle, joint in drawing.links:
            handle.on_drag("left", modifier=KEY)(partial(self._pulled, joint))

    async def _pulled(self, joint: int, event: Any) -> None:
        client = int(event.client_id)
        start, end = np.array(event.start_position), np.array(event.end_position)
        force = self._force(end - start)
        closed = client not in self._server.get_clients()  # viser also ends the drags of a closed page
        if event.phase != "end" and self.enabled and not closed:
            self._draw(client, start, end, force)
            return
        self.end_drags(client)
        if self.enabled and not closed and force.any():
            self._sender.request(self._request(joint, start, force))

    def _force(self, pull: Array) -> Array:
        """Return the force of a pull, (3,) in N: zero below the smallest length, bounded above."""
        length = float(np.linalg.norm(pull))
        weight = self._robot.model.mass * self._robot.model.gravity
        if not length >= _MIN_LENGTH:
            return np.zeros(3)
        return np.asarray(pull / length * weight * min(_MAX_FORCE, _FORCE_PER_METRE * length))

    def _request(self, joint: int, at: Array, force: Array) -> Request:
        """Return a push at the nearest link moved by a joint, at the start of the pull."""
        frames = [each for each in self._robot.model.pinocchio.frames if each.parentJoint == joint]
        links = [frame for frame in frames if frame.type == pin.BODY]
        link = min(links, key=lambda frame: float(np.linalg.norm(frame.placement.translation)))
        origin = (self._drawing.placements[joint] * link.placement).translation
        wrench, name = np.concatenate([force, np.cross(at - origin, force)]), str(link.name)
        duration = self._robot.settings.mock.push_duration
        summary = f"a push of {np.linalg.norm(force):.0f} N for {duration:g} s at {name}"
        return Request("mock", "push", "", summary, lambda wait_for_message: wrench_stamped(wrench, name), name)

    def _draw(self, client: int, start: Array, end: Array, force: Array) -> None:
        name, points = f"/pulls/{client}", np.array([[start, end]], dtype=np.float32)
        text = f"{np.linalg.norm(force):.0f} N"
        if client in self._pulls:
            arrow, label = self._pulls[client]
            arrow.points, label.position, label.text = points, end, text
            return
        arrow = self._server.scene.add_arrows(
            f"{name}/arrow", points, _COLOR, shaft_radius=0.008, head_radius=0.02, head_length=0.05
        )
        self._pulls[client] = arrow, self._server.scene.add_label(f"{name}/force", text, position=end)

    def end_drags(self, client: int) -> None:
        """End the pull of a closed page."""
        for handle in self._pulls.pop(client, ()):
            handle.remove()
