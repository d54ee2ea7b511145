import itertools
import logging
import sys
import threading
import time

import numpy as np
import pytest
from peer import MockPeer
from refusals import refusal
from starved import StarvedThread
from stepping import step
from waiting import until

from wbc_controller.middleware import codec as messages
from wbc_controller.middleware.codec import setpoint_message, wrench_stamped
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.settings.config import load
from wbc_controller.simulation import mock_robot as module
from wbc_controller.simulation.mock_robot import MockRobot
from wbc_controller.simulation.mock_service import run_mock


class Controller(MockPeer):
    """Peer on the mock robot's topics."""

    def answer(self, stamp: int, names, tau) -> None:
        content = setpoint_message("sensor_msgs/msg/JointState", "torque", tau, frame="", stamp=stamp, joints=names)
        self.send("joint_commands", content)

    def push(self, frame: str, force) -> None:
        self.send("push", wrench_stamped(np.array([force]), frame))

    def hold(self, held: bool, key: str = "hold", subject: str = "") -> None:
        self.send(key, messages.message("std_msgs/msg/Bool", data=held), subject)


def stamp_of(content) -> int:
    return messages.nanoseconds(content.header.stamp)


@pytest.fixture
def make(go2):
    model, shipped = go2

    def build(changes=None, transport=MemoryTransport, **options):
        settings = load(shipped).replace(changes).settings if changes else shipped
        bus = MemoryBus()
        peer = Controller(bus, settings)
        return MockRobot(model, settings, transport(bus), **options), peer

    return build


class Stop(threading.Event):
    """An event the waits of which advance a clock, a list of one time in s."""

    def __init__(self, now):
        super().__init__()
        self._now = now

    def wait(self, timeout=None):
        self._now[0] += timeout
        return self.is_set()


def run_until(robot, peer, count, each, stop=None):
    """Run until a number of states has arrived; `each` is called after every state."""
    stop = stop or threading.Event()

    def receive(content):
        each()
        if len(peer.all("joint_states")) == count:
            stop.set()

    peer.reactions["joint_states"] = receive
    robot.run(stop)


def test_a_period_publishes_the_state_with_one_stamp(make, go2):
    model, settings = go2
    robot, peer = make()
    assert [content.data for content in peer.all("robot_description")] == [model.urdf]
    step(robot)
    keys = [key for key, _, _ in peer.received]
    assert keys.index("odom") < keys.index("joint_states")
    (odom,), (joints,), (imu,) = peer.all("odom"), peer.all("joint_states"), peer.all("imu")
    assert stamp_of(odom) == stamp_of(joints) == stamp_of(imu) == 2_000_000
    assert (odom.header.frame_id, odom.child_frame_id, imu.header.frame_id) == ("world", "base", "imu")
    ((transform,),) = (content.transforms for content in peer.all("tf"))
    assert (transform.header, transform.child_frame_id) == (odom.header, "base")
    position, translation = odom.pose.pose.position, transform.transform.translation
    assert (position.x, position.y, position.z) == (translation.x, translation.y, translation.z)
    assert transform.transform.rotation == odom.pose.pose.orientation
    assert joints.name == list(model.joints)
    np.testing.assert_array_equal(joints.position, model.posture)
    assert {subject for key, subject, _ in peer.received if key == "contact_wrench"} == set(settings.contacts)
    step(robot)
    assert stamp_of(peer.all("joint_states")[1]) == 4_000_000
    step(robot, 8)
    assert len(peer.all("contact_wrench")) == 2 * len(settings.contacts)  # at their own rate


def test_torques_are_applied_and_reported_until_they_are_old(make, go2):
    model, settings = go2
    robot, peer = make()
    tau = np.linspace(1.0, 2.0, model.na)
    peer.effort(tau)
    periods = round(settings.mock.command_timeout * settings.control.rate)
    for _ in range(periods):
        step(robot)
        np.testing.assert_array_equal(robot.plant.applied_torques, tau)
    np.testing.assert_array_equal(peer.all("joint_states")[-1].effort, tau)
    assert robot.plant.time == pytest.approx(0.002 * periods)
    step(robot, 3)
    _, v = robot.plant.state()
    damped = robot.plant.applied_torques
    assert (damped != tau).all()
    assert damped @ v[model.v_index] < 0.0
    peer.effort(tau)
    step(robot)
    np.testing.assert_array_equal(robot.plant.applied_torques, tau)


@pytest.mark.parametrize(
    ("tau", "said"), [([1.0] * 11, "got 11 torques; expected 12"), ([np.nan] + [1.0] * 11, "FL_hip_joint: nan")]
)
def test_unusable_torques_are_refused_and_the_joints_damped(make, caplog, tau, said):
    robot, peer = make()
    peer.effort(np.ones(12))
    step(robot)
    for _ in range(3):
        peer.effort(tau)
        step(robot)
    assert [said in record.getMessage() for record in caplog.records] == [True]  # said once
    assert (robot.plant.applied_torques != 1.0).all()


def test_refused_messages_are_logged_without_a_flood(make, go2, caplog):
    robot, peer = make()
    for key in ("effort", "push", "hold"):
        peer.send_bytes(key, b"\x00\x01\x00\x00")
    step(robot)
    assert sum("are not a" in said for said in caplog.messages) == 3
    caplog.clear()
    robot, peer = make()
    for size in range(20):  # valid and refused torques in turn
        peer.effort(np.zeros(go2[0].na + (size % 3)))
        step(robot)
    assert [said.partition(":")[0] for said in caplog.messages] == ["effort refused"]


@pytest.mark.parametrize("let_down", [False, True])
def test_the_joints_are_braked_until_the_first_torques_or_until_it_is_let_down(make, let_down):
    robot, peer = make()
    posture = robot.plant.state()[0][7:]
    step(robot, 300)
    assert robot.plant.held
    assert robot.plant.state()[0][2] == pytest.approx(0.3348, abs=1e-3)
    np.testing.assert_allclose(robot.plant.state()[0][7:], posture, atol=2e-3)
    (imu,) = peer.all("imu")[-1:]
    force = imu.linear_acceleration
    np.testing.assert_allclose([force.x, force.y, force.z], [0.0, 0.0, robot._robot.gravity], atol=0.05)
    if let_down:
        peer.hold(False)
    else:
        peer.effort(np.zeros(robot._robot.na))
    step(robot, 150)
    assert np.abs(robot.plant.state()[0][7:] - posture).max() > 0.01
    step(robot, 350)
    assert robot.plant.held is not let_down
    assert (robot.plant.state()[0][2] < 0.3) == let_down


def test_grips_by_topic(make, caplog):
    contact = {"type": "fixed", "frame": "FL_hip", "max_force": 500.0, "max_moment": 100.0, "enabled": False}
    robot, peer = make({"contacts": {"grip": contact}})
    peer.hold(True, "grip", "grip")
    peer.hold(False)
    step(robot, 300)
    assert robot.plant.state()[0][2] == pytest.approx(0.3333, abs=0.03)  # hangs from one hip
    last = [content for key, subject, content in peer.received if (key, subject) == ("contact_wrench", "grip")][-1]
    assert last.header.frame_id == "grip"
    assert abs(last.wrench.force.z) > 50.0
    peer.hold(False, "grip", "grip")
    peer.hold(True, "grip", "front_left_foot")
    step(robot, 200)
    assert robot.plant.state()[0][2] < 0.25
    assert any("a grip at 'front_left_foot'" in record.getMessage() for record in caplog.records)


def test_pushes_by_topic(make, caplog):
    robot, peer = make()
    peer.hold(False)
    step(robot, 160)
    for frame in ("", "FR_foot"):
        before = robot.plant.acceleration()[0]
        peer.push(frame, 100.0)
        step(robot)
        assert robot.plant.acceleration()[0] > before + 0.5
    peer.push("FR_fot", 100.0)
    peer.push("base", np.inf)
    step(robot)
    unknown, infinite = caplog.messages
    assert "did you mean 'FR_foot'" in unknown
    assert "finite" in infinite


def test_lockstep_answers_within_the_publication_and_runs_are_the_same_bit_for_bit(make, go2):
    model, _ = go2

    def run():
        robot, peer = make(lockstep=True)
        seen, torques = [], []

        def controller(content):
            seen.append(content.position.tobytes() + content.velocity.tobytes())
            torques.append(20.0 * (model.posture - content.position))
            peer.answer(stamp_of(content), reversed(model.joints), np.array(torques[-1][::-1]))

        peer.reactions["joint_states"] = controller
        peer.hold(False)
        for index in range(60):
            step(robot)
            np.testing.assert_array_equal(robot.plant.applied_torques, torques[index])
        assert len(torques) == 60
        return seen

    assert run() == run()


def test_lockstep_waits_for_the_answer_to_its_own_state(make, go2):
    model, _ = go2
    robot, peer = make(lockstep=True)
    stop = threading.Event()
    thread = threading.Thread(target=robot.run, args=(stop,))
    thread.start()
    try:
        time.sleep(0.18)
        states = peer.all("joint_states")
        assert 2 <= len(states) <= 5  # repeated without an answer
        assert {stamp_of(state) for state in states} == {2_000_000}
        peer.answer(1_000_000, model.joints, np.zeros(model.na))
        time.sleep(0.02)
        assert robot.plant.time == 0.0
        peer.answer(2_000_000, model.joints, np.ones(model.na))
        time.sleep(0.1)
        assert stamp_of(peer.all("joint_states")[-1]) == 4_000_000
    finally:
        stop.set()
        thread.join(timeout=2.0)
    assert not thread.is_alive()
    np.testing.assert_array_equal(peer.all("joint_states")[-1].effort, np.ones(model.na))


@pytest.mark.parametrize(
    ("names", "tau", "said"),
    [
        (slice(1, None), [1.0] * 11, "FL_hip_joint are missing"),
        (slice(None), [1.0] * 11, "got 11 efforts for 12 names"),
        (slice(None), [np.inf] * 12, "not finite"),
    ],
)
def test_lockstep_goes_on_damped_after_an_unusable_answer(make, go2, caplog, names, tau, said):
    model, _ = go2
    robot, peer = make(lockstep=True)
    peer.reactions["joint_states"] = lambda content: peer.answer(stamp_of(content), model.joints[names], tau)
    step(robot)
    assert said in caplog.records[0].getMessage()
    assert (np.abs(robot.plant.applied_torques) < 0.9).all()


def test_real_time_keeps_absolute_deadlines_by_a_positive_factor(make):
    """On a simulated clock: the duration of a period is not waited for twice."""
    now, took = [0.0], itertools.cycle([0.0, 0.0004, 0.0007])
    robot, peer = make(clock=lambda: now[0], real_time_factor=2.0)

    def compute():
        now[0] += next(took)

    run_until(robot, peer, 200, compute, Stop(now))
    assert robot.rebased == 0
    assert len(peer.all("joint_states")) == 200
    assert robot.plant.time == pytest.approx(2.0 * now[0], abs=1e-9)
    for factor in (0.0, -1.0, float("nan"), float("inf")):
        assert "real-time factor" in refusal(make, real_time_factor=factor)


def test_lateness_is_given_up_and_torques_are_let_in_while_it_computes(make):
    """The switch interval is changed during the run and restored."""
    robot, peer = make(clock=lambda: 0.0)
    seen, before = [], sys.getswitchinterval()
    run_until(robot, peer, 1, lambda: seen.append(sys.getswitchinterval()))
    assert seen == [pytest.approx(1e-4)]
    assert sys.getswitchinterval() == before
    now = [0.0]
    robot, peer = make(clock=lambda: now[0])
    late_once = iter([0.15, 1.0])

    def compute():
        now[0] += next(late_once, 0.002)

    run_until(robot, peer, 5, compute)
    assert robot.rebased == 1
    assert robot.plant.time == pytest.approx(0.01)


def test_a_slow_simulation_is_logged_while_it_runs(make, caplog, monkeypatch):
    monkeypatch.setattr(module, "_WINDOW", 0.5)
    caplog.set_level(logging.INFO, "wbc_controller")
    now, period = [0.0], 0.002 / 0.14
    robot, peer = make(clock=lambda: now[0])

    def compute():
        now[0] += period if len(peer.all("joint_states")) < 200 else 0.002

    run_until(robot, peer, 800, compute, Stop(now))
    slow, again = caplog.messages
    assert slow.startswith("the simulation runs at 14 % of real time instead of 100 %: ")
    assert again == "the simulation runs at 100 % of real time again"
    assert robot.speed.mean(robot.plant.time) == pytest.approx(1.6 / (200 * period + 1.2), rel=0.1)


def test_a_patient_robot_waits_for_a_controller_that_is_late(make, go2, monkeypatch):
    monkeypatch.setattr(module, "PATIENCE", 600.0)
    robot, peer = make(patient=True)
    stop, seen = threading.Event(), []

    def answers():
        try:
            while len(seen) < 8:
                until(lambda: len(peer.all("joint_states")) > sum(seen[-1:]), "an advance after the torques")
                time.sleep(0.03)  # 15 periods
                seen.append(len(peer.all("joint_states")))
                peer.effort(np.full(go2[0].na, 0.1))
        finally:
            stop.set()

    controller = threading.Thread(target=answers)
    controller.start()
    robot.run(stop)
    controller.join()
    assert len(seen) == 8
    waited = np.diff(seen[1:])  # the robot waits from the first torques on
    assert waited.max() <= 7  # 10 ms, the period in which they came, and the one that is published


@pytest.mark.parametrize(("tau", "waits"), [(0.1, [3.0]), (0.0, [])])
def test_a_patient_robot_waits_three_seconds_for_torques_after_nonzero_ones(make, go2, monkeypatch, tau, waits):
    """A busy computer stops a process for up to a second; zero torques are the last ones of a controller."""
    robot, peer = make(patient=True)
    wait, waited = robot._commands.wait, []
    monkeypatch.setattr(robot._commands, "wait", lambda seconds: [waited.append(seconds), wait(0.0)][1])

    def once():
        if len(peer.all("joint_states")) == 20:
            peer.effort(np.full(go2[0].na, tau))

    run_until(robot, peer, 60, once)
    assert robot.plant.time == pytest.approx(0.12)
    assert [seconds for seconds in waited if seconds > 0.0] == waits


def test_torques_are_taken_though_the_transport_s_thread_is_starved(make, go2):
    """The age counts in simulated time."""
    robot, peer = make(transport=StarvedThread)
    tau = np.full(go2[0].na, 0.5)
    for _ in range(2 * round(go2[1].mock.command_timeout * go2[1].control.rate)):
        peer.effort(tau)
        step(robot)
        assert robot.plant.applied_torques == pytest.approx(tau)


def test_a_second_robot_on_its_topics_is_logged(go2, caplog):
    model, settings = go2
    bus, stop = MemoryBus(), threading.Event()
    MockRobot(model, settings, MemoryTransport(bus, "mock_robot"))
    stop.set()
    run_mock(settings, MemoryTransport(bus, "mock_robot"), stop)
    assert "/joint_states has another publisher, /mock_robot: two robots on one topic" in caplog.messages


def test_absolute_poses_come_at_their_rate_and_late(make):
    mock, heard = {"pose_rate": 20.0, "pose_delay": 0.1, "pose_noise": 0.002, "pose_turn_noise": 0.003}, []
    robot, peer = make({"mock": mock})
    peer.reactions["pose"] = lambda pose: heard.append((robot.stamp - stamp_of(pose), pose))
    step(robot, 200)
    truth = robot.plant.state()[0]
    assert [round(1e-6 * delay) for delay, _ in heard] == [100] * len(heard)
    assert len(heard) == 6  # in 0.4 s, the first after 0.1 s
    places = np.array([[getattr(each.pose.pose.position, axis) for axis in "xyz"] for _, each in heard])
    assert 0.0005 < (places - truth[:3]).std() < 0.005
    np.testing.assert_allclose(heard[0][1].pose.covariance[[0, 35]], [4e-6, 9e-6])
