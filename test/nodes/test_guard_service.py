"""The guard with its topics: accepted commands, messages, and state after its end."""

import re
import subprocess
import sys
import threading

import numpy as np
import pytest
from peer import Peer
from refusals import refusal
from robot_cases import joint, link, robot
from services import make_guard, topics_of
from starved import StarvedThread
from waiting import running, until

from wbc_controller.controller.build.guard import make_guard_damping
from wbc_controller.controller.build.robot_description import describe, read_urdf
from wbc_controller.middleware.topics import counterpart
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes import guard_service
from wbc_controller.nodes.clock import ManualClock
from wbc_controller.nodes.guard_service import run_guard
from wbc_controller.safety.guard import GuardMode
from wbc_controller.settings.files import shipped_configurations
from wbc_controller.settings.robot import RobotSettings


class Stage(Peer):
    """A guard on the memory transport, and a user in place of controller and robot."""

    def __init__(self, robot_of, make, changed, changes=None, transport=MemoryTransport):
        settings, self.model = robot_of("go2")
        self.settings = changed(settings, changes or {})
        self.make = make
        self.clock = ManualClock(100.0)
        self.bus = MemoryBus()
        self.guard_transport = transport(self.bus)
        self.service = make_guard(self.settings, self.model, self.guard_transport, self.clock)
        self.topics = topics_of("guard", self.settings)
        super().__init__(self.bus, self.topics)

    def command(self, torques=1.0, names=None, time=1):
        names = self.model.joints if names is None else names
        nothing = np.full(len(names), np.nan)
        content = self.make.joint_state(names, nothing, nothing, np.full(len(names), torques), time)
        self.send("joint_commands", content)

    def mode(self, text):
        self.say("controller_state", text)

    def joints(self, velocity=0.5, joints=None):
        names = self.model.joints if joints is None else joints
        self.send("joint_states", self.make.joint_state(names, np.zeros(len(names)), np.full(len(names), velocity)))

    def run(self, duration, *, commands=False, states=True, **joints):
        for _ in range(round(duration / 0.002)):
            self.clock.time += 0.002
            if states:
                self.joints(**joints)
            if commands:
                self.command()
            self.service.cycle()

    def efforts(self):
        return np.array([content.data for content in self.all("effort")]).reshape(-1, self.model.na)


@pytest.fixture
def stage(robot_of, make, changed):
    return lambda **changes: Stage(robot_of, make, changed, changes)


@pytest.fixture
def on(stage):
    """A guard that has watched an active controller for 0.1 s."""
    on = stage()
    on.mode("active")
    on.run(0.1, commands=True)
    return on


def test_from_watching_to_damping_and_back(on):
    assert not on.all("effort")
    on.run(0.1)
    np.testing.assert_allclose(on.efforts()[-1], -2.0 * 0.5)
    sent = len(on.all("effort"))
    on.run(0.1, commands=True)
    assert len(on.all("effort")) == sent
    first, second, third = (content.data for content in on.all("state"))
    assert first == third == "watching"
    assert re.fullmatch(r"damping COMMANDS_STOPPED: the last command came 1[4-6] ms ago, in mode active", second)


def test_a_guard_without_patience_does_not_flood_the_log(on, caplog):
    caplog.clear()
    for _ in range(200):  # in 4 s the commands pause 200 times, each time longer than the patience of 12 ms
        on.run(0.018)
        on.run(0.002, commands=True)
    on.run(2.0, commands=True)
    assert len([content for content in on.all("state") if content.data.startswith("damping")]) >= 190
    assert 4 <= len(caplog.messages) <= 6
    assert caplog.messages[0].startswith("damping COMMANDS_STOPPED: the last command came 1")
    assert caplog.messages[0].endswith(" ms ago, in mode active")
    assert re.search(
        r"; \d\d earlier changes not logged: guard.patience \(12 ms\) may be too short$", caplog.messages[1]
    )
    assert caplog.messages[-1].startswith("watching")


def test_valid_and_refused_commands_in_turn_do_not_flood_the_log(on, caplog):
    for _ in range(50):
        on.run(0.002, commands=True)
        on.command(np.nan)
    assert [said.partition(":")[0] for said in caplog.messages] == ["joint_commands refused"]


def test_its_own_settings_are_obeyed(stage):
    on = stage(guard={"patience": 0.1, "damping": 7.0, "damping_time": 0.2, "torque": 0.01})
    on.mode("active")
    on.run(0.1, commands=True)
    on.run(0.09)
    assert not on.all("effort")
    on.run(0.15)
    np.testing.assert_allclose(on.efforts()[-1], -np.minimum(7.0 * 0.5, 0.01 * on.model.effort_limits))
    on.run(0.2)
    assert not on.efforts()[-1].any()


def test_a_second_publisher_of_the_controllers_topics_is_reported(on, caplog):
    topics = {topic.key: counterpart(topic) for topic in on.topics}
    MemoryTransport(on.bus, "wbc_controller").advertise(topics["controller_state"])
    second = MemoryTransport(on.bus, "stray")
    for key in ("joint_commands", "controller_state"):
        second.advertise(topics[key])
    on.service.watch.check()
    on.run(0.1, commands=True)
    named = on.values["publishers/joint_commands"].split(", ")
    assert "/stray" in named
    assert len(named) == 2  # this test publishes commands too
    assert on.status.level == 1
    (commands, _) = sorted(caplog.messages)
    assert commands.startswith("/wbc_controller/joint_commands has several publishers: ")
    assert commands.endswith("the guard cannot detect the end of the controller: stop all but one")


@pytest.mark.parametrize("torques", [np.nan, -1e4])
def test_a_command_that_is_not_finite_or_above_the_limits_is_no_command(on, torques):
    for _ in range(50):
        on.command(torques)
        on.run(0.002)
    assert on.all("state")[-1].data.startswith("damping")
    assert " of 'FL_hip_joint' is " in on.values["refused/joint_commands"]
    assert np.isfinite(on.efforts()).all()


@pytest.mark.parametrize("payload", [b"", b"\x00\x01\x00\x00", b"\xff" * 60])
@pytest.mark.parametrize("key", ["joint_commands", "controller_state", "joint_states"])
def test_bytes_that_are_no_message_do_no_harm(on, key, payload, caplog):
    on.send_bytes(key, payload)
    on.run(0.004, commands=True)
    assert "callback for" not in caplog.text  # refused by the guard, not caught by the transport
    on.run(0.1)
    np.testing.assert_allclose(on.efforts()[-1], -1.0)


def test_stale_joint_states_lead_to_reported_zero_torque(on):
    on.run(0.1)
    on.run(0.1, velocity=np.nan)
    assert not on.efforts()[-1].any()
    said = on.all("state")[-1].data
    assert said.startswith("damping COMMANDS_STOPPED: ")
    assert "; zero torque, because the joint velocities are stale (velocity of 'FL_hip_joint' is nan rad/s" in said


def test_diagnostics_by_the_conventions(on):
    on.run(1.0, commands=True)
    assert (on.status.level, on.status.name, on.status.message) == (0, "guard: commands", "watching")
    assert on.status.hardware_id == "go2_description"  # the robot's name in its URDF
    assert 9 <= len(on.all("diagnostics")) <= 12
    on.run(0.1)
    assert on.status.level == 2
    assert [on.values[key] for key in ("mode", "takeovers", "controller")] == ["damping", "1", "active"]


def test_before_a_takeover_it_looks_again_for_commands_that_wait_to_be_read(on, monkeypatch):
    """If its thread was preempted, so was the reading thread."""
    on.joints()
    on.clock.time += 0.02
    monkeypatch.setattr(guard_service.time, "sleep", lambda seconds: on.command())
    on.service.cycle()
    assert not on.all("effort")
    assert on.service.guard.takeovers == 0
    monkeypatch.setattr(guard_service.time, "sleep", lambda seconds: None)
    on.joints()
    on.clock.time += 0.02
    on.service.cycle()
    assert on.all("effort")


def test_commands_that_a_starved_thread_has_not_read_prevent_a_takeover(robot_of, make, changed):
    on = Stage(robot_of, make, changed, transport=StarvedThread)
    on.mode("active")
    on.command()
    on.joints()
    on.guard_transport.run()
    for period in range(2, 500):  # the controller answers each state, and no callback runs
        on.clock.time += 0.002
        on.joints()
        on.command(time=2_000_000 * period)
        on.service.cycle()
    assert on.service.guard.takeovers == 0
    on.mode("inactive")  # it has released the robot
    on.command(torques=0.0, time=2_000_000_000)
    on.clock.time += 0.1
    on.service.cycle()
    assert on.service.guard.takeovers == 0
    on.command(time=3_000_000_000)
    on.mode("active")
    on.guard_transport.run()
    on.clock.time += 0.2
    on.service.cycle()
    assert on.service.guard.takeovers == 1


def test_a_command_that_comes_while_it_computes_is_the_last_word(on, monkeypatch):
    on.run(0.1)
    sent, step = len(on.all("effort")), on.service.guard.step

    def late(now, heard):
        tau = step(now, heard)
        on.clock.time += 1e-4
        on.command()
        return tau

    monkeypatch.setattr(on.service.guard, "step", late)
    on.service.cycle()
    assert len(on.all("effort")) == sent


def test_stopped_while_damping_it_leaves_zero_torques_and_while_watching_nothing(on):
    stop = threading.Event()
    stop.set()
    on.service.run(stop)
    assert not on.all("effort")
    on.run(0.1)
    assert on.efforts()[-1].any()
    on.service.run(stop)
    assert not on.efforts()[-1].any()


@pytest.mark.parametrize("name", sorted(shipped_configurations()))
def test_it_reads_the_limits_as_the_controller_does(robot_of, name):
    settings, model = robot_of(name)
    robot = describe(read_urdf(settings.robot.urdf), settings.robot)
    np.testing.assert_array_equal(robot.effort_limits, model.effort_limits)
    assert robot.name == model.pinocchio.name


def of_joint(limit):
    """A robot with one continuous joint."""
    return robot(link("l"), link("m"), joint("a", "l", "m", kind="continuous", limit=limit))


@pytest.mark.parametrize(
    ("urdf", "said"),
    [
        ("<robot", "not a usable URDF"),
        (robot(link("l")), "'a' is not a joint of the URDF; Valid: (none)"),
        (of_joint(""), "joint 'a': it has no <limit effort=…>"),
        (of_joint("effort='0' velocity='1'"), "joint 'a' has the effort limit 0.0"),
        (of_joint("effort='nan'"), "joint 'a': <limit effort='nan'> is not a"),
    ],
)
def test_a_description_that_cannot_be_used_is_refused(urdf, said):
    sentence = refusal(describe, urdf, RobotSettings(joints=["a"], posture=[0.0]))
    assert sentence.startswith("robot.")
    assert said in sentence


@pytest.mark.live
def test_the_urdf_may_come_by_topic(robot_of, changed):
    settings, model = robot_of("go2")
    settings = changed(settings, {"robot": {"urdf": ""}})
    bus, stop = MemoryBus(), threading.Event()
    peer = Peer(bus, topics_of("guard", settings))
    peer.say("robot_description", model.urdf)
    with running(run_guard, settings, MemoryTransport(bus), stop, stop=stop.set):
        until(lambda: peer.all("state"), "the state of the guard", patience=5.0)


def test_it_needs_neither_pinocchio_nor_a_solver():
    script = (
        "import sys, wbc_controller.nodes.guard_service\n"
        "print([name for name in ('pinocchio', 'scipy', 'qpsolvers', 'daqp', 'mujoco') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_damping_with_differentiated_velocities(stage):
    guard = stage(estimation={"joint_velocity": "differentiated"})
    names, speed = guard.model.joints, 0.05
    for i in range(150):
        guard.clock.time += 0.002
        position = np.full(len(names), speed * 0.002 * i)
        guard.send("joint_states", guard.make.joint_state(names, position, [], time=round(1e9 * guard.clock.time)))
        if i < 100:
            guard.command(0.0)
        guard.service.cycle()
    assert guard.service.guard.mode is GuardMode.DAMPING
    assert "not fresh" not in guard.all("state")[-1].data
    damping = make_guard_damping(guard.settings, guard.model) @ np.full(len(names), speed)
    assert (damping < 0.8 * guard.settings.guard.damping * speed).all()  # less, because these velocities are late
    np.testing.assert_allclose(guard.efforts()[-1], -damping, rtol=1e-3)
