"""Handles of the tasks with a position or orientation: a drag sends the task's setpoint."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pinocchio as pin
import viser

from wbc_controller.apps.page.request_sender import RequestSender
from wbc_controller.apps.page.snapshot import Robot, Snapshot
from wbc_controller.inverse_dynamics.tasks import AccelerationTask
from wbc_controller.records import Array

#: Kinds of task with a handle: can it be moved, can it be turned.
_KINDS = {
    "com": (True, False),
    "frame_position": (True, False),
    "frame_pose": (True, True),
    "frame_orientation": (False, True),
}
#: Size of a handle, m.
_SIZE = 0.14
#: Opacity of the handle of a disabled task; a drag enables the task.
_OFF = 0.35
#: Time after the ramp of a setpoint for which a handle stays at its setpoint, s.
_REST = 0.3


class Handles:
    """The handles of all tasks, shared by all pages; while one page drags, the others see the handle move."""

    def __init__(self, server: viser.ViserServer, robot: Robot, sender: RequestSender) -> None:
        self._handles = {
            name: _Handle(server, robot, name, sender)
            for name, task in robot.settings.tasks.items()
            if task.type in _KINDS
        }

    def show(self, snapshot: Snapshot) -> None:
        """Move the handles without a drag to the references of their tasks; of a disabled task, to its value."""
        for handle in self._handles.values():
            handle.show(snapshot)

    def turn(self, turns: bool) -> None:
        """Show or hide the rings that turn poses and orientations."""
        for handle in self._handles.values():
            handle.turn(turns)

    def let_go(self, client: int) -> None:
        """End the drags of a closed page."""
        for handle in self._handles.values():
            handle.let_go(client)


class _Handle:
    def __init__(self, server: viser.ViserServer, robot: Robot, task: str, sender: RequestSender) -> None:
        self._name, self._robot, self._sender = task, robot, sender
        self._kind = robot.settings.tasks[task].type
        self._moves, self._can_turn = _KINDS[self._kind]
        self._turns = False
        #: Orientation while the handle is moved and not turned, (w, x, y, z); its arrows are the world's then.
        self._orientation = np.array([1.0, 0.0, 0.0, 0.0])
        self._dragging: int | None = None
        self._rests_until = -np.inf
        self._off = True
        self._gizmo = server.scene.add_transform_controls(
            f"/handles/{task}",
            scale=_SIZE,
            line_width=3.0,
            disable_axes=not self._moves,
            disable_sliders=not self._moves,
            disable_rotations=True,
            depth_test=False,
            visible=False,
        )
        self._label = server.scene.add_label(f"/handles/{task}/name", task.replace("_", " "), visible=False)
        # Coroutines run in order on the server's own thread.
        self._gizmo.on_update(self._moved)

    async def _moved(self, event: Any) -> None:
        client = -1 if event.client_id is None else int(event.client_id)
        if event.phase == "start":
            self._dragging = client
            return
        if self._dragging is None:
            return  # the page is closed
        if event.phase == "update":
            self._sender.drag(f"setpoint {self._name}", client, self._words())
        else:
            self._dragging = None
        self._rests_until = time.monotonic() + self._robot.settings.tasks[self._name].setpoint_duration + _REST

    def _words(self) -> list[str]:
        """Return the words of a request for the pose of the handle."""
        numbers = [] if self._kind == "frame_orientation" else list(self._gizmo.position)
        if self._can_turn:
            w, x, y, z = self._gizmo.wxyz if self._turns else self._orientation
            numbers += [x, y, z, w]
        values = ", ".join(f"{float(number):.5f}" for number in numbers)
        if self._off:  # enable it with its setpoint, in one step
            return ["update", f"{{tasks: {{{self._name}: {{enabled: true, setpoint: [{values}]}}}}}}"]
        return [self._name, "to", *values.split(", ")]

    def let_go(self, client: int) -> None:
        if self._dragging == client:
            self._dragging = None

    def turn(self, turns: bool) -> None:
        self._turns = turns
        self._gizmo.disable_rotations = not (turns and self._can_turn)

    def show(self, snapshot: Snapshot) -> None:
        shown = snapshot.following and (self._moves or self._turns)
        self._gizmo.visible = self._label.visible = shown
        if not shown:
            self._dragging = None
            return
        references = snapshot.references
        self._off = references is None or not references.weights.get(self._name, 0.0) > 0.0
        opacity = _OFF if self._off else 1.0
        if self._gizmo.opacity != opacity:
            self._gizmo.opacity = opacity
        if self._dragging is not None or time.monotonic() < self._rests_until:
            return
        known = None if self._off or references is None else references.tasks.get(self._name)
        at = known.position if known is not None else self._value()
        if at is None:
            return
        position, turned = self._place(at)
        if not np.allclose(position, self._gizmo.position, rtol=0.0, atol=1.0e-4):
            self._gizmo.position = position
        self._orientation = turned
        if not self._turns:
            turned = np.array([1.0, 0.0, 0.0, 0.0])
        if not 1.0 - abs(float(turned @ self._gizmo.wxyz)) <= 1.0e-7:
            self._gizmo.wxyz = turned

    def _value(self) -> Array | None:
        """Return the task's value, or None if it has none."""
        task = self._robot.tasks[self._name]
        return np.asarray(task.position(self._robot.dynamics)) if isinstance(task, AccelerationTask) else None

    def _place(self, at: Array) -> tuple[Array, Array]:
        """Return position, (3,), and quaternion (w, x, y, z) of the handle, from a value in the form of the task."""
        turned = np.array([1.0, 0.0, 0.0, 0.0])
        if self._can_turn:
            x, y, z, w = at[-4:]
            turned = np.array([w, x, y, z])
        if self._kind != "frame_orientation":
            return at[:3], turned
        frame = self._robot.model.frame_id(self._robot.settings.tasks[self._name].frame, self._name)  # type: ignore[union-attr]
        placement: pin.SE3 = self._robot.dynamics.placement(frame)
        return placement.translation, turned
