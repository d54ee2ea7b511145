"""States by joint name, and states and torques in a user's MuJoCo scene with other objects."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from pages import ROOT
from refusals import refusal
from snapshots import dynamics_at

import wbc_controller as wbc

A1 = ROOT / "examples" / "a1.yaml"


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


@pytest.fixture(scope="module")
def scene():
    """Unitree A1 in a scene behind a free ball, which shifts all addresses."""
    model = wbc.Controller(A1).model
    spec = mujoco.MjSpec.from_string(model.urdf)
    ball = spec.worldbody.add_body(name="ball", pos=[2.0, 0.0, 1.0])
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1, 0.0, 0.0])
    ball.add_freejoint()
    spec.body(model.base_link).add_freejoint()
    compiled = spec.compile()
    return SimpleNamespace(model=model, mujoco=compiled, data=mujoco.MjData(compiled))


@pytest.mark.parametrize("seed", range(2))
def test_states_round_trip_and_frames_agree(scene, seed):
    """Positions, orientations and velocities of a link, by MuJoCo's own kinematics and by Pinocchio's."""
    interface, rng = wbc.MujocoInterface(scene.model, scene.mujoco), np.random.default_rng(seed)
    model, nv = scene.model.pinocchio, scene.model.nv
    q, v = pin.integrate(model, pin.neutral(model), rng.uniform(-0.5, 0.5, nv)), rng.normal(size=nv)
    interface.place(scene.data, q, v)
    mujoco.mj_forward(scene.mujoco, scene.data)
    again_q, again_v = interface.state(scene.data)
    np.testing.assert_allclose(again_q, q, atol=1e-12)
    np.testing.assert_allclose(again_v, v, atol=1e-12)
    dynamics = dynamics_at(scene.model, again_q, again_v)
    for link in ("FL_calf", "RR_thigh"):
        frame = scene.model.frame_id(link, "link")
        body = scene.mujoco.body(link).id
        np.testing.assert_allclose(dynamics.placement(frame).translation, scene.data.xpos[body], atol=1e-9)
        np.testing.assert_allclose(dynamics.placement(frame).rotation.reshape(-1), scene.data.xmat[body], atol=1e-9)
        twist = np.zeros(6)
        mujoco.mj_objectVelocity(scene.mujoco, scene.data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 0)
        expected = dynamics.velocity(frame, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(twist, [*expected[3:], *expected[:3]], atol=1e-9)


def test_torques_go_to_their_joints(scene):
    interface = wbc.MujocoInterface(scene.model, scene.mujoco)
    tau = np.arange(1.0, scene.model.na + 1.0)
    interface.apply(scene.data, tau)
    for name, torque in zip(scene.model.actuators, tau, strict=True):
        assert scene.data.qfrc_applied[scene.mujoco.joint(name).dofadr[0]] == torque
    assert np.count_nonzero(scene.data.qfrc_applied) == scene.model.na


def test_missing_joints_and_values_of_other_types_are_refused(scene):
    g1, bolted = wbc.Controller("g1", preflight=False).model, mujoco.MjSpec.from_string(scene.model.urdf).compile()
    assert "the MuJoCo model has no joint 'left_hip_pitch_joint'" in refusal(wbc.MujocoInterface, g1, scene.mujoco)
    said = refusal(wbc.MujocoInterface, scene.model, bolted)
    assert "has no free joint; give it one, or set robot.base: fixed" in said
    assert "not RobotModel and NoneType" in refusal(wbc.MujocoInterface, scene.model, None)
    interface = wbc.MujocoInterface(scene.model, scene.mujoco)
    for call in (
        lambda: interface.apply(scene.data, [1j] * scene.model.na),
        lambda: interface.apply(scene.data, np.full(scene.model.na, np.nan)),
        lambda: interface.place(scene.data, np.zeros(3)),
        lambda: interface.place(scene.data, np.zeros(scene.model.nq), np.ma.masked_array(np.zeros(scene.model.nv))),
    ):
        with pytest.raises(wbc.InputRefused):
            call()
