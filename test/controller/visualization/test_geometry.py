import dataclasses
import functools
from collections import Counter

import numpy as np
import pinocchio as pin
import pytest
import robot_cases as cases
from scipy.spatial import ConvexHull
from urdf_models import build_model

from wbc_controller.controller.visualization.geometry import TRIANGLES, build_parts, convex_hull
from wbc_controller.settings.resources import share_folder

ROBOTS = ("g1", "go2")
BOX = '<origin xyz="1 0 0"/><geometry><box size="0.2 0.4 0.6"/></geometry><material name="red"/>'
BALL = '<geometry><sphere radius="0.1"/></geometry>'
ROD = '<origin xyz="0 0 1"/><geometry><cylinder radius="0.1" length="0.5"/></geometry>'
MISSING = '<geometry><mesh filename="package://nowhere/arm.stl"/></geometry>'
PRIMITIVES = cases.robot(
    '<material name="red"><color rgba="1 0 0 1"/></material>',
    cases.link("base", 1.0, more=f"<visual>{BOX}</visual><visual>{BALL}</visual>"),
    cases.link("locked", more=f"<visual>{ROD}</visual>"),
    cases.link("arm", 1.0, more=f"<visual>{MISSING}</visual>"),
    cases.joint("lock", "base", "locked", "1 0 0", "0 2 0"),
    cases.joint("move", "locked", "arm", "0 0 1", "0 0 0.3"),
)


def moved(placement, points):
    return np.asarray(points) @ placement.rotation.T + placement.translation


def assert_closed(vertices, triangles):
    edges = Counter((t[i], t[(i + 1) % 3]) for t in triangles.tolist() for i in range(3))
    assert set(edges.values()) == {1}
    assert all((b, a) in edges for a, b in edges)
    assert len(triangles) == 2 * len(vertices) - 4  # Euler's formula for a sphere
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0
    assert volume == pytest.approx(ConvexHull(vertices).volume, rel=1e-6)  # positive: triangles face outwards


@pytest.fixture(scope="module")
def parts_of(robot_of):
    return functools.cache(lambda name: build_parts(robot_of(name)[1]))


def test_hulls_are_closed_and_small(robot_of, parts_of):
    _, model = robot_of("go2")
    parts = parts_of("go2")
    assert len(parts) > model.na
    for part in parts:
        assert len(part.triangles) <= TRIANGLES
        assert 0 < part.joint < model.pinocchio.njoints
        assert_closed(part.vertices, part.triangles)


@pytest.mark.parametrize("name", ROBOTS)
def test_bounding_boxes_are_those_of_the_meshes(robot_of, parts_of, name):
    _, model = robot_of(name)
    # Reference: geometry of the full model with all joints.
    full = pin.buildModelFromXML(model.urdf, pin.JointModelFreeFlyer())
    folder = str(share_folder("example-robot-data").parent)
    geometry = pin.buildGeomFromUrdfString(full, model.urdf, pin.VISUAL, package_dirs=[folder])
    full_data, data, geometry_data = full.createData(), model.pinocchio.createData(), geometry.createData()
    pin.updateGeometryPlacements(full, full_data, geometry, geometry_data, pin.neutral(full))
    pin.forwardKinematics(model.pinocchio, data, pin.neutral(model.pinocchio))
    checked = 0
    for part in parts_of(name):
        index = geometry.getGeometryId(part.name)
        shape = geometry.geometryObjects[index].geometry
        if not hasattr(shape, "vertices"):
            continue
        mesh = moved(geometry_data.oMg[index], shape.vertices())
        hull = moved(data.oMi[part.joint], part.vertices)
        size = np.ptp(mesh, axis=0)
        assert np.abs(hull.min(0) - mesh.min(0)).max() <= 0.1 * size.max(), part.name
        np.testing.assert_allclose(np.ptp(hull, axis=0), size, rtol=0.1, atol=2.0e-3, err_msg=part.name)
        checked += 1
    assert checked >= model.na


def test_primitives_locked_joints_and_missing_meshes(caplog):
    box, ball, rod, *bones = build_parts(build_model(PRIMITIVES, ["move"], [0.0]))
    np.testing.assert_allclose([box.vertices.min(0), box.vertices.max(0)], [[0.9, -0.2, -0.3], [1.1, 0.2, 0.3]])
    assert box.color == (1.0, 0.0, 0.0)
    np.testing.assert_allclose(np.ptp(ball.vertices, axis=0), 0.2, atol=1e-6)
    # The locked link moves with the base.
    assert rod.joint == box.joint == ball.joint == 1
    np.testing.assert_allclose((rod.vertices.max(0) + rod.vertices.min(0)) / 2.0, [0.0, 2.0, 1.0], atol=1e-3)
    assert [bone.joint for bone in bones] == [2]
    assert "arm.stl" in caplog.text
    assert "nowhere" in caplog.text
    for part in (box, ball, rod, *bones):
        assert_closed(part.vertices, part.triangles)


def test_bones_reach_the_next_joints(robot_of):
    _, model = robot_of("g1")
    model = dataclasses.replace(model, urdf=model.urdf.replace(".STL", ".gone"))
    parts = build_parts(model)
    assert {part.joint for part in parts} == set(range(1, model.pinocchio.njoints))
    (shin,) = [part for part in parts if part.name == "left_knee_joint_to_left_ankle_pitch_joint"]
    ankle = model.pinocchio.jointPlacements[model.pinocchio.getJointId("left_ankle_pitch_joint")].translation
    assert shin.joint == model.pinocchio.getJointId("left_knee_joint")
    assert np.linalg.norm(shin.vertices - ankle, axis=1).min() < 0.03


@pytest.mark.parametrize("flat", [(1.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_flat_points_get_a_thin_box(flat):
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 3)) * np.array(flat)
    vertices, triangles = convex_hull(points)
    assert_closed(vertices, triangles)
    np.testing.assert_allclose(np.ptp(vertices, axis=0), np.maximum(np.ptp(points, axis=0), 1.0e-3))


def test_the_budget_is_obeyed_and_used_well():
    points = np.random.default_rng(0).normal(size=(3000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    vertices, triangles = convex_hull(points, 60)
    assert len(triangles) == 60
    assert ConvexHull(vertices).volume > 0.75 * 4.0 / 3.0 * np.pi
