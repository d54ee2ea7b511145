"""Absolute poses: alignment, innovation, latency and outliers."""

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller.controller.build.contacts import make_contact
from wbc_controller.controller.build.estimation import make_estimator
from wbc_controller.estimation.absolute_pose import AGREEMENT_TIME, SPEED, PoseSample
from wbc_controller.estimation.running_estimate import ImuSample
from wbc_controller.inverse_dynamics.robot.orientation import planar_transform

PERIOD = 0.004
#: True pose of the base in the world of the poses.
THERE = np.array([3.0, -2.0, 0.5, 0.0, 0.0, np.sin(1.0), np.cos(1.0)])


class Still:
    """Standing Go2 and its estimator."""

    def __init__(self, robot_of, changed, **changes):
        settings, self.model = robot_of("go2")
        told = {"base_state": "imu", "imu_frame": "", "settling": 0.1, "absolute_pose": True, **changes}
        settings = changed(settings, {"estimation": told})
        contacts = {name: make_contact(name, spec, self.model) for name, spec in settings.contacts.items()}
        self.estimator = make_estimator(settings, self.model, contacts)
        self.time, self.contacts, self.refused = 0.0, list(contacts), []

    def run(self, seconds, pose=None, *, every=0.05, late=0.0, controlled=False):
        """Advance the time, with a pose every `every` seconds."""
        for i in range(round(seconds / PERIOD)):
            self.time += PERIOD
            sample = ImuSample(self.time, np.zeros(3), np.array([0.0, 0.0, 9.81]))
            self.estimator.update([sample], self.model.posture, np.zeros(self.model.nj), self.contacts)
            due = i % round(every / PERIOD) == 0
            self.take([] if pose is None or not due else [self.pose(pose, self.time - late)], controlled=controlled)
        return self

    def take(self, samples, *, controlled=False):
        self.refused += self.estimator.correct(samples, controlled=controlled)

    def pose(self, pose, stamp=None, variance=0.0):
        return PoseSample(self.time if stamp is None else stamp, np.array(pose, dtype=float), variance * np.eye(6))

    @property
    def place(self):
        return self.estimator.base[0][:3]


@pytest.fixture
def still(robot_of, changed):
    return lambda **changes: Still(robot_of, changed, **changes)


@pytest.fixture
def standing(still):
    """Estimator with a world defined by poses."""
    return still().run(0.2).run(AGREEMENT_TIME + 0.2, THERE)


def beside(x=0.0, y=0.0):
    """Return the true pose with an offset, m."""
    return THERE + [x, y, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_the_world_is_that_of_the_poses_once_they_have_agreed(still):
    robot = still().run(0.2)
    estimator = robot.estimator
    assert (estimator.base, estimator.waits_for) == (None, "no absolute pose received (estimation.absolute_pose)")
    own = estimator.odometry[0].copy()
    robot.run(AGREEMENT_TIME - 0.1, THERE)
    assert (estimator.base, estimator.waits_for) == (None, "the absolute poses must agree for 1 s")
    robot.run(0.3, THERE)
    assert estimator.waits_for == ""
    np.testing.assert_allclose(estimator.base[0], THERE, atol=1e-6)
    np.testing.assert_allclose(estimator.base[1], 0.0, atol=1e-6)
    np.testing.assert_allclose(estimator.odometry[0], own, atol=1e-6)  # not moved by poses
    np.testing.assert_allclose(estimator.poses.odometry.actInv(own[:3]), THERE[:3], atol=1e-6)
    np.testing.assert_allclose(estimator.poses.map_to_odometry[3:], THERE[3:], atol=1e-6)
    assert robot.refused == []


def test_an_outlier_as_first_pose(still):
    robot = still().run(0.2)
    robot.take([robot.pose(beside(x=1.0))])
    robot.run(AGREEMENT_TIME + 0.2, THERE)
    np.testing.assert_allclose(robot.place, THERE[:3], atol=1e-6)


def test_poses_that_tilt_do_not_tilt_the_robot(still):
    tilted = pin.Quaternion(pin.exp3(np.array([0.1, 0.0, 0.0]))) * pin.Quaternion(THERE[3:].copy())
    robot = still().run(0.2).run(AGREEMENT_TIME + 1.0, np.concatenate([THERE[:3], tilted.coeffs()]))
    R = pin.Quaternion(robot.estimator.base[0][3:]).matrix()
    np.testing.assert_allclose(R[2], [0.0, 0.0, 1.0], atol=1e-6)
    assert np.arctan2(R[1, 0], R[0, 0]) == pytest.approx(2.0, abs=0.01)


def test_innovation_jacobian(still):
    """z = -H ξ for X = exp(-ξ) X̂, by finite differences, far from the origin and rotated."""
    robot = still(pose_frame="FL_calf").run(0.2)
    poses, found, estimator = robot.estimator.poses, robot.estimator.filter, robot.estimator
    found.move(pin.XYZQUATToSE3(THERE), np.zeros(3), np.zeros((4, 4)))
    robot.run(PERIOD)
    frame = estimator._kinematics.from_imu(*poses._frame)
    truth, step = (found.rotation.copy(), found.position.copy()), 1e-7

    def frame_at(error):
        turn = pin.exp3(-error[:3])
        imu = pin.SE3(turn @ truth[0], turn @ truth[1] - error[6:9])
        return pin.SE3ToXYZQUAT(imu * frame)

    z, H, _, p = poses.innovation(robot.pose(frame_at(np.zeros(9))))
    np.testing.assert_allclose(z, 0.0, atol=1e-12)
    np.testing.assert_allclose(p, frame_at(np.zeros(9))[:3], atol=1e-12)
    for i in range(9):
        z, *_ = poses.innovation(robot.pose(frame_at(step * np.eye(9)[i])))
        np.testing.assert_allclose(z / step, -H[:, i], atol=1e-5, err_msg=str(i))
    assert not H[:, 9:].any()


def test_a_move_of_the_world_preserves_the_estimate(standing):
    found, estimator = standing.estimator.filter, standing.estimator
    half = np.random.default_rng(1).normal(size=found.P.shape) * 1e-3
    found.P = half @ half.T
    before, twist, own = *estimator._running.covariance(), found.P[-6:, -6:].copy()
    move = planar_transform(0.7, np.zeros(3), np.array([1.0, 2.0, 3.0]))
    found.move(move, np.zeros(3), np.zeros((4, 4)))
    turn, (after, same) = np.kron(np.eye(2), move.rotation), estimator._running.covariance()
    np.testing.assert_allclose(after, turn @ before @ turn.T, atol=1e-12)
    np.testing.assert_allclose(same, twist, atol=1e-12)
    np.testing.assert_allclose(found.P[-6:, -6:], own, atol=1e-15)
    N, there = np.diag([1e-4, 2e-4, 3e-4, 4e-4]), estimator._running.base(pin.SE3.Identity())[0][:3]
    found.move(pin.SE3.Identity(), there, N)
    grown = estimator._running.covariance()[0] - after
    np.testing.assert_allclose(np.diag(grown), [1e-4, 2e-4, 3e-4, 0.0, 0.0, 4e-4], atol=1e-12)


def test_an_outlier_is_rejected_and_reported_once(standing):
    before = standing.estimator.filter.columns.copy()
    standing.take([standing.pose(beside(x=1.0))])
    standing.take([standing.pose(beside(y=1.0), standing.time - 0.001)])
    np.testing.assert_array_equal(standing.estimator.filter.columns, before)
    (said,) = standing.refused
    assert said == "the pose contradicts the estimate by 1.000 m and 0.000 rad and is rejected"
    assert standing.estimator.poses.values["pose/left out"] == "2, as they contradict the estimate"
    standing.run(0.2, THERE)
    assert standing.estimator.poses.contradiction == ""


def test_a_small_correction_comes_in_without_a_jump(standing):
    estimator, off = standing.estimator, beside(x=0.008)
    odometry, path = estimator.odometry[0].copy(), [standing.place]
    for _ in range(500):
        standing.run(PERIOD, off, every=PERIOD)
        path.append(standing.place)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() <= 1.5 * SPEED * PERIOD  # follows the creeping filter
    np.testing.assert_allclose(path[-1], off[:3], atol=1e-3)
    np.testing.assert_allclose(estimator.odometry[0], odometry, atol=1e-3)
    np.testing.assert_allclose(estimator.base[1], 0.0, atol=1e-3)
    assert estimator.filter.position[0] == pytest.approx(off[0], abs=1e-3)
    assert standing.refused == []


def test_poses_that_come_late_do_not_correct_twice(standing):
    """Ten poses are in transit during the first correction; each uses the estimate at its arrival."""
    standing.run(3.0, beside(x=0.008), every=0.02, late=0.2)
    far = []
    for _ in range(50):
        standing.run(0.02, beside(x=0.008), every=0.02, late=0.2)
        far.append(standing.estimator.filter.position[0] - THERE[0])
    np.testing.assert_allclose(far, 0.008, atol=1e-3)


def test_no_relocalization_under_control(standing):
    off = beside(x=0.3)
    standing.run(AGREEMENT_TIME + 0.5, off, controlled=True)
    np.testing.assert_allclose(standing.place, THERE[:3], atol=2e-3)
    first, after = standing.refused
    assert "the pose contradicts the estimate by 0.300 m" in first
    assert after.startswith("poses have contradicted the estimate by 0.300 m and 0.000 rad for 1.0")
    assert "rejected while the controller is active" in after
    assert "for 1.5 s" in standing.estimator.poses.values["pose/contradiction"]  # persists
    standing.run(0.1, off)  # no longer under control
    np.testing.assert_allclose(standing.place, off[:3], atol=1e-6)
    assert standing.estimator.poses.contradiction == ""
    assert standing.estimator.poses.values["pose/world moved"] == "1 times"


def test_poses_that_contradict_each_other_move_nothing(standing):
    for i in range(60):
        standing.run(0.04, beside(x=0.5 + 0.3 * (i % 2)), every=0.04)
    np.testing.assert_allclose(standing.place, THERE[:3], atol=2e-3)
    assert standing.estimator.poses.relocations == 0


def test_the_covariance_of_a_pose_counts_and_has_a_floor(standing):
    poses = standing.estimator.poses
    floor = poses.innovation(standing.pose(THERE))[2]
    np.testing.assert_allclose(np.diag(floor), [4e-6, 4e-6, 4e-6, 25e-6])
    noise = poses.innovation(standing.pose(THERE, variance=0.01))[2]
    np.testing.assert_allclose(np.diag(noise), 0.01)
    late = poses.innovation(standing.pose(THERE, standing.time - 0.1))[2]
    assert (np.diag(late) > np.diag(floor)).all()
    standing.take([standing.pose(beside(x=0.3), variance=0.01)])
    assert standing.refused == []  # three standard deviations
    assert standing.estimator.filter.position[0] - THERE[0] < 0.01


def test_old_and_future_stamps_are_refused(standing):
    standing.take([standing.pose(THERE, standing.time + 0.2)])
    standing.take([standing.pose(THERE, standing.time - 0.6)])
    assert standing.refused == [
        "header.stamp is 0.200 s ahead of the IMU's (limit 0.1 s): both sensors must use the same clock",
        "header.stamp is 0.600 s before the IMU's (limit 0.5 s)",
    ]
    taken = standing.estimator.poses.used
    standing.take([standing.pose(THERE, standing.time + 0.02)])
    assert standing.estimator.poses.used == taken  # waits for the IMU
    standing.run(0.03)
    assert standing.estimator.poses.used == taken + 1


def test_interpolation_between_estimates(standing):
    poses = standing.estimator.poses
    first, second = list(poses._past)[-2:]
    shift = pin.SE3(np.eye(3), poses.odometry.rotation @ [-0.1, 0.0, 0.0])
    poses._past[-2] = first._replace(frame=shift * first.frame)
    p = poses.frame_at(0.25 * first.stamp + 0.75 * second.stamp).translation
    np.testing.assert_allclose(p, THERE[:3] - [0.025, 0.0, 0.0], atol=1e-6)
