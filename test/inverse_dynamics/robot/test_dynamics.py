import numpy as np
import pinocchio as pin
import pytest
from chains import joint, link, robot
from snapshots import close, dynamics_at, random_state

from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.controller import Controller
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.settings.config import Config
from wbc_controller.settings.files import parse_settings

ROBOTS = ("g1", "go2")


@pytest.fixture(scope="module")
def snapshots(robot_of):
    """Return one snapshot per robot, reused for every state."""
    return {robot: Dynamics(robot_of(robot)[1]) for robot in ROBOTS}


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("seed", range(15))
def test_snapshot_equals_pinocchio(snapshots, robot, seed):
    dynamics = snapshots[robot]
    model = dynamics.model.pinocchio
    q, v = random_state(dynamics.model, np.random.default_rng(seed))
    dynamics.update(q, v)
    upper = np.triu(pin.crba(model, model.createData(), q))
    M = upper + np.triu(upper, 1).T
    close(dynamics.M, M)
    np.testing.assert_array_equal(dynamics.M, dynamics.M.T)
    assert np.linalg.eigvalsh(dynamics.M).min() > 0.0
    close(dynamics.h, pin.nonLinearEffects(model, model.createData(), q, v))
    close(dynamics.h, pin.rnea(model, model.createData(), q, v, np.zeros(model.nv)))
    data = model.createData()
    close(dynamics.com, pin.centerOfMass(model, data, q, v, np.zeros(model.nv)))
    close(dynamics.com_velocity, data.vcom[0])
    close(dynamics.com_drift, data.acom[0])
    momentum = pin.computeCentroidalMomentum(model, model.createData(), q, v).vector
    close(dynamics.centroidal_matrix @ v, momentum)
    rate = pin.computeCentroidalMomentumTimeVariation(model, model.createData(), q, v, np.zeros(model.nv)).vector
    close(dynamics.centroidal_drift, rate)
    close(dynamics.com_jacobian, pin.jacobianCenterOfMass(model, model.createData(), q))


@pytest.mark.parametrize("name", ["M", "h", "com", "com_jacobian", "centroidal_matrix", "joint_jacobians", "joints"])
def test_an_array_remains_valid_without_the_dynamics(g1, name):
    dynamics = dynamics_at(g1, g1.configuration(g1.posture))
    array, before = getattr(dynamics, name), np.array(getattr(dynamics, name))
    del dynamics
    others = [dynamics_at(g1, g1.configuration(g1.posture + 0.1)) for _ in range(5)]  # in the freed memory
    assert not np.array_equal(getattr(others[0], name), before)
    np.testing.assert_array_equal(array, before)


def test_matrices_of_a_robot_with_one_joint():
    """Pinocchio returns (6,) instead of (6, nv) for nv = 1."""
    urdf = robot(link("base"), link("arm"), joint("shoulder", "base", "arm"))
    own = {"base": "fixed", "joints": ["shoulder"], "posture": [0.3]}
    pose = {"type": "frame_pose", "frame": "arm", "weight": 1.0}
    momentum = {"type": "angular_momentum"}
    settings = parse_settings(
        {"robot": own, "tasks": {"posture": {"type": "posture"}, "pose": pose, "momentum": momentum}}, "a test"
    )
    dynamics = dynamics_at(make_model(settings, urdf), np.array([0.5]), np.array([2.0]))
    frame = dynamics.model.pinocchio.getFrameId("arm")
    matrices = dynamics.centroidal_matrix, dynamics.joint_jacobians, dynamics.jacobian(frame, pin.LOCAL)
    assert {J.shape for J in matrices} == {(6, 1)}
    close(dynamics.jacobian(frame, pin.LOCAL) @ dynamics.v, dynamics.velocity(frame, pin.LOCAL))
    close(dynamics.com_jacobian @ dynamics.v, dynamics.com_velocity)
    controller = Controller(Config(settings, "", urdf))
    controller.reset([0.3], [0.0])
    for i in range(1, 300):
        result = controller.step([0.3], [0.0], i * controller.period)
    close(result.tau, controller.dynamics.h, 1e-3)  # carries the arm
