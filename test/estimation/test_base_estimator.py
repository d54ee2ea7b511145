"""Base estimate against the true state of standing robots that move, slip, and are pushed."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from snapshots import dynamics_at

from wbc_controller import Simulation
from wbc_controller.controller.build.estimation import make_estimator
from wbc_controller.estimation.absolute_pose import PoseSample
from wbc_controller.estimation.running_estimate import ImuSample
from wbc_controller.settings.config import load


class Scene:
    """Robot controlled by its true state, and an estimator with its sensors only."""

    def __init__(self, robot, noise=1.0, **changes):
        self.simulation = Simulation(robot, preflight=False)
        self.controller, self.model = self.simulation.controller, self.simulation.controller.model
        self.settings = settings = load(robot).replace({"estimation.base_state": "imu", **changes}).settings
        self.estimator = make_estimator(settings, self.model, self.controller.contacts)
        self.contacts, self.imu_frame = list(settings.contacts), settings.estimation.imu_frame or self.model.base_link
        self.noise, self.rng = noise, np.random.default_rng(0)
        self.biases = noise * 0.005 * self.rng.normal(size=3), noise * 0.05 * self.rng.normal(size=3)
        self.joints = lambda q: q  # encoder errors
        self.errors = []

    def sense(self):
        q, v = self.simulation.plant.state()
        _, turning, force = self.simulation.plant.imu(self.imu_frame)
        density = self.noise / np.sqrt(self.controller.period)
        turning = turning + self.biases[0] + 2e-4 * density * self.rng.normal(size=3)
        force = force + self.biases[1] + 2e-3 * density * self.rng.normal(size=3)
        joints = self.joints(q[self.model.q_index]) + self.noise * 5e-4 * self.rng.normal(size=self.model.nj)
        return ImuSample(self.simulation.time, turning, force), joints, v[self.model.v_index]

    def check(self, _):
        sample, q, v = self.sense()
        self.estimator.update([sample], q, v, self.contacts)
        if self.estimator.filter is not None:
            self.errors.append(self.error())

    def error(self):
        """Return errors of position, orientation, linear and angular velocity, (12,) in SI units."""
        (pose, twist), (q, v) = self.estimator.base, self.simulation.plant.state()
        turn = pin.log3(pin.Quaternion(q[3:7]).matrix().T @ pin.Quaternion(pose[3:]).matrix())
        return np.concatenate([pose[:3] - q[:3], turn, twist - v[:6]])

    def run(self, seconds):
        self.simulation.run(seconds, self.check)
        return np.abs(self.errors[-round(seconds / self.controller.period) :]).max(axis=0)


@cache
def ready(robot):
    """Cached scene after standing, swaying and a push, with its largest errors."""
    scene = Scene(robot)
    scene.run(0.7)
    com = scene.controller.dynamics.com.copy()
    worst = []
    for offset in ([0.0, 0.02, -0.03], [0.0, -0.02, 0.0]):
        scene.controller.follow("com", [0.5], [com + offset])
        worst.append(scene.run(0.6))
    scene.simulation.plant.push(scene.model.base_link, [0.0, 30.0, 0.0, 0.0, 0.0, 0.0], 0.1)
    worst.append(scene.run(0.6))
    return scene, np.max(worst, axis=0)


def test_accuracy_and_biases_after_motion_and_pushes():
    scene, worst = ready("talos")
    assert worst[:2].max() < 0.005
    assert worst[2] < 0.003
    assert worst[3:5].max() < np.deg2rad(0.4)  # an accelerometer's bias is a tilt, 0.05 m/s² of 0.3°
    assert worst[6:9].max() < 0.02
    assert not scene.estimator.slipping
    found = scene.estimator.filter
    np.testing.assert_allclose(found.gyroscope_bias, scene.biases[0], atol=5e-4)
    assert found.accelerometer_bias[2] == pytest.approx(scene.biases[1][2], abs=0.01)
    deviation = np.sqrt(np.diag(found.P))
    assert deviation[2] > 5.0 * 1e-4  # unobservable heading
    assert (np.abs(found.gyroscope_bias - scene.biases[0]) < 5.0 * deviation[-6:-3]).all()


def test_feet_that_roll_are_not_taken_for_fixed_points():
    errors = {}
    for rolling in (True, False):
        scene = Scene("go2", noise=0.1)
        if not rolling:
            for name in scene.estimator._kinematics.rolling:
                scene.estimator._kinematics.rolling[name] = np.zeros(3)
        scene.run(0.6)
        scene.controller.follow("com", [0.6], [scene.controller.dynamics.com + [0.05, 0.0, -0.06]])
        errors[rolling] = scene.run(0.65)[0]
    assert errors[True] < 0.5 * errors[False]
    assert errors[False] > 0.0005


def test_contacts_come_and_go_with_what_is_meant_to_hold():
    scene, _ = ready("talos")
    names = set(scene.estimator.filter.names)
    sample, q, v = scene.sense()
    fed(scene, [replace(sample, stamp=sample.stamp + 0.001)], q, v, ["left_foot", "left_hand"])
    assert {name.partition("/")[0] for name in scene.estimator.filter.names} == {"left_foot"}
    assert scene.estimator.filter.P.shape == (24, 24)
    fed(scene, [replace(sample, stamp=sample.stamp + 0.002)], q, v, ["left_foot", "right_foot"])
    assert set(scene.estimator.filter.names) == names


def standing(robot="go2", **changes):
    """Estimator without data, and the sensors of a robot at rest."""
    scene = Scene(robot, noise=0.0, **changes)
    q, v = np.array(scene.model.posture), np.zeros(scene.model.nj)
    return scene, ImuSample(0.0, np.zeros(3), np.array([0.0, 0.0, 9.81])), q, v


def fed(scene, samples, q, v, active_contacts=None):
    for sample in samples:
        scene.estimator.update([sample], q, v, scene.contacts if active_contacts is None else active_contacts)
    return scene.estimator.waits_for


def stream(sample, count, start=0.0, **changes):
    turning = changes.get("turning", [sample.angular_velocity] * count)
    force = changes.get("force", sample.specific_force)
    return [ImuSample(start + 0.002 * i, np.array(turning[i]), force) for i in range(count)]


def test_it_begins_when_the_robot_has_stood_still_for_a_while():
    scene, sample, q, v = standing()
    assert scene.estimator.waits_for == "no IMU data received"
    assert "has to stand still for 0.5 s" in fed(scene, stream(sample, 200), q, v)
    assert scene.estimator.filter is None
    assert fed(scene, stream(sample, 60, 0.4), q, v) == ""
    pose, twist = scene.estimator.base
    np.testing.assert_allclose(pose[[0, 1, 3, 4, 5, 6]], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0], atol=1e-9)
    assert pose[2] == pytest.approx(scene.simulation.plant.state()[0][2], abs=2e-3)  # soles on the ground
    np.testing.assert_allclose(twist, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "active_contacts", "said"),
    [
        ({"turning": [[0.2 * (-1) ** i, 0.0, 0.0] for i in range(300)]}, None, "varies by 0.2 rad/s (limit 0.05"),
        ({"turning": [[0.0, 0.0, 0.6]] * 300}, None, "the IMU turns at 0.6 rad/s (limit 0.5)"),
        ({"force": np.array([0.0, 0.0, 1.0])}, None, "the IMU measures 1 m/s² at rest, but gravity is 9.81"),
        ({}, (), "no usable contact is active"),
    ],
)
def test_reasons_against_the_start(changes, active_contacts, said):
    scene, sample, q, v = standing()
    assert said in fed(scene, stream(sample, 300, **changes), q, v, active_contacts)
    assert scene.estimator.filter is None


def test_tilt_and_accelerometer_bias_are_correlated_at_rest():
    scene, sample, q, v = standing("go2")
    fed(scene, stream(sample, 1300), q, v)  # 2 s after the start
    expected = scene.settings.estimation.accelerometer_bias / 9.81
    deviation = np.sqrt(np.diag(scene.estimator.filter.P))
    np.testing.assert_allclose(deviation[:2], expected, rtol=0.05)
    np.testing.assert_allclose(deviation[-3:-1], scene.settings.estimation.accelerometer_bias, rtol=0.05)


@pytest.mark.parametrize(("walking", "limit"), [(False, 0.1), (True, 0.3)])
def test_a_contradiction_by_all_contacts_may_be_larger_while_the_robot_walks(walking, limit):
    """Damping makes a walking robot fall, and its feet tip and slip for a short time."""
    scene, sample, q, v = standing()
    assert fed(scene, stream(sample, 300), q, v) == ""
    shock = replace(sample, specific_force=np.array([2.0, 0.0, 9.81]))
    speeds = []
    for later in stream(shock, 500, 0.6):
        scene.estimator.update([later], q, v, scene.contacts, walking=walking)
        if scene.estimator.lost:
            break
        speeds.append(scene.estimator._running._consistency.speed)
    assert f"m/s (limit {limit} m/s)" in scene.estimator.lost
    assert 0.8 * limit < max(speeds) <= limit


def test_samples_that_are_not_newer_change_nothing():
    scene, sample, q, v = standing()
    fed(scene, stream(sample, 300), q, v)
    before = scene.estimator.filter.velocity.copy()
    fed(scene, [replace(sample, stamp=0.3, specific_force=sample.specific_force + 100.0)], q, v)
    np.testing.assert_allclose(scene.estimator.filter.velocity, before, atol=1e-6)


def test_the_imu_may_be_on_another_link():
    """IMU on G1's hand: gravity gives the tilt of the hand, the joints that of the base."""
    scene = Scene("g1", noise=0.0, **{"estimation.imu_frame": "left_rubber_hand"})
    model, waist = scene.model, scene.model.joints.index("waist_pitch_joint")
    q, v = np.array(model.posture), np.zeros(model.nj)
    q[waist] = 0.3
    base, frame = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), model.frame_id("left_rubber_hand", "test")
    dynamics = dynamics_at(model, *model.state(q, v, base, np.zeros(6)))
    hand = dynamics.placement(frame)
    force = hand.rotation.T @ [0.0, 0.0, 9.81]
    fed(scene, stream(ImuSample(0.0, np.zeros(3), force), 300), q, v)
    pose, twist = scene.estimator.base
    np.testing.assert_allclose(pin.Quaternion(pose[3:]).matrix(), np.eye(3), atol=1e-6)
    np.testing.assert_allclose(pose[:2], 0.0, atol=1e-9)
    np.testing.assert_allclose(twist, 0.0, atol=1e-9)
    v[waist] = 0.5
    dynamics.update(*model.state(q, v, base, np.zeros(6)))
    linear, angular = np.split(dynamics.velocity(frame, pin.LOCAL), 2)
    estimator = scene.estimator
    estimator._kinematics.update(q, v)
    estimator._running._last = ImuSample(0.6, angular, force)
    estimator.filter.columns[:, 0] = hand.rotation @ linear
    np.testing.assert_allclose(estimator.base[1], 0.0, atol=1e-6)


def test_covariance_of_the_base():
    scene = Scene("talos")  # IMU with offset and rotation
    scene.run(0.6)
    running, found = scene.estimator._running, scene.estimator.filter
    running._interval = np.inf  # without the noise of the last sample
    size = len(found.P)
    half = np.random.default_rng(1).normal(size=(size, size)) * 1e-3
    found.P = half @ half.T
    before, step = {name: np.copy(getattr(found, name)) for name in ("rotation", "columns", "gyroscope_bias")}, 1e-7

    def moved(error):
        """Return pose and twist of the base with added errors (ξ_R, ξ_v, ξ_p, δb_g): X̂ = exp(ξ) X."""
        turn = pin.exp3(error[:3])
        found.rotation = turn @ before["rotation"]
        found.columns = turn @ before["columns"]
        found.columns[:, 0] += error[3:6]
        found.columns[:, 1] += error[6:9]
        found.gyroscope_bias = before["gyroscope_bias"] + error[9:]
        return running.base(pin.SE3.Identity())

    pose, twist = moved(np.zeros(12))
    by = []
    for error in step * np.eye(12):
        other, moving = moved(error)
        turned = pin.log3(pin.Quaternion(other[3:]).matrix() @ pin.Quaternion(pose[3:]).matrix().T)
        by.append(np.concatenate([other[:3] - pose[:3], turned, moving - twist]) / step)
    moved(np.zeros(12))
    J, own = np.array(by).T, [*range(9), *range(size - 6, size - 3)]
    expected = J @ found.P[np.ix_(own, own)] @ J.T
    of_pose, of_twist = scene.estimator.covariance
    np.testing.assert_allclose(of_pose, expected[:6, :6], atol=1e-5 * np.abs(expected).max())
    np.testing.assert_allclose(of_twist, expected[6:, 6:], atol=1e-5 * np.abs(expected).max())
    running._interval = 0.002
    noisier = scene.estimator.covariance[1] - of_twist
    np.testing.assert_allclose(noisier[3:, 3:], found.settings.gyroscope_noise**2 / 0.002 * np.eye(3), atol=1e-12)
    assert np.linalg.eigvalsh(noisier).min() > -1e-12


def test_covariance_and_stamp_at_the_start():
    scene = Scene("go2")
    assert (scene.estimator.covariance, scene.estimator.stamp) == (None, -np.inf)
    scene.run(0.7)
    assert scene.estimator.stamp == pytest.approx(scene.simulation.time, abs=1.1 * scene.controller.period)
    for part in scene.estimator.covariance:
        assert (np.diag(part) > 0.0).all()
    scene.estimator.restart()
    assert (scene.estimator.covariance, scene.estimator.stamp) == (None, -np.inf)


def test_delayed_poses_correct_drift():
    """Go2 sways with creeping feet and a wrong gyroscope bias; poses at 20 Hz, 0.1 s late, noise 2 mm and 0.2°."""
    creep = {"estimation.contact_noise": 0.01}
    scene = Scene("go2", **{"estimation.absolute_pose": True, **creep})
    alone = Scene.__new__(Scene)
    alone.__dict__ |= scene.__dict__ | {"errors": []}
    settings = scene.controller.config.replace({"estimation.base_state": "imu", **creep}).settings
    alone.estimator = make_estimator(settings, scene.model, scene.controller.contacts)
    rng, on_the_way, every = np.random.default_rng(2), [], round(0.05 / scene.controller.period)

    def check(simulation):
        sample, q, v = scene.sense()
        for each in (scene, alone):
            each.estimator.update([sample], q, v, scene.contacts)
        if len(on_the_way) * every <= round(simulation.time / scene.controller.period):
            truth = simulation.plant.state()[0][:7]
            turned = pin.exp3(np.deg2rad(0.2) * rng.normal(size=3)) @ pin.Quaternion(truth[3:]).matrix()
            pose = np.concatenate([truth[:3] + 0.002 * rng.normal(size=3), pin.Quaternion(turned).coeffs()])
            on_the_way.append(PoseSample(simulation.time, pose, np.zeros((6, 6))))
        arrived = [pose for pose in on_the_way if 0.0 <= simulation.time - pose.stamp - 0.1 < scene.controller.period]
        assert scene.estimator.correct(arrived, controlled=True) == []
        for each in (scene, alone):
            if each.estimator.base is not None:
                each.errors.append(each.error())

    scene.simulation.run(0.75, check)
    for each in (scene, alone):
        found = each.estimator.filter
        found.gyroscope_bias = found.gyroscope_bias + [0.0, 0.0, 0.01]
        found.P[-4, -4] += 0.01**2
    com = scene.controller.dynamics.com.copy()
    for offset in (0.02, -0.02, 0.02):
        scene.controller.follow("com", [0.4], [com + [0.0, offset, 0.0]])
        scene.simulation.run(0.75, check)
    worst = np.abs(scene.errors[-500:]).max(axis=0)
    assert worst[:3].max() < 0.005
    assert worst[5] < np.deg2rad(0.5)
    assert worst[5] < 0.5 * abs(alone.errors[-1][5])


@pytest.mark.parametrize(("robot", "speed", "within"), [("g1", 0.3, 0.05), ("go2", 1.0, 0.02)])
def test_a_foot_that_slides_beside_resting_ones_is_excluded(robot, speed, within):
    """The first foot slides forward by 60 mm; the base and the others rest."""
    scene, sample, q, _ = standing(robot)
    legs, foot, rng = scene.estimator._kinematics, scene.contacts[0], np.random.default_rng(0)
    fed(scene, stream(sample, 300), q, np.zeros(len(q)))
    jacobian = np.empty((legs.positions((foot,)).size, len(q)))
    excluded, errors = None, []
    for i in range(round(0.06 / (0.002 * speed))):
        before = legs.positions((foot,))
        for j, turn in enumerate(1.0e-6 * np.eye(len(q))):
            legs.update(q + turn, np.zeros(len(q)))
            jacobian[:, j] = (legs.positions((foot,)) - before).ravel() / 1.0e-6
        v = np.linalg.lstsq(jacobian, np.tile([speed, 0.0, 0.0], len(before)), rcond=1e-6)[0]
        q = q + 0.002 * v
        fed(scene, [replace(sample, stamp=0.6 + 0.002 * i)], q + 1e-4 * rng.normal(size=len(q)), v)
        if excluded is None and foot in scene.estimator.slipping:
            excluded = 0.002 * i
        errors.append(np.linalg.norm(scene.estimator.base[1][:3]))
    assert excluded < within
    assert max(errors) < 0.04


def legs_with_tipped_sole(scene, contact, angle):
    """Return joint positions with which a sole tips by an angle, rad, about the edge of its first two points."""
    robot, q = scene.model.pinocchio, scene.controller.dynamics.q.copy()
    data, frame = robot.createData(), scene.model.frame_id(scene.settings.contacts[contact].frame, "test")
    joints = [scene.model.v_index[i] for i, name in enumerate(scene.model.joints) if name.startswith("left_")][:6]
    pin.framesForwardKinematics(robot, data, q)
    corners = scene.controller.contacts[contact].points(scene.controller.dynamics)
    edge, axis = corners[0], corners[1] - corners[0]
    R = pin.AngleAxis(angle, axis / np.linalg.norm(axis)).matrix()
    goal = pin.SE3(R, edge - R @ edge) * data.oMf[frame]
    for _ in range(10):
        pin.framesForwardKinematics(robot, data, q)
        error = pin.log6(data.oMf[frame].actInv(goal)).vector
        J = pin.computeFrameJacobian(robot, data, q, frame, pin.LOCAL)[:, joints]
        step = np.zeros(robot.nv)
        step[joints] = np.linalg.solve(J, error)
        q = pin.integrate(robot, q, step)
    assert np.abs(error).max() < 1e-9
    return q[scene.model.q_index]


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_tipping_sole_does_not_lift_the_base(way):
    """The only sole in contact tips by 3° about an edge in 0.15 s while the base rests."""
    scene, sample, q, v = standing("g1")
    contact, dt = scene.contacts[0], scene.controller.period
    fed(scene, stream(sample, 300), q, v, [contact])
    pose, _ = scene.estimator.base
    for i in range(1, 76):
        last, q = q, legs_with_tipped_sole(scene, contact, way * 0.05 * i / 75)
        fed(scene, [replace(sample, stamp=0.6 + (i - 1) * dt)], q, (q - last) / dt, [contact])
        now, twist = scene.estimator.base
        assert np.abs(twist).max() < 0.005
        assert np.abs(now - pose).max() < 0.001
    assert not scene.estimator.slipping


def test_the_velocity_is_less_certain_for_a_second_after_a_step():
    """Soles of fast steps tilt and roll off; a contact that returns after a slip is no step."""
    scene, sample, q, v = standing("g1", **{"estimation.contact_noise": 1.0e-4})
    deviations, time = [], 0.0
    for count, contacts in ((400, scene.contacts), (50, scene.contacts[:1]), (300, scene.contacts), (700, None)):
        fed(scene, stream(sample, count, time), q, v, contacts)
        time += 0.002 * count
        deviations.append(math.sqrt(scene.estimator.covariance[1][0, 0]))
    before, _, stepping, after = deviations
    assert stepping > 1.5 * before
    assert after < 1.1 * before


def test_errors_are_as_large_as_the_covariance_says():
    """Mean normalized squared velocity error with sensors of the default noise."""
    known = load("g1").settings.estimation
    scene = Scene("g1", noise=1.0)
    assert (known.gyroscope_noise, known.accelerometer_noise) == (2e-4, 2e-3)  # as in `Scene.sense`
    scene.joints = lambda q: q + np.sqrt(known.joint_position_noise**2 - 5e-4**2) * scene.rng.normal(size=len(q))
    squares = []

    def check(_):
        scene.check(_)
        if scene.estimator.filter is not None and scene.simulation.time > 0.8:
            found, (q, v) = scene.estimator.filter, scene.simulation.plant.state()
            frame = scene.model.frame_id(scene.imu_frame, "test")
            speed = dynamics_at(scene.model, q, v).velocity(frame, pin.LOCAL)[:3]
            error = found.velocity - found.rotation @ speed
            squares.append(error @ np.linalg.solve(found.P[3:6, 3:6], error) / 3.0)

    scene.simulation.run(1.2, check)
    com = scene.controller.dynamics.com.copy()
    scene.controller.follow("com", [0.4, 0.8, 1.2], [com + [0.0, 0.02, 0.0], com - [0.0, 0.02, 0.0], com])
    scene.simulation.run(1.6, check)
    anees = (2.0 * 1.0 + 3.0 * np.mean(squares)) / 5.0  # the tilt's error is its bias, drawn from the covariance
    assert 0.7 < anees < 1.3
