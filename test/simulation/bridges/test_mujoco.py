"""States and torques in a user's MuJoCo scene with other objects."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

import wbc_controller as wbc
from wbc_controller.simulation.plant import Plant

mujoco = pytest.importorskip("mujoco")


A1 = Path(__file__).parents[3] / "examples" / "a1.yaml"


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


def random_state(model, seed):
    rng = np.random.default_rng(seed)
    q = pin.integrate(model.pinocchio, pin.neutral(model.pinocchio), rng.uniform(-0.5, 0.5, model.nv))
    return q, rng.normal(size=model.nv)


@pytest.mark.parametrize("seed", range(2))
def test_states_round_trip_and_frames_agree(scene, seed):
    """Positions, orientations and velocities of a link, by MuJoCo's own kinematics and by Pinocchio's."""
    interface = wbc.MujocoInterface(scene.model, scene.mujoco)
    q, v = random_state(scene.model, seed)
    interface.place(scene.data, q, v)
    mujoco.mj_forward(scene.mujoco, scene.data)
    again_q, again_v = interface.state(scene.data)
    np.testing.assert_allclose(again_q, q, atol=1e-12)
    np.testing.assert_allclose(again_v, v, atol=1e-12)
    dynamics = wbc.Dynamics(scene.model)
    dynamics.update(again_q, again_v)
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


def test_it_reads_what_the_mock_robot_reads(robot_of):
    settings, model = robot_of("g1")
    plant = Plant(model, settings)
    rng = np.random.default_rng(0)
    for _ in range(50):
        plant.apply(rng.normal(size=model.na))
        plant.step()
    interface = wbc.MujocoInterface(model, plant.model)
    for ours, theirs in zip(interface.state(plant.data), plant.state(), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_missing_joints_and_values_of_other_types_are_refused(scene):
    with pytest.raises(wbc.ConfigurationError, match="the MuJoCo model has no joint 'left_hip_pitch_joint'"):
        wbc.MujocoInterface(wbc.Controller("g1", preflight=False).model, scene.mujoco)
    bolted = mujoco.MjSpec.from_string(scene.model.urdf).compile()
    with pytest.raises(wbc.ConfigurationError, match=r"has no free joint; give it one, or set robot\.base: fixed"):
        wbc.MujocoInterface(scene.model, bolted)
    with pytest.raises(wbc.ConfigurationError, match="not RobotModel and NoneType"):
        wbc.MujocoInterface(scene.model, None)
    interface = wbc.MujocoInterface(scene.model, scene.mujoco)
    for call in (
        lambda: interface.apply(scene.data, [1j] * scene.model.na),
        lambda: interface.apply(scene.data, np.full(scene.model.na, np.nan)),
        lambda: interface.place(scene.data, np.zeros(3)),
        lambda: interface.place(scene.data, np.zeros(scene.model.nq), np.ma.masked_array(np.zeros(scene.model.nv))),
    ):
        with pytest.raises(wbc.InputRefused):
            call()
