"""The camera of a page follows the robot."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import viser

from wbc_controller.apps.page.snapshot import Robot
from wbc_controller.controller.visualization.geometry import Part
from wbc_controller.records import Array

_ANGLE = 0.75  # vertical angle of view, rad
_DIRECTION = np.array([1.7, -1.5, 0.65])  # from the robot to the camera
_FILLED = 0.92  # largest part of the view that the robot fills
_ASPECT = 0.5  # smallest width of the canvas as a share of its height
_NEAREST = 0.3  # smallest distance of the camera, m
_TRAILING = 0.3  # distance behind the robot, m


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
