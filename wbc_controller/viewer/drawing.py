"""The robot in the browser: its meshes, and what its controller counts on, as shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import viser

from wbc_controller.records import Array
from wbc_controller.viewer.meshes import Mesh
from wbc_controller.viewer.moment import Moment, Robot
from wbc_controller.views.scene import ARROW, COLORS, LINE_LIST, LINE_STRIP, SPHERE_LIST, Shape, draw

#: What can be shown and hidden, with its name on the page.
GROUPS: Mapping[str, str] = {
    "contact_forces": "Contact forces",
    "friction_cones": "Friction cones",
    "support": "Support polygon",
    "com": "Centre of mass",
    "capture_point": "Capture point",
    "task_errors": "Task references",
}
#: Groups that are shown and hidden with another one.
_WITH = {"references": "task_errors", "contacts": "support"}
#: Movement below which a link, and a shape, is not drawn anew, m or the sine of half an angle: a page whose robot
#: stands still then draws nothing, which without a GPU spares the processors that the controller runs on.
_STILL, _STEADY = 1.0e-4, 1.0e-3
#: Brightest and darkest grey of a link: what is white or black has no shape.
_DARKEST, _BRIGHTEST = 0.16, 0.86
#: Brightness of the light from all sides, without reflections.
_LIGHT = 2.2
#: Opacity of a robot that is seen through.
_TRANSLUCENT = 0.35


class Drawing:
    """Draws moments of a robot in the scene of a viser server.

    Attributes:
        links: handle of each mesh, with the joint that moves it.
        placements: of each joint of the model in the world, at the moment that was drawn last.
    """

    def __init__(self, server: viser.ViserServer, robot: Robot, meshes: Sequence[Mesh]) -> None:
        """Put the robot in its posture into the scene.

        Args:
            server: whose scene it is.
            robot: the robot.
            meshes: what it looks like.
        """
        self._scene, self._robot = server.scene, robot
        self._server = server
        self._data = robot.model.pinocchio.createData()
        self._frames: dict[int, Any] = {}
        self.links: list[tuple[Any, int]] = []
        self.placements: list[pin.SE3] = []
        self._shown = dict.fromkeys(GROUPS, True)
        self._shapes: dict[tuple[str, int], _Drawn] = {}
        self._light = self._scene.add_light_hemisphere(
            "/light", sky_color=(255, 255, 255), ground_color=(150, 150, 160), intensity=_LIGHT
        )
        for joint in sorted({mesh.joint for mesh in meshes}):
            self._frames[joint] = self._scene.add_frame(f"/robot/{joint}", show_axes=False)
        for mesh in meshes:
            color = np.clip(np.array(mesh.color), _DARKEST, _BRIGHTEST)
            handle = self._scene.add_mesh_simple(
                f"/robot/{mesh.joint}/{mesh.name}",
                mesh.vertices,
                mesh.triangles,
                color=np.array(255 * color, dtype=np.uint8),
                cast_shadow=True,
            )
            self.links.append((handle, mesh.joint))

    def show(self, moment: Moment) -> None:
        """Draw a moment."""
        robot = self._robot
        pin.forwardKinematics(robot.model.pinocchio, self._data, moment.q)
        self.placements = list(self._data.oMi)
        robot.dynamics.update(moment.q, moment.v)
        shapes = draw(robot.dynamics, robot.tasks, robot.contacts, moment.references, moment.forces)
        with self._server.atomic():  # a page never shows half of a moment
            for joint, frame in self._frames.items():
                _place(frame, self._data.oMi[joint])
            self._draw(shapes)

    def toggle(self, group: str, shown: bool) -> None:
        """Show or hide a group of shapes."""
        self._shown[group] = shown

    def see_through(self, translucent: bool) -> None:
        """Make the robot translucent, or not."""
        for handle, _ in self.links:
            handle.opacity = _TRANSLUCENT if translucent else None

    def fine(self, fine: bool) -> None:
        """Draw shadows and reflections, or not: without a GPU they cost several times what the rest does."""
        self._scene.configure_default_lights(True, cast_shadow=fine)
        self._light.visible = not fine  # what reflections light up otherwise
        self._scene.configure_environment_map("studio" if fine else None, environment_intensity=0.6)

    def _draw(self, shapes: Sequence[Shape]) -> None:
        absent = set(self._shapes)
        for shape in shapes:
            place = shape.group, shape.number
            if place not in self._shapes:
                self._shapes[place] = _Drawn(self._scene, shape)
            self._shapes[place].move(shape, self._shown[_WITH.get(shape.group, shape.group)])
            absent.discard(place)
        for place in absent:
            self._shapes[place].hide()


class _Drawn:
    """One shape of the scene, made once and then moved."""

    def __init__(self, scene: viser.SceneApi, shape: Shape) -> None:
        red, green, blue, self._opacity = COLORS[shape.group]
        self._rgb = np.array([255 * red, 255 * green, 255 * blue], dtype=np.uint8)
        self._scene, self._name = scene, f"/controller/{shape.group}/{shape.number}"
        self._handles: list[Any] = []

    def hide(self) -> None:
        for handle in self._handles:
            handle.visible = False

    def move(self, shape: Shape, shown: bool) -> None:
        if not shown:
            self.hide()
            return
        if shape.kind == SPHERE_LIST:
            self._balls(shape)
        elif shape.kind == ARROW:
            self._lines(shape.points.reshape(1, 2, 3), shape)
        elif shape.kind in (LINE_LIST, LINE_STRIP):
            points = shape.points
            if shape.kind == LINE_STRIP:
                points = np.stack([points[:-1], points[1:]], axis=1).reshape(-1, 3)
            self._lines(points.reshape(-1, 2, 3), shape)

    def _lines(self, points: Array, shape: Shape) -> None:
        made: Any
        if not self._handles:
            if shape.kind == ARROW:
                made = self._scene.add_arrows(
                    self._name, points, self._rgb, shaft_radius=shape.size / 2.0, head_radius=1.1 * shape.size,
                    head_length=2.4 * shape.size,
                )  # fmt: skip
            else:
                made = self._scene.add_line_segments(self._name, points, self._rgb, thickness=shape.size)
            self._handles.append(made)
        (handle,) = self._handles
        if handle.points.shape != points.shape or np.abs(points - handle.points).max() > _STEADY:
            handle.points = points.astype(np.float32)
        handle.visible = True

    def _balls(self, shape: Shape) -> None:
        while len(self._handles) < len(shape.points):
            name = f"{self._name}/{len(self._handles)}"
            ball = self._scene.add_icosphere(name, shape.size / 2.0, color=self._rgb, subdivisions=2, cast_shadow=False)
            self._handles.append(ball)
        for handle, point in zip(self._handles, shape.points, strict=False):
            if np.abs(point - handle.position).max() > _STEADY:
                handle.position = point
            handle.visible = True
        for handle in self._handles[len(shape.points) :]:
            handle.visible = False


def _place(frame: Any, placement: pin.SE3) -> None:
    """Move a frame of the scene, unless it is there already: most links of a robot that stands do not move."""
    position = placement.translation
    x, y, z, w = pin.Quaternion(placement.rotation).coeffs()
    turned = np.array([w, x, y, z])
    if np.abs(position - frame.position).max() > _STILL:
        frame.position = position
    if 1.0 - abs(float(turned @ frame.wxyz)) > _STILL**2:
        frame.wxyz = turned
