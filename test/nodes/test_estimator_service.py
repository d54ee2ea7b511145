"""The base estimator as a node on the memory transport, with a robot of known truth."""

import numpy as np
import pinocchio as pin
import pytest
from peer import Peer
from services import make_estimator, topics_of
from starved import StarvedThread

from wbc_controller import Simulation
from wbc_controller.middleware.codec import nanoseconds, wrench_stamped
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.clock import ManualClock
from wbc_controller.simulation.sensors import Measurement

FEET = {"front_left_foot", "front_right_foot", "rear_left_foot", "rear_right_foot"}


class Robot(Peer):
    """Go2 controlled by its true state, and a node with its sensors only."""

    def __init__(self, transport=MemoryTransport):
        self.simulation = Simulation("go2", preflight=False)
        self.controller = self.simulation.controller
        self.model, settings = self.controller.model, self.controller.config.settings
        bus, self.clock = MemoryBus(), ManualClock()
        self.node = make_estimator(settings, self.model, transport(bus), self.clock)
        super().__init__(bus, topics_of("estimator", settings))

    def sense(self, imu=True):
        stamp = round(1e9 * self.simulation.time) + 1
        self.clock.time = 1e-9 * stamp
        found = Measurement(self.model, self.simulation.plant, stamp, self.node.estimator.imu_frame)
        if imu:
            self.send("imu", found.message("imu"))
        self.send("joint_states", found.message("joint_states"))
        self.node.cycle()

    def holding(self):
        self.node.cycle()
        return set(self.node._inputs.holding)

    def run(self, seconds):
        self.simulation.run(seconds, lambda _: self.sense())


@pytest.fixture
def robot():
    return Robot()


def push(time=1):
    return wrench_stamped(np.array([0.0, 0.0, 40.0, 0.0, 0.0, 40.0]), "", time)


def test_each_joint_state_is_answered_by_odometry(robot):
    robot.run(0.7)
    assert (robot.status.level, robot.status.message) == (0, "the base is estimated")
    assert set(robot.values["holding"].split(", ")) == FEET
    com = robot.controller.dynamics.com.copy()
    robot.controller.follow("com", [0.4], [com + [0.0, 0.03, -0.03]])
    answered, moved, worst = len(robot.all("odom")), len(robot.all("tf")), np.zeros(2)

    def look(_):
        robot.sense()
        odom, (q, v) = robot.all("odom")[-1], robot.simulation.plant.state()
        pose, twist = odom.pose.pose, odom.twist.twist
        there = np.array([pose.position.x, pose.position.y, pose.position.z])
        moving = np.array([twist.linear.x, twist.linear.y, twist.linear.z])
        worst[:] = np.maximum(worst, [np.abs(there - q[:3]).max(), np.abs(moving - v[:3]).max()])
        turn = pin.Quaternion(*(getattr(pose.orientation, axis) for axis in "wxyz"))
        assert turn.angularDistance(pin.Quaternion(q[3:7])) < 0.01

    robot.simulation.run(0.5, look)
    assert (worst < [0.005, 0.02]).all(), worst
    assert len(robot.all("odom")) - answered == 250
    assert 24 <= len(robot.all("tf")) - moved <= 26
    odom, (sent,) = robot.all("odom")[-1], robot.all("tf")[-1].transforms
    assert (
        (odom.header.frame_id, odom.child_frame_id) == (sent.header.frame_id, sent.child_frame_id) == ("odom", "base")
    )
    assert nanoseconds(odom.header.stamp) == pytest.approx(1e9 * robot.simulation.time, abs=3e6)
    for covariance in (odom.pose.covariance, odom.twist.covariance):
        matrix = covariance.reshape(6, 6)
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
        assert np.linalg.eigvalsh(matrix).min() > 0.0
    assert sent.transform.translation.z == pytest.approx(odom.pose.pose.position.z, abs=2e-3)


def test_no_odometry_before_settling_and_after_a_long_imu_gap(robot):
    robot.run(0.3)
    assert robot.all("odom") == robot.all("tf") == []
    assert (robot.status.name, robot.status.level) == ("base_estimator: base", 1)
    assert robot.status.message == "the robot has to stand still for 0.5 s"
    robot.run(0.4)
    before = len(robot.all("odom"))
    assert before > 0
    robot.simulation.run(0.05, lambda _: robot.sense(imu=False))
    assert len(robot.all("odom")) == before
    robot.run(0.02)
    assert len(robot.all("odom")) > before  # short gap
    robot.simulation.run(0.2, lambda _: robot.sense(imu=False))
    before = len(robot.all("odom"))
    robot.run(0.1)
    assert len(robot.all("odom")) == before
    assert robot.status.message == (
        "the base estimate was lost: the IMU was silent for 0.202 s; the robot has to stand still for 0.5 s"
    )
    robot.run(0.6)
    assert len(robot.all("odom")) > before


def test_an_estimate_restarts_with_a_restarted_clock(robot):
    robot.run(0.1)
    robot.node._stamp = 1e6  # as with the clock advanced before
    robot.node.estimator.restart()
    robot.run(0.7)
    assert robot.all("odom")


def test_which_contacts_hold(robot, make):
    assert robot.holding() == FEET  # without messages: the contacts of the configuration
    robot.send("holds", make.bool(False), "front_left_foot")
    assert robot.holding() == FEET  # a hanging robot has no contact forces at the start
    robot.send("holds", make.bool(True), "front_left_foot")
    robot.run(0.7)
    now = robot.clock.time
    for name in ("front_left_foot", "rear_right_foot"):
        robot.send("contact_wrench", push(), name)
    assert robot.holding() == {"front_left_foot", "rear_right_foot"}
    robot.send("holds", make.bool(False), "front_left_foot")
    robot.send("holds", make.bool(True), "front_right_foot")
    assert robot.holding() == {"rear_right_foot", "front_right_foot"}
    robot.clock.time = now + 0.2  # without forces of the controller
    assert robot.holding() == FEET - {"front_left_foot"}


def test_the_controller_s_forces_count_though_the_transport_s_thread_is_starved():
    robot = Robot(StarvedThread)
    for name in ("front_left_foot", "rear_right_foot"):
        robot.send("contact_wrench", push(), name)
    assert robot.holding() == {"front_left_foot", "rear_right_foot"}


def test_the_true_forces_of_the_feet_are_heard_and_one_that_is_silent_is_named(robot, make):
    def feel(_):
        stamp = round(1e9 * robot.simulation.time) + 1
        for name, wrench in robot.simulation.plant.contact_wrenches().items():
            if robot.simulation.time < 0.1 or name != "rear_left_foot":
                robot.send("measured_wrench", wrench_stamped(wrench, "world", stamp), name)
        robot.sense()

    robot.send("holds", make.bool(False), "front_left_foot")  # a force has precedence
    robot.simulation.run(0.15, feel)
    assert robot.node._inputs.holding == FEET
    assert not any(key.startswith("note//") for key in robot.values)
    robot.simulation.run(0.3, feel)
    note = robot.values["note//base_estimator/contacts/rear_left_foot/measured_wrench"]
    assert note.startswith("no force message for more than 0.1 s")
    assert robot.node._inputs.holding == FEET


def test_refusals_are_reported(robot, make):
    robot.send_bytes("holds", b"\x00\x01", "rear_left_foot")
    robot.sense()
    robot.send("joint_states", make.joint_state(robot.model.joints[:-1], np.zeros(11), np.zeros(11), time=2))
    robot.clock.time += 1.0
    robot.node.cycle()
    refused = {
        value.key: value.value
        for each in robot.all("diagnostics")
        for value in each.status[0].values
        if value.key.startswith("refused/")
    }
    assert set(refused) == {"refused//base_estimator/contacts/rear_left_foot/holds", "refused//joint_states"}, refused
    assert "missing" in refused["refused//joint_states"]
    assert robot.holding() == FEET
