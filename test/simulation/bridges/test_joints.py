"""States by joint name."""

import numpy as np
import pinocchio as pin
import pytest

import wbc_controller as wbc


@pytest.fixture(scope="module")
def model(robot_of):
    return robot_of("go2")[1]


def test_joints_stand_where_pinocchio_has_them(model):
    rng = np.random.default_rng(0)
    positions = {name: float(rng.uniform(0.1, 0.3)) for name in reversed(model.joints)} | {"other": 5.0}
    velocities = {name: float(rng.normal()) for name in model.joints}
    quaternion = pin.Quaternion(pin.exp3(rng.normal(size=3))).coeffs()
    q, v = wbc.state_from_joints(
        model,
        positions,
        velocities,
        base_position=[1.0, 2.0, 3.0],
        base_quaternion=quaternion,
        base_linear_velocity=[0.1, 0.2, 0.3],
        base_angular_velocity=[0.4, 0.5, 0.6],
    )
    np.testing.assert_allclose(q[:7], [1.0, 2.0, 3.0, *quaternion])
    np.testing.assert_array_equal(v[:6], [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    for name in model.joints:
        joint = model.pinocchio.joints[model.pinocchio.getJointId(name)]
        assert (q[joint.idx_q], v[joint.idx_v]) == (positions[name], velocities[name])


def test_a_fixed_base_has_joints_alone():
    robot = wbc.Controller(
        {
            "robot.urdf": "package://example-robot-data/robots/panda_description/urdf/panda.urdf",
            "robot.base": "fixed",
            "robot.joints": ["panda_joint2", "panda_joint1"],
            "robot.posture": [0.0, 0.0],
            "tasks": {"posture": {"type": "posture"}},
        }
    )
    q, v = wbc.state_from_joints(robot.model, {"panda_joint1": 0.1, "panda_joint2": 0.2})
    np.testing.assert_array_equal(q, [0.1, 0.2])  # Pinocchio's order is the tree's
    assert not v.any()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"positions": {}}, "positions: 12 of 12 joints are missing: FL_hip_joint"),
        ({"velocities": {"FL_hip_joint": 0.0}}, "velocities: 11 of 12 joints are missing: FL_thigh_joint"),
        ({"base_quaternion": [0.0, 0.0, 0.0, 0.5]}, "base_quaternion .* is not a unit quaternion"),
        ({"base_position": [0.0, 0.0]}, r"base_position has shape \(2,\), expected \(3,\)"),
        ({"base_linear_velocity": [0.0, 0.0, np.inf]}, "base_linear_velocity is not finite"),
    ],
)
def test_what_is_missing_or_wrong_is_named(model, changes, sentence):
    arguments = {"positions": dict.fromkeys(model.joints, 0.1)} | changes
    with pytest.raises(wbc.InputRefused, match=sentence):
        wbc.state_from_joints(model, **arguments)
