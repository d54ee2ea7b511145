"""The first seconds of control: torques on wrong joints stop the robot at once, and nothing else does."""

import logging

import numpy as np
import pytest

from wbc_controller.nodes.lockstep import Lockstep
from wbc_controller.records import Fault, Mode

#: Time of the release from the hoist, and end of a run, s.
LET_GO, END = 0.6, 1.6


class Wired:
    """A robot on its hoist with wrongly wired torques, released later."""

    def __init__(self, settings, wiring=None, held=True):
        self.lockstep = Lockstep(settings)
        self.mock, self.model = self.lockstep.mock, self.lockstep.model
        if wiring is not None:
            apply, matrix = self.mock.plant.apply, wiring(list(self.model.actuators))
            self.mock.plant.apply = lambda tau: apply(matrix @ np.asarray(tau))
        self.lockstep.user.send_text("command", "activate")
        if not held:
            self.mock.plant.hold(False, ramp=0.0)
        self.held = held
        self.speeds = []

    def run(self, until=END):
        """Run until the controller stops; return its last report."""
        while self.lockstep.time < until:
            report = self.lockstep.cycle()
            self.speeds.append(float(np.abs(self.mock.plant.state()[1][self.model.v_index]).max()))
            if report.mode not in (Mode.ACTIVE, Mode.HOLDING):
                return report
            if self.held and self.lockstep.time >= LET_GO:
                self.mock.plant.hold(False)
                self.held = False
        return report


def exchanged(first, second):
    def wiring(names):
        order = np.arange(len(names))
        i, j = names.index(first), names.index(second)
        order[[i, j]] = j, i
        return np.eye(len(names))[order]

    return wiring


#: Matrices from torques sent to torques applied; the legs are left and right, of a quadruped front and rear.
WIRINGS = {
    "alphabetical": lambda names: np.eye(len(names))[np.argsort(names)],
    "shifted by one": lambda names: np.roll(np.eye(len(names)), 1, axis=0),
    "legs exchanged": lambda names: np.eye(len(names))[[*range(6, 12), *range(6), *range(12, len(names))]],
    "knee and elbow exchanged": exchanged("left_elbow_joint", "left_knee_joint"),
    "wrist and waist exchanged": exchanged("right_wrist_yaw_joint", "waist_pitch_joint"),
    "knee reversed": lambda names: np.diag(np.where(np.array(names) == "left_knee_joint", -1.0, 1.0)),
}


@pytest.mark.parametrize(
    ("name", "wiring"), [*(("g1", wiring) for wiring in WIRINGS), ("go2", "legs exchanged"), ("talos", "alphabetical")]
)
def test_torques_at_wrong_joints_stop_the_robot_and_name_a_joint(robot_of, caplog, name, wiring):
    caplog.set_level(logging.CRITICAL)
    robot = Wired(robot_of(name)[0], WIRINGS[wiring])
    report = robot.run()
    assert report.mode is Mode.FAULT
    assert report.fault.code == "UNEXPLAINED_MOTION"
    assert any(f"joint {joint!r} deviates by" in report.fault.sentence for joint in robot.model.joints)
    assert not report.command.tau.any()
    assert max(robot.speeds) < 25.0


@pytest.mark.parametrize(
    ("name", "held", "ramp"), [("g1", False, 1.0), ("go2", True, 1.0), ("go2", False, 0.2), ("talos", False, 0.0)]
)
def test_a_robot_that_receives_its_torques_stays_active(robot_of, changed, name, held, ramp):
    """On the hoist until it stands, or released at once, so that it sinks during the ramp."""
    report = Wired(changed(robot_of(name)[0], {"safety": {"activation_ramp": ramp}}), held=held).run()
    assert report.fault is None or report.fault.code in {"FALLEN", "FALLING"}  # from zero torque, with a long ramp
    assert report.fault is None or ramp == 1.0


def test_only_the_first_time_of_active_control_is_watched(robot_of, changed):
    robot = Wired(changed(robot_of("go2")[0], {"safety": {"bring_up_time": 0.5}}))
    robot.run(until=0.8)
    apply = robot.mock.plant.apply
    robot.mock.plant.apply = lambda tau: apply(-np.asarray(tau))
    report = robot.run()
    assert report.fault is None or report.fault.code != "UNEXPLAINED_MOTION"


def test_after_a_stop_the_robot_can_be_activated_again(robot_of):
    robot = Wired(robot_of("go2")[0], WIRINGS["alphabetical"])
    assert robot.run().fault.code == "UNEXPLAINED_MOTION"
    robot.mock.plant.apply = type(robot.mock.plant).apply.__get__(robot.mock.plant)
    robot.mock.plant.hold(True, ramp=0.0)
    for word in ("reset", "activate"):
        robot.lockstep.user.send_text("command", word)
        report = robot.lockstep.cycle()
    assert (report.mode, report.fault) == (Mode.ACTIVE, None)


def test_the_supervisor_does_not_damp_after_it(bench):
    on = bench("go2").activated(100)
    assert on.efforts()[-1].any()
    on.v[on.model.v_index] = 0.1
    on.loop._bring_up.fault = Fault("UNEXPLAINED_MOTION", "joint 'FL_calf_joint' moves")
    assert on.cycle().mode is Mode.FAULT
    assert not on.efforts()[-1].any()
