"""The service with transmissions, a spring and a mimic joint: joint states in, actuator torques out."""

import numpy as np
import pytest
from chains import MENAGERIE, TENDON, menagerie
from peer import Peer
from refusals import refusal
from services import make_guard, topics_of

from wbc_controller.controller.build.limits import make_torque_speed
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.build.robot_description import describe
from wbc_controller.middleware.topics import Direction
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.clock import ManualClock
from wbc_controller.nodes.lockstep import Lockstep
from wbc_controller.safety.supervisor import Supervisor
from wbc_controller.settings import Settings

#: Joint goals; the passive ankle is not part of the posture task.
GOAL = np.array([-0.3, 0.5, -0.6, 0.4, 0.0, -0.2])


class Robot(Lockstep):
    """Controller and mock robot in one thread, and a user of all topics."""

    def __init__(self, *, lockstep: bool = False, **changes) -> None:
        settings = menagerie(**changes)
        super().__init__(settings, model=make_model(settings, MENAGERIE), mock={"lockstep": lockstep})
        self.peer = Peer(self.bus, [topic for topic in self.topics if topic.direction is Direction.OUT])

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * self.settings.control.rate)):
            self.cycle()

    def activated(self, seconds: float) -> "Robot":
        """The robot itself, activated some time ago."""
        self.user.send_text("command", "activate")
        self.run(seconds)
        return self


@pytest.fixture(scope="module")
def moved() -> Robot:
    """The posture task moves all motor joints in one second."""
    robot = Robot().activated(1.2)
    robot.user.send_text("update", f"{{tasks: {{posture: {{setpoint: {np.delete(GOAL, 4).tolist()}}}}}}}")
    robot.run(2.0)
    return robot


def test_the_posture_is_reached_and_torques_go_out_by_actuator_and_by_joint(moved):
    q, _ = moved.mock.plant.state()
    driven = np.flatnonzero(moved.model.actuation.driven)
    np.testing.assert_allclose(q[moved.model.q_index][driven], GOAL[driven], atol=2e-3)
    assert q[moved.model.followers.q_index] == pytest.approx(-0.5 * GOAL[2] + 0.2, abs=2e-3)
    effort, command = moved.peer.all("effort")[-1], moved.peer.all("joint_commands")[-1]
    assert effort.layout.dim[0].size == len(effort.data) == moved.model.na
    assert command.name == list(moved.model.joints)
    assert len(command.position) == len(command.velocity) == moved.model.nj
    np.testing.assert_allclose(command.effort, moved.model.actuation.at_joints(effort.data))
    np.testing.assert_array_equal(moved.mock.plant.applied_torques, effort.data)


@pytest.mark.parametrize("changes", [{}, TENDON], ids=["motors", "tendon"])
def test_a_robot_that_knows_its_transmissions_is_commanded_by_joint(changes):
    runs = [Robot(command=command, **changes).activated(0.1) for command in ("actuators", "joints")]
    by_actuator, by_joint = (robot.peer.all("effort")[-1].data for robot in runs)
    model = runs[0].model
    driven = [i for i, name in enumerate(model.joints) if name != "ankle"]
    np.testing.assert_allclose(by_joint, model.actuation.at_joints(by_actuator)[driven], rtol=1e-9, atol=1e-9)
    applied = [robot.mock.plant.applied_torques for robot in runs]
    assert np.abs(applied[0]).max() > 0.1
    np.testing.assert_allclose(applied[1], applied[0], rtol=1e-9, atol=1e-9)


def test_joint_torques_are_converted_to_actuators_in_lockstep():
    robot = Robot(lockstep=True).activated(0.0)
    for _ in range(20):
        robot.publish_state()
        robot.loop.cycle()
        assert robot.mock.wait_for_answer()
        robot.mock.advance()
    sent = robot.peer.all("effort")[-1].data
    assert np.abs(sent).max() > 0.01
    np.testing.assert_allclose(robot.mock.plant.applied_torques, sent, rtol=1e-12, atol=1e-12)


def test_the_supervisor_damps_the_joints_through_the_transmission():
    robot = Robot()
    model, limits = robot.model, robot.loop.controller.supervisor.limits
    velocity = np.random.default_rng(0).normal(size=model.nj)
    at_joints = model.actuation.at_joints(Supervisor(model, limits)._damping_torques(velocity))
    expected = np.where(model.actuation.driven, -limits.safety.damping * velocity, 0.0)
    np.testing.assert_allclose(at_joints, expected, atol=1e-12)


@pytest.mark.parametrize("command", ["actuators", "joints"])
def test_the_guard_takes_over_by_actuator(make, command):
    settings = menagerie(command=command)
    model = make_model(settings, MENAGERIE)
    robot = describe(MENAGERIE, settings.robot)
    np.testing.assert_array_equal(robot.effort_limits, model.effort_limits)
    assert robot.drive.names == model.actuators
    bus, clock = MemoryBus(), ManualClock(100.0)
    service = make_guard(settings, model, MemoryTransport(bus), clock)
    peer = Peer(bus, topics_of("guard", settings))
    tau, velocity = 0.1 * model.effort_limits, np.linspace(-0.5, 0.5, model.nj)
    nothing = np.full(model.nj, np.nan)
    for cycle in range(60):
        clock.time += 1.0 / settings.control.rate
        peer.send("joint_states", make.joint_state(model.joints, np.zeros(model.nj), velocity))
        if cycle < 20:
            at_joints = model.actuation.at_joints(tau)
            peer.send("joint_commands", make.joint_state(model.joints, nothing, nothing, at_joints))
        service.cycle()
    efforts = np.array([content.data for content in peer.all("effort")])
    assert efforts.shape[1] == model.actuation.command_size
    efforts = np.array([model.actuation.from_command(row) for row in efforts])
    step = settings.limits.torque_rate / settings.control.rate * model.effort_limits
    assert (np.abs(efforts[0] - tau) <= step + 1e-12).all()
    damped, most = -settings.guard.damping * model.actuation.from_joints(velocity), settings.guard.torque
    np.testing.assert_allclose(efforts[-1], np.clip(damped, -most * model.effort_limits, most * model.effort_limits))


def test_the_curve_of_an_actuator_needs_speeds_of_its_own():
    settings = menagerie()
    model = make_model(settings, MENAGERIE)

    def curve(actuators):
        limits = {"torque_speed": {"enabled": True, "actuators": actuators}}
        return make_torque_speed(Settings.model_validate(settings.model_dump() | {"limits": limits}), model)

    own = {name: {"corner": 20.0, "no_load": 60.0} for name in settings.robot.transmission}
    np.testing.assert_array_equal(curve(own).no_load, [12.0, 60.0, 12.0, 60.0, 12.0])
    said = refusal(curve, {"both": own["both"]})
    assert "'knee_motor' of robot.transmission requires corner and no_load" in said
    assert "actuators: unknown actuator 'hip'; Valid" in refusal(curve, {"hip": own["both"]})
