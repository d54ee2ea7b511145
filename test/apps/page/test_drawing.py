"""Drawing of the robot's meshes, and of a robot without a measured base."""

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller.apps.page.meshes import TRIANGLES, build_meshes
from wbc_controller.apps.page.snapshot import Robot
from wbc_controller.apps.page.topic_source import BaseOnContacts
from wbc_controller.controller.visualization.geometry import read_visuals
from wbc_controller.settings.config import load


@pytest.fixture(scope="module")
def robot():
    return Robot(load("go2").settings)


def test_meshes_have_the_place_of_the_visuals(robot):
    meshes = {mesh.name: mesh for mesh in build_meshes(robot.model)}
    assert sum(len(mesh.triangles) for mesh in meshes.values()) <= 1.1 * TRIANGLES  # of 78 584
    visuals, _ = read_visuals(robot.model)
    for visual in visuals:
        triangles = map(visual.geometry.tri_indices, range(visual.geometry.num_tris))
        corners = [(each[0], each[1], each[2]) for each in triangles]
        used = visual.geometry.vertices()[np.unique(corners)]  # Go2's files contain unused vertices
        placed = used @ visual.placement.rotation.T + visual.placement.translation
        drawn = meshes[visual.name].vertices
        np.testing.assert_allclose(drawn.min(axis=0), placed.min(axis=0), atol=0.003)
        np.testing.assert_allclose(drawn.max(axis=0), placed.max(axis=0), atol=0.003)


def test_unmeasured_base_is_fitted_to_the_contacts(robot):
    model, dynamics = robot.model, robot.dynamics
    standing = BaseOnContacts(robot)

    def feet(q):
        dynamics.update(q, np.zeros(model.nv))
        return np.array([contact.points(dynamics)[0] for contact in robot.contacts.values()])

    there = feet(standing.place(model.configuration(model.posture)))
    assert there[:, 2] == pytest.approx(0.0, abs=1e-9)
    crouched = model.posture * np.where(["hip" in name for name in model.joints], 1.0, 1.1)
    tilted = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 1.0), np.array([1.0, 2.0, 3.0]))
    q = standing.place(model.configuration(crouched, tilted))
    assert feet(q).mean(axis=0) == pytest.approx(there.mean(axis=0), abs=1e-9)
    assert np.abs(feet(q) - there).max() < 0.03
    assert abs(q[2] - 0.3) < 0.15  # upright above its feet, not at the given base pose
