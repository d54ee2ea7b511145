"""Source of states and echo, on the memory transport and without wall time."""

import contextlib
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from wbc_controller.errors import ConfigurationError
from wbc_controller.middleware.codec import decode, nanoseconds
from wbc_controller.middleware.topics import counterpart
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.user import User
from wbc_controller.records import Mode
from wbc_controller.settings.service import RealtimeSettings
from wbc_controller.validation.latency import robots
from wbc_controller.validation.latency.robots import StandingRobot, echo, open_transport


class Time:
    """Clock that advances during sleeps, and ends a run at a given time."""

    def __init__(self, end, meanwhile=lambda: None):
        self.now, self.end, self.stop, self.meanwhile = 100.0, 100.0 + end, threading.Event(), meanwhile

    def monotonic(self):
        return self.now

    def time_ns(self):
        return round(self.now * 1e9)

    def sleep(self, seconds):
        self.now += seconds
        self.meanwhile()
        if self.now >= self.end - 1e-9:
            self.stop.set()


@pytest.mark.parametrize(
    ("name", "base_state", "inactive"),
    [("go2", "odom", 1), ("g1", "imu", 60)],  # with an IMU the robot rests for 0.1 s
)
def test_controller_stays_active(bench, monkeypatch, name, base_state, inactive):
    controller = bench(name, {"estimation": {"base_state": base_state, "settling": 0.1}})
    reports, transport = controller.reports, MemoryTransport(controller.bus)
    controller.user.close()  # a second publisher of the states
    user = User(controller.settings, controller.model, controller.topics, transport)

    def cycle():
        controller.clock.time = clock.now
        if len(reports) == inactive:
            user.send_text("command", "activate")
        controller.loop.cycle()

    clock = Time(0.6, cycle)
    monkeypatch.setattr(robots, "time", clock)
    StandingRobot(controller.model, controller.settings, transport, controller.topics).run(clock.stop)
    assert [report.mode for report in reports] == [Mode.INACTIVE] * inactive + [Mode.ACTIVE] * (301 - inactive)
    assert not any(report.refused for report in reports)
    assert len({report.stamp for report in reports[inactive:]}) == 301 - inactive
    assert np.ptp([report.solution.tau for report in reports[inactive:]], axis=0).max() > 0.0


def states_at(bench, monkeypatch, end, meanwhile=None):
    """Return the send times of states, in periods."""
    controller = bench("go2")
    clock, times = Time(end), []
    monkeypatch.setattr(robots, "time", clock)

    def receive(payload):
        times.append((clock.now - 100.0) / controller.period)
        if meanwhile:
            meanwhile(clock, len(times))

    states = next(topic for topic in controller.topics if topic.key == "joint_states")
    MemoryTransport(controller.bus).subscribe(states, receive)
    transport = MemoryTransport(controller.bus)
    StandingRobot(controller.model, controller.settings, transport, controller.topics).run(clock.stop)
    return times


def test_states_are_sent_on_a_time_grid_and_late_ones_are_omitted(bench, monkeypatch):
    def stall(clock, count):
        clock.now += {3: 0.0071, 5: 0.0009}.get(count, 0.0)  # 3.55 and 0.45 periods

    np.testing.assert_allclose(states_at(bench, monkeypatch, 0.02), range(11), atol=1e-6)
    np.testing.assert_allclose(states_at(bench, monkeypatch, 0.02, stall), [0, 1, 2, 6, 7, 8, 9, 10], atol=1e-6)


def test_echo_answers_with_messages_of_the_same_size(bench, monkeypatch):
    controller, bus = bench("go2"), MemoryBus()
    monkeypatch.setattr(robots, "open_transport", lambda *words: contextlib.nullcontext(MemoryTransport(bus)))
    heard = {"effort": [], "joint_commands": []}
    user = MemoryTransport(bus)
    sent = []
    for topic in controller.topics:
        if topic.key in heard:
            user.subscribe(counterpart(topic), heard[topic.key].append)
        if topic.key == "joint_states":
            user.subscribe(topic, sent.append)
    clock = Time(0.01)
    monkeypatch.setattr(robots, "time", clock)

    def meanwhile():
        StandingRobot(controller.model, controller.settings, user, controller.topics).run(clock.stop)

    echo("dds", 0, controller.topics, controller.model.na, SimpleNamespace(wait=meanwhile), RealtimeSettings())
    assert len(sent) == len(heard["effort"]) == 6
    assert heard["joint_commands"] == sent
    (data,) = {decode(payload, "std_msgs/msg/Float64MultiArray").data.shape for payload in heard["effort"]}
    assert data == (controller.model.na,)
    stamps = [nanoseconds(decode(payload, "sensor_msgs/msg/JointState").header.stamp) for payload in sent]
    assert np.diff(stamps).tolist() == [2_000_000] * 5


def test_an_unknown_transport_and_rclpy_without_ros2_are_refused(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setitem(sys.modules, "wbc_controller.nodes.ros2.process", None)
    unknown = r"unknown transport 'dss'.*did you mean 'dds'\? Valid: dds, rclpy"
    for name, said in (("dss", unknown), ("rclpy", r"ROS 2 not found .*source it")):
        with pytest.raises(ConfigurationError, match=said), open_transport(name, "node", 0):
            pass
