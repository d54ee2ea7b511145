"""Shoves of the mock robot: who pulls on a link sees an arrow, and lets go to shove it so hard."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import viser

from wbc_controller.apps.page.drawing import Drawing
from wbc_controller.apps.page.moment import Robot
from wbc_controller.apps.page.sending import Sender
from wbc_controller.apps.terminal.sentences import Request
from wbc_controller.middleware.setpoints import wrench_stamped
from wbc_controller.records import Array

#: Key that is held to pull: without it the same motion of the mouse turns the view.
KEY = "shift"
#: Force of a pull of 1 m, and of the longest pull, in weights of the robot.
_PER_METRE, _MOST = 0.8, 1.0
#: Pulls that are shorter are no pulls, m.
_SHORTEST = 0.02
_COLOR = (255, 120, 30)


class Shoves:
    """Lets every page pull on the robot's links."""

    def __init__(self, server: viser.ViserServer, robot: Robot, drawing: Drawing, sender: Sender) -> None:
        """Make every link something to pull on.

        Args:
            server: whose scene it is.
            robot: the robot.
            drawing: has its links.
            sender: sends the shoves.
        """
        self._server, self._robot, self._sender = server, robot, sender
        self._drawing = drawing
        self._pulls: dict[int, Any] = {}
        self.enabled = False
        self._links = {joint: _link_of(robot.model.pinocchio, joint) for _, joint in drawing.links}
        for handle, joint in drawing.links:
            handle.on_drag("left", modifier=KEY)(self._pulled(joint))

    def let_go(self, client: int) -> None:
        """End the pull of a page that has gone."""
        self._clear(client)

    def _pulled(self, joint: int) -> Any:
        async def pulled(event: Any) -> None:
            client = int(event.client_id)
            start, end = np.array(event.start_position), np.array(event.end_position)
            force = self.force(end - start)
            # A page that is gone has not let go: viser ends its drags, and has forgotten it by then.
            gone = client not in self._server.get_clients()
            if event.phase == "end" or gone or not self.enabled:
                self._clear(client)
                if event.phase == "end" and self.enabled and not gone and force.any():
                    self._sender.request(self._request(joint, start, force))
                return
            self._draw(client, start, end, force)

        return pulled

    def force(self, pull: Array) -> Array:
        """The force of a pull, (3,) in N: zero for one that is too short, and bounded for a long one."""
        length = float(np.linalg.norm(pull))
        weight = self._robot.model.mass * self._robot.model.gravity
        if not length >= _SHORTEST:
            return np.zeros(3)
        return np.asarray(pull / length * weight * min(_MOST, _PER_METRE * length))

    def _request(self, joint: int, at: Array, force: Array) -> Request:
        """The shove, as a force and torque at the origin of the link that the mock robot knows by name."""
        link, frame = self._links[joint]
        origin = (self._drawing.placements[joint] * frame).translation
        wrench = np.concatenate([force, np.cross(at - origin, force)])
        content = wrench_stamped(wrench, link)
        duration = self._robot.settings.mock.push_duration
        said = f"a shove of {np.linalg.norm(force):.0f} N for {duration:g} s at {link}"
        return Request("mock", "push", "", said, lambda hear: content, link)

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

    def _clear(self, client: int) -> None:
        for handle in self._pulls.pop(client, ()):
            handle.remove()


def _link_of(model: pin.Model, joint: int) -> tuple[str, pin.SE3]:
    """The link that a joint moves, and its placement on it; of several, the one at the joint."""
    frames = [frame for frame in model.frames if frame.parentJoint == joint and frame.type == pin.BODY]
    frame = min(frames, key=lambda frame: float(np.linalg.norm(frame.placement.translation)))
    return str(frame.name), frame.placement
