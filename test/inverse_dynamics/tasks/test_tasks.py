import math

import numpy as np
import pinocchio as pin
import pytest
from snapshots import displacement, dynamics_at, random_state, rate_along

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics import tasks
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of, rotation_of
from wbc_controller.records import Reference

ROBOTS = ("g1", "go2")
FRAMES = {"g1": "left_rubber_hand", "go2": "FL_foot"}
REFERENCE_FRAMES = {"g1": "right_rubber_hand", "go2": "RR_calf"}
KINDS = ("posture", "com", "frame_position", "frame_orientation", "frame_pose", "relative_pose")


def make(kind, model, robot, **options):
    if kind == "posture":
        return tasks.PostureTask(kind, model, model.joints[7:2:-2], **options)
    if kind == "com":
        return tasks.ComTask(kind, options.pop("mask", [True] * 3), **options)
    if kind == "relative_pose":
        return tasks.RelativePoseTask(kind, model, FRAMES[robot], REFERENCE_FRAMES[robot], **options)
    frame_task = getattr(tasks, f"Frame{kind.removeprefix('frame_').capitalize()}Task")
    return frame_task(kind, model, FRAMES[robot], **options)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("seed", range(5))
def test_jacobian_and_drift_are_derivatives_of_position_and_velocity(robot_of, robot, kind, seed):
    _, model = robot_of(robot)
    q, v = random_state(model, np.random.default_rng(seed))
    task, dynamics, units = make(kind, model, robot), dynamics_at(model, q, v), np.eye(model.nv)
    columns = [rate_along(task.position, model, q, unit, 1.0e-6, change=displacement) for unit in units]
    J = task.jacobian(dynamics)
    assert J.shape == (task.size, model.nv)
    assert np.abs(J - np.array(columns).T).max() < 1.0e-7
    np.testing.assert_allclose(task.velocity(dynamics), J @ v, atol=1.0e-10)
    drift, rate = task.drift(dynamics), rate_along(task.velocity, model, q, v, 1.0e-5)
    assert np.linalg.norm(rate - drift) < 1.0e-6 * max(1.0, np.linalg.norm(drift))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("seed", range(5))
def test_error_leads_from_the_position_to_the_reference(robot_of, robot, kind, seed):
    _, model = robot_of(robot)
    rng = np.random.default_rng(seed)
    task = make(kind, model, robot)
    here, there = (dynamics_at(model, *random_state(model, rng)) for _ in range(2))
    assert np.abs(task.error(here, task.position(here))).max() < 1.0e-9
    goal = np.array(task.position(there))
    error = task.error(here, goal)
    np.testing.assert_allclose(error, displacement(task.position(here), goal), atol=1.0e-8)
    if kind in ("frame_orientation", "frame_pose", "relative_pose"):
        assert np.linalg.norm(error[-3:]) <= np.pi + 1.0e-9
        reached = pin.exp3(error[-3:]) @ rotation_of(task.position(here)[-4:])
        np.testing.assert_allclose(reached, rotation_of(goal[-4:]), atol=1.0e-9)


def test_positions_of_frames_equal_pinocchio(g1):
    q, v = random_state(g1, np.random.default_rng(1))
    dynamics, data = dynamics_at(g1, q, v), g1.pinocchio.createData()
    pin.framesForwardKinematics(g1.pinocchio, data, q)
    placement = data.oMf[g1.pinocchio.getFrameId(FRAMES["g1"])]
    np.testing.assert_allclose(make("frame_pose", g1, "g1").position(dynamics), pin.SE3ToXYZQUAT(placement))
    np.testing.assert_allclose(make("frame_position", g1, "g1").position(dynamics), placement.translation)
    turned = make("frame_orientation", g1, "g1").position(dynamics)
    np.testing.assert_allclose(turned, pin.SE3ToXYZQUAT(placement)[3:])
    reference = data.oMf[g1.pinocchio.getFrameId(REFERENCE_FRAMES["g1"])]
    expected = pin.SE3ToXYZQUAT(reference.actInv(placement))
    np.testing.assert_allclose(make("relative_pose", g1, "g1").position(dynamics), expected, atol=1e-12)


@pytest.mark.parametrize("length", [0.5, 2.0])
def test_reference_orientation_of_any_length(go2, length):
    dynamics = dynamics_at(go2, *random_state(go2, np.random.default_rng(2)))
    task = make("frame_orientation", go2, "go2")
    reference = quaternion_of(pin.exp3(np.array([0.1, 0.2, -0.3])))
    expected = task.error(dynamics, reference)
    np.testing.assert_allclose(task.error(dynamics, length * reference), expected, atol=1e-12)
    np.testing.assert_allclose(task.error(dynamics, -reference), expected, atol=1e-12)  # the same orientation


@pytest.mark.parametrize(
    ("kind", "mask"),
    [
        ("com", [True, False, True]),
        ("frame_position", [False, True, False]),
        ("frame_orientation", [True, True, False]),
        ("frame_pose", [True, False, True, False, False, True]),
        ("frame_pose", [False] * 6),
        ("relative_pose", [True, False, True, False, False, True]),
    ],
)
def test_equation_has_the_masked_rows(g1, kind, mask):
    rng = np.random.default_rng(3)
    dynamics = dynamics_at(g1, *random_state(g1, rng))
    goal = np.array(make(kind, g1, "g1").position(dynamics_at(g1, *random_state(g1, rng))))
    stiffness, damping = rng.uniform(0.0, 100.0, (2, len(mask)))
    task = make(kind, g1, "g1", mask=mask, stiffness=list(stiffness), damping=list(damping))
    reference = Reference(goal, rng.normal(size=task.size), rng.normal(size=task.size))
    J, right, error = task.equation(dynamics, reference)
    assert task.dimension == sum(mask)
    # The acceleration of this task alone follows its law.
    full_error = displacement(task.position(dynamics), goal)
    acceleration = reference.acceleration + stiffness * full_error
    acceleration += damping * (reference.velocity - task.jacobian(dynamics) @ dynamics.v)
    np.testing.assert_allclose(right + task.drift(dynamics)[mask], acceleration[mask], atol=1e-8)
    np.testing.assert_array_equal(J, task.jacobian(dynamics)[mask])
    np.testing.assert_allclose(error, full_error[mask], atol=1e-9)


def test_posture_task_keeps_the_order_of_its_joints(go2):
    q, v = random_state(go2, np.random.default_rng(4))
    dynamics = dynamics_at(go2, q, v)
    task = tasks.PostureTask("legs", go2, ["RR_calf_joint", "FL_hip_joint"], stiffness=10.0, damping=1.0)
    indices = [go2.pinocchio.joints[go2.pinocchio.getJointId(name)].idx_v for name in task.joints]
    np.testing.assert_array_equal(task.velocity(dynamics), v[indices])
    np.testing.assert_array_equal(task.jacobian(dynamics), np.eye(go2.nv)[indices])
    _, right, _ = task.equation(dynamics, Reference(np.array([0.1, 0.2]), np.zeros(2), np.array([7.0, 8.0])))
    q_indices = [go2.pinocchio.joints[go2.pinocchio.getJointId(name)].idx_q for name in task.joints]
    np.testing.assert_allclose(right, [7.0, 8.0] + 10.0 * ([0.1, 0.2] - q[q_indices]) - v[indices])
    assert tasks.PostureTask("all", go2).joints == go2.joints
    with pytest.raises(ConfigurationError, match=r"tasks\.legs\.joints: 'FL_hip_jont'.*did you mean 'FL_hip_joint'"):
        tasks.PostureTask("legs", go2, ["FL_hip_jont"])


@pytest.mark.parametrize("kind", KINDS)
def test_default_damping_is_critical(g1, kind):
    assert make(kind, g1, "g1", stiffness=64.0).damping == pytest.approx(2.0 * math.sqrt(64.0))
    assert make(kind, g1, "g1", stiffness=64.0, damping=0.0).damping == 0.0
    size = make(kind, g1, "g1").size
    np.testing.assert_allclose(make(kind, g1, "g1", stiffness=np.arange(size) ** 2).damping, 2.0 * np.arange(size))


@pytest.mark.parametrize("stiffness", [100.0, np.array([100.0, 1.0, 25.0])])
def test_the_band_of_an_acceleration_is_tolerance_times_stiffness(stiffness):
    task = tasks.ComTask("com", [True, False, True], stiffness=stiffness)
    assert task.band().tolist() == [0.0, 0.0]
    task.tolerance = np.array([0.02, 0.02, 0.04])
    np.testing.assert_allclose(task.band(), ([0.02, 0.02, 0.04] * np.broadcast_to(stiffness, 3))[[0, 2]])


@pytest.mark.parametrize("kind", KINDS)
def test_default_reference_requires_no_acceleration(g1, kind):
    rng, task = np.random.default_rng(5), make(kind, g1, "g1")
    dynamics = dynamics_at(g1, random_state(g1, rng)[0])
    reference = task.rest(dynamics)
    _, right, error = task.equation(dynamics, reference)
    assert np.abs(right).max() < 1.0e-6
    assert np.abs(error).max() < 1.0e-8
    before = np.array(reference.position)
    dynamics.update(*random_state(g1, rng))
    np.testing.assert_array_equal(reference.position, before)


@pytest.mark.parametrize(("kind", "key"), [*((kind, "stiffness") for kind in KINDS), ("com", "damping")])
def test_gains_of_wrong_length_are_refused(g1, kind, key):
    size = make(kind, g1, "g1").size
    said = rf"tasks\.{kind}\.{key} has {size + 1} values; expected one number, or a list with one for .* {size} "
    with pytest.raises(ConfigurationError, match=said):
        make(kind, g1, "g1", **{key: [1.0] * (size + 1)})


@pytest.mark.parametrize("kind", [tasks.AxisAlignmentTask, tasks.GazeTask])
@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("seed", range(5))
def test_angle_to_a_moving_target_is_a_damped_spring(robot_of, robot, kind, seed):
    _, model = robot_of(robot)
    rng = np.random.default_rng(seed)
    q, v = random_state(model, rng)
    dynamics = dynamics_at(model, q, v)
    task = kind("aim", model, FRAMES[robot], rng.normal(size=3), stiffness=50.0, damping=[5.0, 9.0])
    ahead = rng.uniform(0.5, 2.0) * task.direction(dynamics)
    r = ahead if kind is tasks.AxisAlignmentTask else task.position(dynamics) - task.direction(dynamics) + ahead
    r_dot, r_ddot = rng.normal(size=3), rng.normal(size=3)
    J, right, error = task.equation(dynamics, Reference(r, r_dot, r_ddot))
    assert np.abs(error).max() < 1.0e-9  # on the target, with relative motion
    v_dot = np.linalg.lstsq(J, right, rcond=None)[0]
    frame = model.pinocchio.getFrameId(FRAMES[robot])
    to_sides = task._sides @ dynamics.placement(frame).rotation.T
    h, errors = 2.0e-5, []
    for t in (-h, 0.0, h):
        dynamics.update(pin.integrate(model.pinocchio, q, t * v + 0.5 * t**2 * v_dot), v + t * v_dot)
        target = r + t * r_dot + 0.5 * t**2 * r_ddot
        if kind is tasks.GazeTask:
            target = target - dynamics.placement(frame).translation
        # In axes without spin, and by another formula; sin θ ≈ θ for small angles.
        errors.append(to_sides @ np.cross(task.direction(dynamics), target / np.linalg.norm(target)))
    rate, acceleration = (errors[2] - errors[0]) / (2.0 * h), (errors[2] - 2.0 * errors[1] + errors[0]) / h**2
    assert np.linalg.norm(rate) > 0.01
    scale = 1.0 + np.linalg.norm(v) ** 2
    np.testing.assert_allclose(acceleration, -np.array([5.0, 9.0]) * rate, atol=1e-4 * scale)


@pytest.mark.parametrize("angle", [0.0, 1e-10, 1e-5, 0.3, 1.5, 3.0, np.pi - 1e-10, np.pi])
def test_axis_error_is_the_angle(g1, angle):
    dynamics = dynamics_at(g1, *random_state(g1, np.random.default_rng(10)))
    task = tasks.AxisAlignmentTask("aim", g1, FRAMES["g1"], [1.0, 0.0, 0.0])
    R = dynamics.placement(g1.pinocchio.getFrameId(FRAMES["g1"])).rotation
    goal = 3.0 * R @ pin.exp3(angle * np.array([0.0, 0.6, 0.8])) @ [1.0, 0.0, 0.0]
    error = task.error(dynamics, goal)
    assert np.linalg.norm(error) == pytest.approx(angle, abs=1e-9)
    np.testing.assert_allclose(R @ pin.exp3(np.array([0.0, *error])) @ [3.0, 0.0, 0.0], goal, atol=1e-8)


def test_target_without_direction(g1):
    dynamics = dynamics_at(g1, random_state(g1, np.random.default_rng(11))[0])
    here = dynamics.placement(g1.pinocchio.getFrameId(FRAMES["g1"])).translation
    for kind, target in ((tasks.AxisAlignmentTask, np.zeros(3)), (tasks.GazeTask, np.array(here))):
        task = kind("aim", g1, FRAMES["g1"], [1, 0, 0])
        _, right, error = task.equation(dynamics, Reference(target, np.ones(3), np.ones(3)))
        assert not error.any()
        np.testing.assert_allclose(right, 0.0, atol=1e-9)


@pytest.mark.parametrize("kind", [tasks.AxisAlignmentTask, tasks.GazeTask])
def test_default_reference_of_an_axis(g1, kind):
    dynamics = dynamics_at(g1, random_state(g1, np.random.default_rng(12))[0])
    task = kind("aim", g1, FRAMES["g1"], [0.0, 1.0, 1.0])
    reference = task.rest(dynamics)
    assert len(reference.position) == len(reference.velocity) == len(reference.acceleration) == 3
    _, right, error = task.equation(dynamics, reference)
    assert np.abs(error).max() < 1e-9
    np.testing.assert_allclose(right, 0.0, atol=1e-6)
    with pytest.raises(ConfigurationError, match=r"tasks\.aim\.axis = \[0, 0, 0\]: the length must not be 0"):
        kind("aim", g1, FRAMES["g1"], [0, 0, 0])
    with pytest.raises(ConfigurationError, match=r"tasks\.aim\.stiffness has 3 values; .* 2 axes"):
        kind("aim", g1, FRAMES["g1"], [0, 0, 1], stiffness=[1, 2, 3])


RATES = {
    "linear_momentum": lambda model, **options: tasks.LinearMomentumTask("task", **options),
    "angular_momentum": lambda model, **options: tasks.AngularMomentumTask("task", **options),
    "capture_point": lambda model, **keys: tasks.CapturePointTask("task", model.gravity, support_height=-1.0, **keys),
}


def above_the_support(model, q):
    """Return the state with a higher base, for a pendulum of positive length."""
    return np.concatenate([q[:2], [np.abs(q[2])], q[3:]])


@pytest.mark.parametrize("kind", RATES)
@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("seed", range(5))
def test_jacobian_and_drift_of_rate_tasks(robot_of, robot, kind, seed):
    _, model = robot_of(robot)
    rng = np.random.default_rng(seed)
    q, v = random_state(model, rng)
    q, v_dot, task = above_the_support(model, q), rng.normal(size=model.nv), RATES[kind](model)
    dynamics = dynamics_at(model, q, v)
    rate = task.jacobian(dynamics) @ v_dot + task.drift(dynamics)
    assert task.jacobian(dynamics).shape == (task.size, model.nv)
    found = rate_along(task.position, model, q, v, 1.0e-6, v_dot)
    assert np.linalg.norm(found - rate) < 1.0e-6 * max(1.0, np.linalg.norm(rate))


@pytest.mark.parametrize("kind", RATES)
def test_equation_of_rate_tasks(g1, kind):
    rng = np.random.default_rng(13)
    q, v = random_state(g1, rng)
    dynamics = dynamics_at(g1, above_the_support(g1, q), v)
    size = RATES[kind](g1).size
    key = "gain" if kind == "capture_point" else "damping"
    mask = [False] + [True] * (size - 1)
    task = RATES[kind](g1, mask=mask, **{key: list(range(1, size + 1))})
    here = np.array(task.position(dynamics))
    reference = Reference(here + 0.5, np.full(size, 7.0), np.full(size, np.nan))  # the acceleration is ignored
    J, right, error = task.equation(dynamics, reference)
    assert task.dimension == len(J) == size - 1
    np.testing.assert_allclose(right + task.drift(dynamics)[1:], 7.0 + 0.5 * np.arange(2, size + 1))
    assert np.linalg.norm(error) == pytest.approx(0.5 * np.sqrt(size - 1))
    with pytest.raises(ConfigurationError, match=rf"tasks\.task\.{key} has 4 values; .* {size} axes"):
        RATES[kind](g1, **{key: [1.0] * 4})


def test_capture_point_and_its_smallest_height(g1):
    dynamics = dynamics_at(g1, g1.configuration(g1.posture), np.ones(g1.nv))
    task = tasks.CapturePointTask("cp", g1.gravity, support_height=-0.7)
    assert task.omega(dynamics) == pytest.approx(np.sqrt(g1.gravity / (dynamics.com[2] + 0.7)))
    point = dynamics.com[:2] + dynamics.com_velocity[:2] / task.omega(dynamics)
    np.testing.assert_allclose(task.position(dynamics), point)
    task = tasks.CapturePointTask("cp", g1.gravity, support_height=5.0)
    assert task.omega(dynamics) == pytest.approx(np.sqrt(g1.gravity / 0.1))
    drift = dynamics.com_drift[:2] / task.omega(dynamics) + dynamics.com_velocity[:2]
    np.testing.assert_allclose(task.drift(dynamics), drift)
