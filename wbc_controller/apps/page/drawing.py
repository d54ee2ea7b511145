"""Scene in the browser, and its camera, which follows the robot."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import viser

from wbc_controller.apps.page.snapshot import Robot, Snapshot
from wbc_controller.controller.visualization.geometry import Part
from wbc_controller.controller.visualization.scene import ARROW, COLORS, LINE_STRIP, SPHERE_LIST, Shape, draw
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of
from wbc_controller.records import Array

#: Groups of shapes that can be hidden, with their labels.
GROUPS: Mapping[str, str] = {
    "contact_forces": "Contact forces",
    "friction_cones": "Friction cones",
    "support": "Support polygon",
    "com": "Centre of mass",
    "capture_point": "Capture point",
    "task_errors": "Task references",
    "steps": "Planned steps",
}
#: Groups that share the switch of another group.
_SWITCH_OF = {"references": "task_errors", "contacts": "support", "swing_paths": "steps"}
#: Motion below which nothing is redrawn, m or the sine of half an angle: saves processor time without a GPU.
_STILL_JOINT, _STILL_SHAPE = 1.0e-4, 1.0e-3
#: Darkest and brightest grey of a link, so that white and black links show their shape.
_DARKEST, _BRIGHTEST = 0.16, 0.86
_LIGHT = 2.2  # without reflections
_TRANSLUCENT = 0.35  # opacity
_ANGLE = 0.75  # vertical angle of view, rad
_DIRECTION = np.array([1.7, -1.5, 0.65])  # from the robot to the camera
_FILLED = 0.92  # largest part of the view that the robot fills
_ASPECT = 0.5  # smallest width of the canvas as a share of its height
_NEAREST = 0.3  # smallest distance of the camera, m
_TRAILING = 0.3  # distance behind the robot, m


class Drawing:
    """Draws snapshots in the scene of a viser server."""

    def __init__(self, server: viser.ViserServer, robot: Robot, meshes: Sequence[Part]) -> None:
        self._server, self._scene, self._robot = server, server.scene, robot
        model = robot.model.pinocchio
        self._data = model.createData()
        self.links: list[tuple[Any, int]] = []  # handle, and index of the joint
        self.placements: list[pin.SE3] = []  # of each joint in the world, as last drawn
        self._shown = dict.fromkeys(GROUPS, True)
        self._shapes: dict[tuple[str, int], _DrawnShape] = {}
        self._light = self._scene.add_light_hemisphere(
            "/light", sky_color=(255, 255, 255), ground_color=(150, 150, 160), intensity=_LIGHT
        )
        #: Joints of the frames, each relative to its parent, so that only moved joints change.
        self._joints = sorted({before for mesh in meshes for before in model.supports[mesh.joint]} - {0})
        self._frames: list[Any] = []
        names = {0: "/robot"}  # of each joint's frame
        for joint in self._joints:
            names[joint] = f"{names[model.parents[joint]]}/{joint}"
            self._frames.append(self._scene.add_frame(names[joint], show_axes=False))
        self._positions = np.zeros((len(self._joints), 3))
        self._quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (len(self._joints), 1))
        for mesh in meshes:
            color = np.array(255 * np.clip(np.array(mesh.color), _DARKEST, _BRIGHTEST), dtype=np.uint8)
            name = f"{names[mesh.joint]}/{mesh.name}"
            handle = self._scene.add_mesh_simple(name, mesh.vertices, mesh.triangles, color=color, cast_shadow=True)
            self.links.append((handle, mesh.joint))

    def show(self, snapshot: Snapshot) -> None:
        """Draw a snapshot."""
        robot = self._robot
        pin.forwardKinematics(robot.model.pinocchio, self._data, snapshot.q)
        self.placements = list(self._data.oMi)
        robot.dynamics.update(snapshot.q, snapshot.v)
        shapes = draw(robot.dynamics, robot.tasks, robot.contacts, snapshot.references, snapshot.forces)
        present = {(shape.group, shape.number): shape for shape in (*shapes, *snapshot.steps)}
        with self._server.atomic():
            self._move_frames()
            for place, shape in present.items():
                if place not in self._shapes:
                    self._shapes[place] = _DrawnShape(self._scene, shape)
                self._shapes[place].move(shape, self._shown[_SWITCH_OF.get(shape.group, shape.group)])
            for place in self._shapes.keys() - present:
                self._shapes[place].hide()

    def set_visible(self, group: str, shown: bool) -> None:
        """Show or hide a group of shapes."""
        self._shown[group] = shown

    def set_translucent(self, translucent: bool) -> None:
        """Make the robot translucent."""
        for handle, _ in self.links:
            handle.opacity = _TRANSLUCENT if translucent else None

    def set_shadows(self, shadows: bool) -> None:
        """Switch shadows and reflections."""
        self._scene.configure_default_lights(True, cast_shadow=shadows)
        self._light.visible = not shadows  # reflections replace this light
        self._scene.configure_environment_map("studio" if shadows else None, environment_intensity=0.6)

    def _move_frames(self) -> None:
        placements = [self._data.liMi[joint] for joint in self._joints]
        positions = np.array([each.translation for each in placements])
        turns = np.array([quaternion_of(each.rotation) for each in placements])[:, [3, 0, 1, 2]]
        for i in np.flatnonzero(np.abs(positions - self._positions).max(axis=1) > _STILL_JOINT):
            self._frames[i].position = self._positions[i] = positions[i]
        for i in np.flatnonzero(1.0 - np.abs(np.einsum("ij,ij->i", turns, self._quaternions)) > _STILL_JOINT**2):
            self._frames[i].wxyz = self._quaternions[i] = turns[i]


class _DrawnShape:
    def __init__(self, scene: viser.SceneApi, shape: Shape) -> None:
        self._rgb = np.array(255 * np.array(COLORS[shape.group][:3]), dtype=np.uint8)
        self._scene, self._name = scene, f"/controller/{shape.group}/{shape.number}"
        self._handles: list[Any] = []
        self._points = np.zeros((0, 3))  # as drawn; empty while hidden

    def hide(self) -> None:
        self._points = np.zeros((0, 3))
        for handle in self._handles:
            handle.visible = False

    def move(self, shape: Shape, shown: bool) -> None:
        if not shown:
            self.hide()
            return
        points = shape.points
        if points.shape == self._points.shape and np.abs(points - self._points).max() <= _STILL_SHAPE:
            return
        self._points = points
        if shape.kind == SPHERE_LIST:
            self._balls(shape)
        else:
            if shape.kind == LINE_STRIP:
                points = np.stack([points[:-1], points[1:]], axis=1)
            self._lines(points.reshape(-1, 2, 3), shape)

    def _lines(self, points: Array, shape: Shape) -> None:
        size = shape.size
        if not self._handles and shape.kind == ARROW:
            arrows = self._scene.add_arrows(
                self._name, points, self._rgb, shaft_radius=size / 2.0, head_radius=1.1 * size, head_length=2.4 * size
            )
            self._handles.append(arrows)
        elif not self._handles:
            self._handles.append(self._scene.add_line_segments(self._name, points, self._rgb, thickness=size))
        (handle,) = self._handles
        handle.points = points.astype(np.float32)
        handle.visible = True

    def _balls(self, shape: Shape) -> None:
        while len(self._handles) < len(shape.points):
            name = f"{self._name}/{len(self._handles)}"
            ball = self._scene.add_icosphere(name, shape.size / 2.0, color=self._rgb, subdivisions=2, cast_shadow=False)
            self._handles.append(ball)
        for handle, point in zip(self._handles, shape.points, strict=False):
            handle.position = point
            handle.visible = True
        for handle in self._handles[len(shape.points) :]:
            handle.visible = False


def camera(robot: Robot, meshes: Sequence[Part]) -> tuple[Array, Array, float]:
    """Return position and target of the camera, (3,) each in m, and its vertical angle of view, rad.

    The view contains the robot's bounding box, with its lowest point at height 0. At the distance d from the centre, a
    corner at the offset r satisfies |r·right| ≤ s aspect (d + r·forward) and |r·up| ≤ s (d + r·forward), with
    s = filled tan(angle / 2).
    """
    placements = robot.dynamics.joints.reshape(-1, 4, 3)  # columns of the rotation, then the translation
    links = [mesh.vertices @ placements[mesh.joint, :3] + placements[mesh.joint, 3] for mesh in meshes]
    points = np.concatenate([placements[:, 3], *links])
    low, high = points.min(axis=0), points.max(axis=0)
    if robot.model.floating_base:
        low[2], high[2] = 0.0, high[2] - low[2]
    centre = 0.5 * (low + high)
    offsets = 0.5 * (high - low) * list(itertools.product((-1.0, 1.0), repeat=3))
    forward = -_DIRECTION / np.linalg.norm(_DIRECTION)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    lateral = np.maximum(np.abs(offsets @ right) / _ASPECT, np.abs(offsets @ np.cross(right, forward)))
    distance = np.max(lateral / (_FILLED * np.tan(_ANGLE / 2.0)) - offsets @ forward)
    return centre - max(_NEAREST, float(distance)) * forward, centre, _ANGLE


class CameraFollower:
    """Moves all cameras with the base."""

    def __init__(self) -> None:
        self.on = True
        self._places: dict[int, Array] = {}  # followed place by client, (2,) in m; at first the origin

    def follow(self, clients: Mapping[int, viser.ClientHandle], place: Array) -> None:
        """Let each camera trail the place of the base, (2,) in m, by at most `_TRAILING`."""
        self._places = {number: self._places.get(number, np.zeros(2)) for number in clients}
        for number, client in clients.items():
            way = place - self._places[number]
            far = float(np.linalg.norm(way))
            if self.on and _TRAILING < far < np.inf:
                step = way * (1.0 - _TRAILING / far)
                self._places[number] = self._places[number] + step
                client.camera.position = client.camera.position + np.append(step, 0.0)  # moves its target, too
