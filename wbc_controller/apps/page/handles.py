"""Drags in the scene: of handles, which send setpoints, and of links of the mock robot, which push them."""

import time
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
import viser

from wbc_controller.apps.page.drawing import Drawing
from wbc_controller.apps.page.request_sender import RequestSender
from wbc_controller.apps.page.snapshot import FOLLOWING, Robot, Snapshot
from wbc_controller.apps.terminal.request_parser import Request
from wbc_controller.middleware.codec import wrench_stamped
from wbc_controller.records import Array
from wbc_controller.settings.tasks import FrameOrientationTask

#: Task types with a handle: translation, rotation.
KINDS = {
    "com": (True, False),
    "frame_position": (True, False),
    "frame_pose": (True, True),
    "frame_orientation": (False, True),
}
_SIZE = 0.14  # m
_DISABLED_OPACITY = 0.35
_HOLD_TIME = 0.3  # after a setpoint ramp, s
_UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])  # quaternion (w, x, y, z)
KEY = "shift"  # modifier key; a drag without it turns the view
_FORCE_PER_METRE, _MAX_FORCE = 0.8, 1.0  # force per length of a pull, 1/m, and largest force, in weights of the robot
_MIN_LENGTH = 0.02  # length below which a pull is ignored, m
_COLOR = (255, 120, 30)


class Handle:
    """Handle of one task."""

    def __init__(self, server: viser.ViserServer, robot: Robot, task: str, sender: RequestSender) -> None:
        self._name, self._dynamics, self._sender = task, robot.dynamics, sender
        self._task: Any = robot.tasks[task]
        spec = robot.settings.tasks[task]
        self._can_move, self._can_rotate = KINDS[spec.type]
        #: Frame with the handle of an orientation; None if the value of the task contains the position.
        self._frame = robot.model.frame_id(spec.frame, task) if isinstance(spec, FrameOrientationTask) else None
        self._hold_time = spec.setpoint_duration + _HOLD_TIME
        self._rings_shown = False
        #: Last orientation (w, x, y, z), kept while the rings are hidden and the handle has world axes.
        self._orientation = _UNTURNED
        self._dragging: int | None = None
        self._hold_until = -np.inf
        self._disabled = True
        self._gizmo = server.scene.add_transform_controls(
            f"/handles/{task}",
            scale=_SIZE,
            line_width=3.0,
            disable_axes=not self._can_move,
            disable_sliders=not self._can_move,
            disable_rotations=True,
            depth_test=False,
            visible=False,
        )
        self._label = server.scene.add_label(f"/handles/{task}/name", task.replace("_", " "), visible=False)
        # Coroutines run in order on the server's thread.
        self._gizmo.on_update(self._moved)

    async def _moved(self, event: Any) -> None:
        client = -1 if event.client_id is None else int(event.client_id)
        if event.phase == "start":
            self._dragging = client
            return
        if self._dragging is None:
            return
        if event.phase == "update":
            self._sender.drag(f"setpoint {self._name}", client, self._request_words())
        else:
            self._dragging = None
        self._hold_until = time.monotonic() + self._hold_time

    def _request_words(self) -> list[str]:
        numbers = list(self._gizmo.position) if self._frame is None else []
        if self._can_rotate:
            w, x, y, z = self._gizmo.wxyz if self._rings_shown else self._orientation
            numbers += [x, y, z, w]
        values = ", ".join(f"{float(number):.5f}" for number in numbers)
        if self._disabled:  # enable the task and set its setpoint in one request
            return ["update", f"{{tasks: {{{self._name}: {{enabled: true, setpoint: [{values}]}}}}}}"]
        return [self._name, "to", *values.split(", ")]

    def end_drags(self, client: int) -> None:
        """End the drag of a closed page."""
        if self._dragging == client:
            self._dragging = None

    def show_rings(self, shown: bool) -> None:
        """Show or hide the rings."""
        self._rings_shown = shown
        self._gizmo.disable_rotations = not (shown and self._can_rotate)

    def show(self, snapshot: Snapshot) -> None:
        """Move the handle, unless dragged, to the reference, or the value of a disabled task."""
        shown = snapshot.mode.startswith(FOLLOWING) and (self._can_move or self._rings_shown)
        self._gizmo.visible = self._label.visible = shown
        if not shown:
            self._dragging = None
            return
        references = snapshot.references
        self._disabled = references is None or not references.weights.get(self._name, 0.0) > 0.0
        self._gizmo.opacity = _DISABLED_OPACITY if self._disabled else 1.0
        if self._dragging is not None or time.monotonic() < self._hold_until:
            return
        known = None if self._disabled or references is None else references.tasks.get(self._name)
        at: Array = self._task.position(self._dynamics) if known is None else known.position
        position = at[:3] if self._frame is None else self._dynamics.placement(self._frame).translation
        if not np.allclose(position, self._gizmo.position, rtol=0.0, atol=1.0e-4):
            self._gizmo.position = position
        self._orientation = np.roll(at[-4:], 1) if self._can_rotate else _UNTURNED
        turned = self._orientation if self._rings_shown else _UNTURNED
        if not 1.0 - abs(float(turned @ self._gizmo.wxyz)) <= 1.0e-7:
            self._gizmo.wxyz = turned


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
