"""The first view of the page contains the whole robot, in windows of common sizes; the camera follows it."""

import itertools
from functools import cache
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from browser import projected

from wbc_controller.apps.new.draft import new_configuration
from wbc_controller.apps.page.drawing import CameraFollower, camera
from wbc_controller.apps.page.snapshot import Robot
from wbc_controller.controller.visualization.geometry import Part
from wbc_controller.settings.config import load

UR5 = "package://example-robot-data/robots/ur_description/urdf/ur5_robot.urdf"
#: Width of both panels with their borders, px.
PANELS = 330 + 290 + 8


@cache
def robot_and_meshes(name):
    """Return a robot, and a box of 0.2 m at each joint."""
    robot = Robot(new_configuration(UR5).settings if name == UR5 else load(name).settings)
    box = np.array(list(itertools.product((-0.1, 0.1), repeat=3)), dtype=np.float32)
    joints = range(1, robot.model.pinocchio.njoints)
    return robot, [Part(f"m{i}", i, box, np.array([[0, 1, 2]]), (0.5,) * 3) for i in joints]


def corners(robot, meshes):
    """Corners of the bounding box as the page draws the robot: with its lowest point on the floor, (8, 3)."""
    model = robot.model.pinocchio
    data = model.createData()
    pin.forwardKinematics(model, data, robot.dynamics.q)
    placed = ((mesh.vertices, data.oMi[mesh.joint]) for mesh in meshes)
    points = np.vstack([vertices @ place.rotation.T + place.translation for vertices, place in placed])
    if robot.model.floating_base:
        points[:, 2] -= points[:, 2].min()
    return np.array(list(itertools.product(*zip(points.min(axis=0), points.max(axis=0), strict=True))))


@pytest.mark.parametrize("size", [(1440, 820), (1920, 1080), (1280, 720), (1100, 700), (1024, 768)])
@pytest.mark.parametrize("name", ["g1", "talos", "go2", UR5])
def test_the_whole_robot_is_in_view(name, size):
    robot, meshes = robot_and_meshes(name)
    width, height = size
    across, up = np.abs(projected(corners(robot, meshes), *camera(robot, meshes))).max(axis=0)
    assert across <= (width - PANELS) / height
    assert up <= 1.0
    assert max(up, across / 0.5) > 0.85  # and the robot is not far away


def test_the_camera_trails_a_robot_that_walks():
    def client():
        return SimpleNamespace(camera=SimpleNamespace(position=np.array([2.0, -2.0, 1.0])))

    follower, clients = CameraFollower(), {0: client()}
    follower.follow(clients, np.array([0.2, 0.1]))  # a robot that sways
    np.testing.assert_array_equal(clients[0].camera.position, [2.0, -2.0, 1.0])
    for x in np.linspace(0.0, 5.0, 11):
        follower.follow(clients, np.array([x, 0.0]))
    np.testing.assert_allclose(clients[0].camera.position, [6.7, -2.0, 1.0])
    clients[1] = client()  # a page that is opened later
    follower.follow(clients, np.array([5.0, 0.0]))
    np.testing.assert_allclose(clients[1].camera.position, [6.7, -2.0, 1.0])
    follower.on = False
    follower.follow(clients, np.array([9.0, 0.0]))
    follower.follow(clients, np.array([np.nan, 0.0]))
    np.testing.assert_allclose(clients[0].camera.position, [6.7, -2.0, 1.0])
